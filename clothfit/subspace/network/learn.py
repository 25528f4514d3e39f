"""From recorded motions to a model that steps by networks: coordinates and inputs, motions to rest, the training.

Recorded motions end a few seconds after their inputs do. A network that has seen no more keeps a cloth swinging for
ever. So some of the episodes whose inputs come to rest are played on, in the subspace, and cut to pieces of the length
of the others.

The state of a training is in a checkpoint beside MODEL: the numbers of each object, and the arrays of
`training.archived`, with the object's number and a point before their names.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np

from clothfit.base import checkpoint as files
from clothfit.base.arrays import Array
from clothfit.base.checkpoint import digest
from clothfit.base.errors import InvalidInput
from clothfit.base.writing import write_atomically
from clothfit.engine.system import build
from clothfit.scene.scene import dumps
from clothfit.subspace import translation
from clothfit.subspace.build import TIMED, Report, fitness
from clothfit.subspace.model import NETWORK, Model, Part
from clothfit.subspace.network import training as trainings
from clothfit.subspace.network.layers import OWN, Loss, Motions, Recipe, Trained, dense
from clothfit.subspace.network.signals import Signals, fitted, raw
from clothfit.subspace.network.training import Budget, Progress, Training, begin
from clothfit.subspace.network.weights import Network
from clothfit.subspace.physics.march import roll
from clothfit.subspace.physics.samples import Reduced, nothing
from clothfit.subspace.play import positions, rolled, stepper
from clothfit.subspace.recording import Data
from clothfit.subspace.validation import cost

ONE_OF = 8
"""So many motions one is held out, to choose the best values by."""

SEEN = 500
"""Windows whose deviations give the size of the noise."""

LEAST_FRAMES = 50
"""Good ones, below which there is no training."""


@dataclass(frozen=True, eq=False)
class TrainingData:
    """The motions of one object on a basis, and how their inputs become numbers."""

    motions: Motions
    signals: Signals
    frames: int
    rest: Motions | None = None  # pieces of motions that come to rest


def training_data(data: Data, c: int, episodes: Sequence[int], basis: Array) -> TrainingData:
    """The coordinates and inputs of some episodes. Raises InvalidInput for inputs that a network does not know."""
    systems = [build(data.scene_of(e), c, steps=data.steps) for e in episodes]
    tables = [raw(system, data.steps) for system in systems]
    signals = fitted(tables)
    onto = translation.projection(basis, systems[0])
    z, good = [], []
    for e, system in zip(episodes, systems, strict=True):
        x, fine = data.motion(e, c)
        own = translation.coordinates(x, system, onto)
        missing = data.steps + 1 - len(own)  # frames after the end of a motion, which are none
        before = own[:1] - system.h * translation.start_velocity(system, basis)
        z.append(np.pad(np.concatenate([before, own]), ((0, missing), (0, 0)), mode="edge"))
        good.append(np.pad(np.concatenate([[True], fine]), (0, missing)))
    w = np.stack([signals.of(system, data.steps) for system in systems])
    motions = Motions(np.stack(z), w, np.stack(good))
    taught = [e for k, e in enumerate(episodes) if k % ONE_OF != ONE_OF - 1]
    rest = rest_pieces(data, c, taught, basis, signals, motions.z[motions.good])
    return TrainingData(motions, signals, int(motions.good[:, 1:].sum()), rest)


def prepared(given: TrainingData, recipe: Recipe, seed: int) -> tuple[Training, float]:
    """A training at its beginning, and the size of the coordinates. Raises InvalidInput for too few frames."""
    if given.frames < LEAST_FRAMES or given.motions.starts(1)[1] == 0:
        raise InvalidInput(f"a network needs at least {LEAST_FRAMES} recorded frames; there are {given.frames}")
    kind = np.float32
    count = len(given.motions.z)
    beside = [e for e in range(count) if e % ONE_OF == ONE_OF - 1] or ([count - 1] if count > 1 else [])
    taught = [e for e in range(count) if e not in beside]
    now, way, _, _ = given.motions.of(taught).steps()
    size = max(float(np.sqrt(((now - now.mean(axis=0)) ** 2).sum(axis=1).mean())), 1e-12)
    pace = max(float(np.sqrt((way**2).sum(axis=1).mean())), 1e-12)
    motions = given.motions.scaled(size, float)
    part = motions.of(taught)
    if given.rest is not None and recipe.rests:
        part = part.joined(given.rest.scaled(size, float))
    own = Trained(dense(part), recipe, limits(motions, recipe.margin), np.random.default_rng([seed, 0]), kind)
    # the deviation of each component within a window, in the median, since a cloth that rests on an obstacle and then
    # falls from it has deviations that mean nothing while it rests
    starts, length = motions.of(taught).starts(recipe.windows[1])
    within = motions.of(taught).windows(starts[:: max(1, len(starts) // SEEN)], length)[0].std(axis=1)
    noise = (recipe.noise * np.median(within, axis=0)).astype(kind)
    part, rest = (some.scaled(1.0, kind) for some in (part, motions.of(beside or taught)))
    loss = Loss(recipe.velocity * size / pace)
    return Training(own, recipe, part, rest, noise, loss, begin(own, seed)), size


def limits(motions: Motions, margin: float) -> Array:
    """The range (2, r) of the coordinates, widened."""
    z = motions.z[motions.good]
    low, high = z.min(axis=0), z.max(axis=0)
    more = margin * (high - low)
    return np.stack([low - more, high + more])


def finished(training: Training, size: float, given: TrainingData) -> Network:
    """What is played of a training."""
    training.use_best()
    w = given.motions.w.reshape(-1, given.motions.w.shape[2])
    reach = np.stack([w.min(axis=0), w.max(axis=0)]) if w.size else np.zeros((2, w.shape[1]))
    return training.own.network(size, given.signals, reach)


TIMES = 10
"""The length of such a motion, in that of a recorded one."""

EPISODES = 4

MOST = 6e7
"""Springs times steps, of all these motions: half a minute or less."""


FARTHEST = 2.0
"""Times the way of the recorded motions: a cloth that falls from an obstacle, and never comes to rest, goes farther."""


def rest_pieces(
    data: Data, c: int, episodes: Sequence[int], basis: Array, signals: Signals, recorded: Array
) -> Motions | None:
    """The pieces of such motions that stay near the `recorded` coordinates (N, r); None where there are none."""
    chosen = [e for e in episodes if e % 2 == 1][:EPISODES]
    springs = len(data.scene.cloths[c].springs)
    times = min(TIMES, int(MOST / max(1, springs * data.steps * len(chosen)))) if chosen else 0
    found = [piece for e in chosen for piece in pieces(data, c, e, basis, signals, times)] if times > 1 else []
    most = FARTHEST * np.linalg.norm(recorded, axis=1).max()
    found = [each for each in found if np.linalg.norm(each[0], axis=1).max() <= most]
    if not found:
        return None
    z, w = (np.stack([each[k] for each in found]) for k in range(2))
    return Motions(z, w, np.ones(z.shape[:2], bool))


def pieces(data: Data, c: int, episode: int, basis: Array, signals: Signals, times: int) -> list[tuple[Array, Array]]:
    """Coordinates (T, r) and inputs (T − 2, m) of the pieces of one motion after the recorded frames."""
    length = data.steps
    system = build(data.scene_of(episode), c, steps=times * length)
    q = roll(Reduced(system, basis), times * length)
    z = np.concatenate([q[:1] - system.h * translation.start_velocity(system, basis), q])
    w = signals.of(system, times * length)
    return [(z[a : a + length + 2], w[a : a + length]) for a in range(length, (times - 1) * length + 1, length)]


@dataclass(frozen=True)
class TrainingOptions:
    """How to train."""

    budget: Budget
    seed: int = 0
    resume: str | None = None  # the file with the state to go on from


@dataclass
class PartTraining:
    """The training of one object."""

    given: TrainingData
    training: Training
    size: float  # of the coordinates



def part_trainings(model: Model, data: Data, options: TrainingOptions, held_out: int = 1) -> list[PartTraining]:
    """A training for each object, at its beginning, or where it is to go on. Raises InvalidInput."""
    count = len(data.episodes)
    kept = range(count - held_out if count > held_out else count)
    found = []
    for c, part in enumerate(model.parts):
        own = training_data(data, c, kept, part.basis)
        found.append(PartTraining(own, *prepared(own, OWN, options.seed)))
    if options.resume is not None:
        restored(options.resume, found, identity(model, data, options))
    return found


def train(
    model: Model, reports: Sequence[Report], data: Data, own: Sequence[PartTraining], options: TrainingOptions,
    report: Callable[[int, Progress], None],
) -> tuple[Model, bool]:  # fmt: skip
    """The model with networks in place of physics, and whether its training came to its end; the reports get what the
    networks are like. `report` is called with the object's number.
    """
    ended = True
    parts = []
    for c, each in enumerate(own):
        share = replace(options.budget, minutes=options.budget.minutes / len(own))
        ended = each.training.run(share if ended else Budget(1e-9), partial(report, c)) and ended
        network = finished(each.training, each.size, each.given)
        envelope = np.asarray(network.range, float)
        parts.append(replace(model.parts[c], chosen=nothing(), envelope=envelope, network=network))
        validate(parts[c], reports[c], data, c)
    states = [each.training.state for each in own]
    training = [{"rounds": s.rounds, "seconds": s.seconds, "held_out_error": s.best_error} for s in states]
    about = {"recipe": "own", "seed": options.seed, "training": training}
    return replace(model, parts=tuple(parts), method=NETWORK, built={**model.built, **about}), ended


def validate(part: Part, report: Report, data: Data, c: int) -> None:
    """Put into a report what a network does with the last episode, and what it costs."""
    report.elements = {name: (0, there) for name, (_, there) in report.elements.items()}
    last = len(data.episodes) - 1
    x, scene = data.motion(last, c)[0], data.scene_of(last)
    own = stepper(part, build(scene, c, steps=data.steps), data.steps, {})
    made = positions(own, rolled(own, len(x) - 1, scene.name)) - own.system.x0
    report.judged(fitness(made, x), part, own.system, x)
    report.us_per_frame, report.full_us_per_step = cost(part, scene, c, min(data.steps, TIMED))


class Checkpoint(files.Checkpoint):
    """Where a training keeps what it needs to go on."""

    kind = "training"


def identity(model: Model, data: Data, options: TrainingOptions) -> dict[str, str]:
    """What a state belongs to: the same data, bases, recipe and seed."""
    recipe = repr((OWN, options.seed))  # which another version may have with others
    parts: list[bytes | Array] = [dumps(data.scene), recipe.encode()]
    parts += [json.dumps([asdict(each) for each in data.episodes]).encode(), *(part.basis for part in model.parts)]
    return {"data, basis, recipe or seed": digest(*parts)}


def keep(path: str | os.PathLike[str], own: Sequence[PartTraining], about: dict[str, str]) -> None:
    """Write the state of a training. Raises InvalidInput where the file cannot be written."""
    states = [each.training.state for each in own]
    held = {f"{c}.{name}": each for c, state in enumerate(states) for name, each in trainings.archived(state).items()}
    numbers = [trainings.numbers(state) for state in states]
    write_atomically(path, files.encoded(Checkpoint.kind, about, {"objects": numbers, **held}))


def restored(path: str, own: Sequence[PartTraining], about: dict[str, str]) -> None:
    """Put trainings where a file has them. Raises InvalidInput where it is none, or another training's."""
    found = Checkpoint(path, identity=about).state()
    try:
        for c, each in enumerate(own):
            state = each.training.state
            held = {name: found[f"{c}.{name}"] for name in trainings.archived(state)}
            trainings.restore(state, held, found["objects"][c])
    except (ValueError, KeyError, TypeError, AttributeError, IndexError):
        raise InvalidInput(files.impossible(Checkpoint.kind, path)) from None
