"""Ways to step the coordinates of a cloth, learnt from the same motions in the same time, and by physics.

    python benchmarks/networks.py DATA --minutes 1 [--basis 64] [--only own/paper/…] [--horizon 50]

DATA is of `clothfit subspace record`. The last five motions test; one in eight of the others chooses the best values.
Errors are those of the coordinates of whole motions that are played freely, relative to the RMS of their way since the
start (`training.Training.missed`); "largest" is that of the worst of the five. With --horizon they are cut to pieces of
so many steps, each played from its recorded state; "full" is then the full simulation from what the basis holds of that
state, the best that steps on it can be expected to do. Times are processor time of one thread.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable, Sequence
from time import process_time
from typing import Any

import numpy as np

from by_physics import full, pieces, projected
from clothfit.base import threads
from clothfit.base.arrays import Array
from clothfit.engine.system import build
from clothfit.subspace import basis as bases
from clothfit.subspace.build import seen
from clothfit.subspace.network.layers import OWN, Motions, Recipe, dense, played
from clothfit.subspace.network.learn import TrainingData, limits, prepared, training_data
from clothfit.subspace.network.training import Budget, Training, begin
from clothfit.subspace.physics import cubature
from clothfit.subspace.physics.samples import Reduced, Selection
from clothfit.subspace.recording import Data
from paper import schooled
from recurrent import Recurrent
from trainings import Held, changed

TESTS = 5
LEADING = 12
"""Coordinates whose products are features of the quadratic regression."""

VARIANTS: dict[str, Recipe] = {
    "own": OWN,
    "own, one step": dataclasses.replace(OWN, windows=(1, 1)),
    "own, windows of 48": dataclasses.replace(OWN, windows=(48, 48)),
    "own, windows to 16": dataclasses.replace(OWN, windows=(4, 16)),
    "own, batches of 16": dataclasses.replace(OWN, batch=16),
    "own, rate 1e-4": dataclasses.replace(OWN, rate=1e-4),
    "own, no noise": dataclasses.replace(OWN, noise=0.0),
    "own, layers as small as what is left": dataclasses.replace(OWN, least=0.0),
    "own, no rest": dataclasses.replace(OWN, rests=False),
    "own, ten layers": dataclasses.replace(OWN, hidden=(1.5,) * 9),
}
"""Each change of the recipe alone."""


class Task:
    """The motions on a basis, and the test of a step."""

    def __init__(self, data: Data, size: int, horizon: int | None) -> None:
        count = len(data.episodes)
        self.data, self.own = data, list(range(count - TESTS))
        systems = [build(data.scene_of(e), 0, steps=data.steps) for e in range(count)]
        found = bases.decompose(data, 0, [systems[e] for e in self.own], size, self.own)
        last = bases.frames_of(data, 0, 0, systems[0], 1 << 30)[-1] + systems[0].x0
        self.basis, self.systems = bases.enriched(found, systems[0], size, last), systems
        every = training_data(data, 0, range(count), self.basis)
        self.test = every.motions.of(range(count - TESTS, count))
        self.test, self.starts = pieces(self.test, horizon or data.steps)
        motions = every.motions.of(self.own)
        self.lesson = TrainingData(motions, every.signals, int(motions.good[:, 1:].sum()), every.rest)

    def runs(self, motions: Sequence[int], chosen: Selection | None = None) -> list[Reduced]:
        """The projected cloth of some motions."""
        first = Reduced(self.systems[motions[0]], self.basis, chosen)
        return [first.under(self.systems[e]) for e in motions]

    def tests(self, chosen: Selection | None = None) -> list[Reduced]:
        """Those of the test motions."""
        return self.runs(range(len(self.systems) - TESTS, len(self.systems)), chosen)

    def errors(self, made: Array) -> tuple[float, float]:
        """The error over all test motions, and the largest of one, for coordinates (tests, frames, r)."""
        given = self.test.z[:, 1:]
        away = ((made - given) ** 2).sum(axis=2).mean(axis=1)
        moved = ((given - given[:, :1]) ** 2).sum(axis=2).mean(axis=1)
        return float(np.sqrt(away.sum() / moved.sum())), float(np.sqrt((away / moved).max()))


def trained(task: Task, recipe: Recipe, minutes: float) -> tuple[Any, float]:
    """A network after so much time, and the size of the coordinates."""
    training, size = prepared(task.lesson, recipe, 0)
    run(training, minutes)
    return training.own, size


def held(task: Task, minutes: float) -> tuple[Any, float]:
    """Our recipe with a linear part that does not grow."""
    training, size = prepared(task.lesson, OWN, 0)
    run(changed(training, Held), minutes)
    return training.own, size


def run(training: Training, minutes: float) -> None:
    """Train, with a line now and then."""
    training.run(Budget(minutes), lambda p: print(f"  {p.done:.2f} {p.rounds} {p.error:.4f}", file=sys.stderr))
    training.use_best()


class Forgetting(Training):
    """The training of a step with a state, which windows and motions begin without."""

    def round(self, done: float) -> None:
        """One step of the descent."""
        self.own.begin(self.recipe.batch)  # type: ignore[attr-defined]
        super().round(done)

    def error(self) -> float:
        """The error of the held-out motions."""
        self.own.begin(len(self.held_out.z))  # type: ignore[attr-defined]
        return super().error()


def recurrent(task: Task, kind: str, minutes: float) -> tuple[Any, float]:
    """An LSTM or a GRU after so much time, by the recipe of windows of 32 frames."""
    recipe = dataclasses.replace(OWN, windows=(32, 32), margin=0.1)
    training, size = prepared(task.lesson, recipe, 0)
    now, way, _, after = training.motions.steps()
    linear = dense(dataclasses.replace(training.motions, z=training.motions.z.astype(float)))
    left = np.sqrt(((after - now - way) ** 2).mean(axis=0))
    reach = limits(task.lesson.motions.scaled(size, float), recipe.margin)
    own = Recurrent(kind, (linear.mean, linear.lift, left), reach, 128, 0)
    run(changed(training, Forgetting, own=own, state=begin(own, 0)), minutes)  # type: ignore[arg-type]
    return own, size


class Regression:
    """A step without layers, linear or with products of the leading coordinates and ways."""

    def __init__(self, task: Task, quadratic: bool, ridge: float) -> None:
        motions = task.lesson.motions
        now, way, w, after = motions.steps()
        self.quadratic, self.reach = quadratic, limits(motions, 0.1)
        self.scale = np.concatenate([np.abs(each[:, :LEADING]).max(axis=0) for each in (now, way)])
        u = self.features(now, way, w)
        gram = u.T @ u
        gram[np.diag_indices(len(gram))] *= 1.0 + ridge
        self.matrix = np.linalg.lstsq(gram, u.T @ (after - now - way), rcond=1e-14)[0]
        self.multiplications = self.matrix.size

    def features(self, now: Array, way: Array, w: Array) -> Array:
        """(N, features)."""
        parts = [now, way, w, np.ones((len(now), 1))]
        if self.quadratic:
            lead = np.concatenate([now[:, :LEADING], way[:, :LEADING]], axis=1) / self.scale
            both = np.concatenate([lead, w / 10.0], axis=1)
            i, j = np.triu_indices(both.shape[1])
            parts.append(both[:, i] * both[:, j])
        return np.concatenate(parts, axis=1)

    def begin(self, count: int) -> None:
        """Nothing to forget."""

    def step(self, z1: Array, z2: Array, w: Array) -> tuple[Array, None]:
        """The next coordinates."""
        way = z1 - z2
        return np.clip(z1 + way + self.features(z1, way, w) @ self.matrix, *self.reach), None


def regression(task: Task, quadratic: bool) -> tuple[Any, float]:
    """The one with the ridge that plays held-out motions best."""
    motions = task.lesson.motions
    held = motions.of(range(7, len(motions.z), 8))

    def error(own: Regression) -> float:
        return float(((played(own, held.z, held.w) - held.z) ** 2).sum())  # type: ignore[arg-type]

    made = [Regression(task, quadratic, ridge) for ridge in 10.0 ** np.arange(-10.0, 0.0)]
    return min(made, key=error), 1.0


def only_prior(task: Task) -> tuple[Any, float]:
    """The linear part of the paper, alone."""
    training, size = schooled(task.lesson)
    for each in training.own.values:
        each[:] = 0
    return training.own, size


def paper(task: Task, minutes: float) -> tuple[Any, float]:
    """The network of the paper after so much time."""
    training, size = schooled(task.lesson)
    run(training, minutes)
    return training.own, size


def physics(task: Task, error: float | None) -> Array:
    """Coordinates (tests, frames, r) by the projected steps, with all elements or with cubature to an error."""
    chosen = None
    if error is not None:
        runs = task.runs(task.own)
        chosen = cubature.find(runs, seen(task.data, 0, task.own, runs, 0)[1], [error], 0)[0].selection
    return projected(task.tests(chosen), task.test, task.starts)


def rows(task: Task, minutes: float) -> dict[str, Callable[[], Any]]:
    """What there is to compare: each gives coordinates, or a step and the size of its coordinates."""
    own: dict[str, Callable[[], Any]] = {
        "prior only": lambda: only_prior(task),
        "linear regression": lambda: regression(task, False),
        "quadratic regression": lambda: regression(task, True),
        "paper": lambda: paper(task, minutes),
        "LSTM": lambda: recurrent(task, "LSTM", minutes),
        "GRU": lambda: recurrent(task, "GRU", minutes),
        "own, spectral radius held": lambda: held(task, minutes),
        "full": lambda: full(task.tests(), task.test, task.starts),
        "physics": lambda: physics(task, None),
        "physics with cubature": lambda: physics(task, 0.01),
    }
    return own | {name: (lambda recipe=recipe: trained(task, recipe, minutes)) for name, recipe in VARIANTS.items()}


def free(task: Task, own: Any, size: float) -> Array:
    """Coordinates (tests, frames, r) that a step plays."""
    test: Motions = task.test.scaled(size, np.float32)
    if isinstance(own, (Recurrent, Regression)):
        own.begin(len(test.z))
    return np.asarray(played(own, test.z, test.w)[:, 1:], float) * size


def main() -> None:
    """Print a row for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data")
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--basis", type=int, default=64)
    parser.add_argument("--only", default="")
    parser.add_argument("--horizon", type=int)
    given = parser.parse_args()
    task = Task(Data(given.data), given.basis, given.horizon)
    print("| step | error | largest | minutes |\n|---|---|---|---|", flush=True)
    for name, make in rows(task, given.minutes).items():
        if given.only and name not in given.only.split("/"):
            continue
        with threads.single():
            begin = process_time()
            made = make()
            spent = (process_time() - begin) / 60.0
            error, largest = task.errors(made if isinstance(made, np.ndarray) else free(task, *made))
        print(f"| {name} | {100 * error:.2g} % | {100 * largest:.2g} % | {spent:.1f} |", flush=True)


if __name__ == "__main__":
    main()
