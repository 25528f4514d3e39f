"""A model that steps by networks, from one that steps by physics on the same bases; and what a training goes on from.

The state of a training is in a checkpoint beside MODEL: the numbers of each object, and the arrays of
`training.archived`, with the object's number and a point before their names.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from clothfit.base import checkpoint as files
from clothfit.base.arrays import Array
from clothfit.base.checkpoint import digest
from clothfit.base.errors import InvalidInput
from clothfit.base.writing import write_atomically
from clothfit.engine.system import build as build_system
from clothfit.scene.scene import dumps
from clothfit.subspace.build import TIMED, Report
from clothfit.subspace.fitness import Fitness
from clothfit.subspace.judge import cost
from clothfit.subspace.model import NETWORK, Model, Part
from clothfit.subspace.network import training as trainings
from clothfit.subspace.network.learn import Lesson, finished, lesson, prepared
from clothfit.subspace.network.recipe import RECIPES, Budget
from clothfit.subspace.network.training import Progress, Training
from clothfit.subspace.physics.samples import nothing
from clothfit.subspace.play import positions, rolled, stepper
from clothfit.subspace.recorded.recording import Data
from clothfit.subspace.sensitivity import SOUGHT, floor_of_recorded


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


class Checkpoint(files.Checkpoint):
    """Where a training keeps what it needs to go on."""

    kind = "training"


def identity(model: Model, data: Data, school: Schooling) -> dict[str, str]:
    """What a state belongs to: the same data, bases, recipe and seed."""
    recipe = repr((school.recipe, RECIPES[school.recipe], school.seed))  # which another version may have with others
    parts: list[bytes | Array] = [dumps(data.scene), recipe.encode()]
    parts += [json.dumps([asdict(each) for each in data.episodes]).encode(), *(part.basis for part in model.parts)]
    return {"data, basis, recipe or seed": digest(*parts)}


def keep(path: str | os.PathLike[str], own: Sequence[Pupil], about: dict[str, str]) -> None:
    """Write the state of a training. Raises InvalidInput where the file cannot be written."""
    states = [each.training.state for each in own]
    held = {f"{c}.{name}": each for c, state in enumerate(states) for name, each in trainings.archived(state).items()}
    numbers = [trainings.numbers(state) for state in states]
    write_atomically(path, files.encoded(Checkpoint.kind, about, {"objects": numbers, **held}))


def restored(path: str, own: Sequence[Pupil], about: dict[str, str]) -> None:
    """Put trainings where a file has them. Raises InvalidInput where it is none, or another training's."""
    found = Checkpoint(path, identity=about).state()
    try:
        for c, each in enumerate(own):
            held = {name.removeprefix(f"{c}."): one for name, one in found.items() if name.startswith(f"{c}.")}
            trainings.restore(each.training.state, held, found["objects"][c])
    except (ValueError, KeyError, TypeError, AttributeError, IndexError):
        raise InvalidInput(files.impossible(Checkpoint.kind, path)) from None
