"""A model that steps by networks, from one that steps by physics on the same bases; and what a training goes on from.

The state of a training is an `.npz` archive beside MODEL: `training`, JSON with what it belongs to and the numbers of
each object, and the arrays of `training.archived`, with the object's number and a point before their names.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from clothfit.base import npz
from clothfit.base.errors import InvalidInput
from clothfit.base.writing import write_atomically
from clothfit.engine.system import build as build_system
from clothfit.scene.scene import dumps
from clothfit.subspace.build import TIMED, Report
from clothfit.subspace.cost import cost
from clothfit.subspace.fitness import Fitness
from clothfit.subspace.model import NETWORK, Model, Part
from clothfit.subspace.network import training as trainings
from clothfit.subspace.network.learn import Lesson, finished, lesson, prepared
from clothfit.subspace.network.recipe import RECIPES, Budget
from clothfit.subspace.network.training import Progress, Training
from clothfit.subspace.physics.samples import nothing
from clothfit.subspace.play import positions, rolled, stepper
from clothfit.subspace.recorded.recording import Data
from clothfit.subspace.sensitivity import SOUGHT, floor_of_recorded

HEAD = "training"


@dataclass(frozen=True)
class Schooling:
    """How to train."""

    budget: Budget
    recipe: str = "own"  # of RECIPES
    seed: int = 0
    resume: str | None = None  # the file with the state to go on from


@dataclass
class Pupil:
    """The training of one object."""

    lesson: Lesson
    training: Training
    size: float  # of the coordinates

    def part(self, before: Part) -> Part:
        """The part of the model with the best values so far."""
        network = finished(self.training, self.size, self.lesson)
        envelope = np.asarray(network.range, float)
        return replace(before, chosen=nothing(), envelope=envelope, network=network)


def pupils(model: Model, data: Data, school: Schooling, held_out: int = 1) -> list[Pupil]:
    """A training for each object, at its beginning, or where it is to go on. Raises InvalidInput."""
    count = len(data.episodes)
    kept = range(count - held_out if count > held_out else count)
    found = []
    for c, part in enumerate(model.parts):
        own = lesson(data, c, kept, part.basis)
        found.append(Pupil(own, *prepared(own, RECIPES[school.recipe], school.seed)))
    if school.resume is not None:
        restored(school.resume, found, identity(model, data, school))
    return found


def teach(
    model: Model, reports: Sequence[Report], data: Data, own: Sequence[Pupil], school: Schooling,
    report: Callable[[int, Progress], None],
) -> tuple[Model, bool]:  # fmt: skip
    """The model with networks in place of physics, and whether its training came to its end; the reports get what the
    networks are like. `report` is called with the object's number.
    """
    ended = True
    parts = []
    for c, pupil in enumerate(own):
        share = replace(school.budget, minutes=school.budget.minutes / len(own))

        def say(progress: Progress, c: int = c) -> None:
            report(c, progress)

        ended = pupil.training.run(share if ended else Budget(1e-9), say) and ended
        parts.append(pupil.part(model.parts[c]))
        judge(parts[c], reports[c], data, c)
    about = {"recipe": school.recipe, "seed": school.seed, "training": [described(each) for each in own]}
    return replace(model, parts=tuple(parts), method=NETWORK, built={**model.built, **about}), ended


def described(own: Pupil) -> dict[str, Any]:
    """What a training was, as JSON."""
    state = own.training.state
    return {"rounds": state.rounds, "seconds": state.seconds, "held_out_error": state.best_error}


def judge(part: Part, found: Report, data: Data, c: int) -> None:
    """Put into a report what a network does with the last episode, and what it costs."""
    found.elements = {name: (0, there) for name, (_, there) in found.elements.items()}
    last = len(data.episodes) - 1
    x, _ = data.motion(last, c)
    scene = data.scene_of(last)
    own = stepper(part, build_system(scene, c, steps=data.steps), data.steps, {})
    away = positions(own, rolled(own, len(x) - 1, scene.name)) - own.system.x0 - x
    rmse, size = (float(np.sqrt((each**2).sum(axis=2).mean())) for each in (away, x))
    found.sampled = Fitness(rmse, rmse / size if size > 0 else 0.0)
    found.floor = floor_of_recorded(data, c, last, part.basis) if found.sampled.relative > SOUGHT else 0.0
    found.us_per_frame, found.full_us_per_step = cost(part, scene, c, min(data.steps, TIMED))


def identity(model: Model, data: Data, school: Schooling) -> dict[str, Any]:
    """What a state belongs to: the same data, bases, recipe and seed."""
    own = hashlib.sha256(dumps(data.scene))
    own.update(repr(RECIPES[school.recipe]).encode())  # which another version may have with other numbers
    own.update(json.dumps([asdict(each) for each in data.episodes]).encode())
    for part in model.parts:
        own.update(np.ascontiguousarray(part.basis, np.float32).tobytes())
    return {"of": own.hexdigest(), "recipe": school.recipe, "seed": school.seed}


def keep(path: str | os.PathLike[str], own: Sequence[Pupil], about: dict[str, Any]) -> None:
    """Write the state of a training. Raises InvalidInput where the file cannot be written."""
    states = [each.training.state for each in own]
    head = json.dumps({**about, "objects": [trainings.numbers(state) for state in states]})
    arrays: dict[str, Any] = {HEAD: np.frombuffer(head.encode(), np.uint8)}
    for c, state in enumerate(states):
        arrays |= {f"{c}.{name}": each for name, each in trainings.archived(state).items()}
    write_atomically(path, npz.archive(arrays))


def restored(path: str, own: Sequence[Pupil], about: dict[str, Any]) -> None:
    """Put trainings where a file has them. Raises InvalidInput where it is none, or another training's."""
    try:
        with open(path, "rb") as file:
            head = json.loads(npz.stored(file, (HEAD,), "")[HEAD].read().tobytes())
            if {name: head[name] for name in about} != about:
                raise InvalidInput(f"{path}: it is the training of another model: data, basis, recipe or seed differ")
            for c, each in enumerate(own):
                state = each.training.state
                names = [f"{c}.{name}" for name in trainings.archived(state)]
                held = {name.partition(".")[2]: one.read() for name, one in npz.stored(file, names, "").items()}
                trainings.restore(state, held, head["objects"][c])
    except InvalidInput:
        raise
    except (*npz.FAULTS, KeyError, TypeError, AttributeError, IndexError) as error:
        why = getattr(error, "strerror", None) or "it is no training of clothfit subspace build"
        raise InvalidInput(f"{path}: {why}") from None
