"""Running one setting of a scene: how long its bare steps take, and how far from a reference they lead.

Timed is the compiled loop of all steps of all cloths, one after another, in one thread, with the garbage collector
off; not what builds the arrays, compares or writes.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.rollout import Rollout, rollout
from clothfit.engine.system import build
from clothfit.evaluation.setting import Setting
from clothfit.scene.scene import INTEGRATORS, Scene

TIMED_RUNS = 5
"""Runs of each setting, at most: their median is then that of an undisturbed machine, were two disturbed."""
SOLVE_EFFORT = 5  # explicit steps
MOST_STATE_BYTES = 2e9  # bytes that the states of one cloth's run may take


@dataclass
class Trial:
    """A setting while it is measured, over F frames."""

    setting: Setting
    steps: int
    status: str = "skipped"  # until it is judged; then "done" or "diverged"
    seconds: list[float] = field(default_factory=list)  # of each run
    squares: Array | None = None  # (F,), m²: squared distance to the reference, mean over the vertices
    largest: Array | None = None  # (F,), m: largest distance of a vertex

    @property
    def effort(self) -> int:
        """Roughly how dear a run is, to begin with the cheap ones: a linear solve is worth some explicit steps."""
        return self.steps * (SOLVE_EFFORT * self.setting.newton if self.setting.newton else 1)

    def needs(self, scene: Scene) -> int:
        """Bytes that its largest cloth's run keeps."""
        return 24 * (self.steps + 1) * (1 + (self.setting.newton or 1)) * max(scene.vertex_counts)


def warm_up(scene: Scene) -> None:
    """Run a step of each integrator, so that none is timed while it compiles."""
    for name in INTEGRATORS:
        run(scene, Setting(name, 1.0, None, 2), 1)


def run(scene: Scene, setting: Setting, steps: int) -> tuple[float, list[Rollout] | None]:
    """Run a setting; returns the seconds and each cloth's steps, None where one diverged."""
    applied, tolerance = setting.applied(scene), setting.tolerance or scene.tolerance
    seconds, found, good = 0.0, [], True
    for index in range(len(scene.cloths)):
        system = build(applied, index)
        with undisturbed():
            began = time.perf_counter()
            memory, end = rollout(system, steps, tolerance)
            seconds += time.perf_counter() - began
        found.append(memory)
        good = good and end == steps
    return seconds, found if good else None


@contextmanager
def undisturbed() -> Iterator[None]:
    """Without the garbage collector."""
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if before:
            gc.enable()


def judge(scene: Scene, trial: Trial, reference: Array) -> None:
    """Run a trial once and compare it with the reference (F, vertices, 3)."""
    seconds, found = run(scene, trial.setting, trial.steps)
    trial.status = "diverged" if found is None else "done"
    if found is None:
        return
    trial.seconds.append(seconds)
    frames, first = len(reference), 0
    sums, largest = np.zeros(frames), np.zeros(frames)
    for memory in found:
        last = first + memory.x.shape[1]
        gap = sampled(memory.x, trial.setting.ratio, frames) - reference[:, first:last]
        squares = (gap**2).sum(axis=2)
        sums += squares.sum(axis=1)
        largest = np.maximum(largest, squares.max(axis=1, initial=0.0))
        first = last
    trial.squares, trial.largest = sums / first, np.sqrt(largest)


def sampled(x: Array, ratio: float, frames: int) -> Array:
    """Positions (frames, n, 3) at the scene's frames of steps x (T + 1, n, 3) that are `ratio` times as long; between
    two steps on the straight line.
    """
    if ratio <= 1.0:
        return x[:: round(1.0 / ratio)]
    place = np.arange(frames) / ratio
    step = np.minimum(place.astype(int), len(x) - 2)
    fraction = (place - step)[:, None, None]
    between: Array = (1.0 - fraction) * x[step] + fraction * x[step + 1]
    return between


def expected(trial: Trial, before: Sequence[Trial]) -> float:
    """How long a run will take, s, by the steps of the same kind that were run before; else by those of the dearest
    kind, or of the cheapest where the trial is explicit, as such a step costs no more than any other.
    """
    known = [t for t in before if t.seconds]
    same = [t for t in known if t.setting.kind == trial.setting.kind]
    paces = [t.seconds[0] / t.steps for t in same[-1:] or known]
    return (max if trial.setting.newton else min)(paces, default=0.0) * trial.steps


def repeat(scene: Scene, trials: Sequence[Trial], deadline: float) -> Iterator[int]:
    """Run the trials again in turn and yield the number of each round, until each trial has TIMED_RUNS runs.

    A run that would not end before `deadline`, a value of the performance counter, is left out.
    """
    for number in range(2, TIMED_RUNS + 1):
        yield number
        for trial in trials:
            if time.perf_counter() + 1.5 * trial.seconds[-1] < deadline:
                trial.seconds.append(run(scene, trial.setting, trial.steps)[0])
