"""Running a scene with one setting: how long its steps take, and how far from a reference they end.

The clock covers the compiled loop over all steps of all cloths, one after another, in one thread, with the garbage
collector off. It does not cover building arrays, comparing and writing.
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
from clothfit.motion.times import interpolated, snapped
from clothfit.scene.kinds import INTEGRATORS
from clothfit.scene.scene import Scene

TIMED_RUNS = 5
"""Most runs of each setting: their median is right even if the machine was disturbed during two of them."""
SOLVE_EFFORT = 5  # explicit steps that cost about as much as a linear solve
MOST_STATE_BYTES = 2e9  # for the states of one cloth in a run


@dataclass
class Trial:
    """A setting and its measurements over F frames."""

    setting: Setting
    steps: int
    status: str = "skipped"  # until it is judged; then "done" or "diverged"
    seconds: list[float] = field(default_factory=list)  # of each run
    squares: Array | None = None  # (F,), m²: squared distance to the reference, mean over the vertices
    largest: Array | None = None  # (F,), m: largest distance of a vertex

    @property
    def effort(self) -> int:
        """Rough cost of a run in explicit steps, to order the runs by."""
        return self.steps * (SOLVE_EFFORT * self.setting.newton if self.setting.newton else 1)

    def needs(self, scene: Scene) -> int:
        """Bytes of the states that a run of the largest cloth keeps."""
        return 24 * (self.steps + 1) * (1 + (self.setting.newton or 1)) * max(scene.vertex_counts)


def warm_up(scene: Scene) -> None:
    """Run a step of each integrator, so that compiling is not timed."""
    for name in INTEGRATORS:
        run(scene, Setting(name, 1.0, None, 2), 1)


def run(scene: Scene, setting: Setting, steps: int) -> tuple[float, list[Rollout] | None]:
    """Run a setting; returns the seconds, and the states of each cloth, or None if one diverged."""
    applied, tolerance = setting.applied(scene), setting.tolerance or scene.tolerance
    seconds, found, good = 0.0, [], True
    for index in range(len(scene.cloths)):
        system = build(applied, index, steps=steps)
        with undisturbed():
            began = time.perf_counter()
            memory, end = rollout(system, steps, tolerance)
            seconds += time.perf_counter() - began
        found.append(memory)
        good = good and end == steps
    return seconds, found if good else None


@contextmanager
def undisturbed() -> Iterator[None]:
    """Turn the garbage collector off within the block."""
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
    """Positions (frames, n, 3) at the scene's frames, interpolated linearly between states x (T + 1, n, 3).

    A step between two states is `ratio` times the scene's.
    """
    return interpolated(x, *snapped(np.arange(frames) / ratio))


def expected(trial: Trial, before: Sequence[Trial]) -> float:
    """Predicted seconds of a run, from earlier steps of the same kind, or else from the slowest steps so far.

    An explicit step costs no more than any other, so it is predicted from the fastest.
    """
    known = [t for t in before if t.seconds]
    same = [t for t in known if t.setting.kind == trial.setting.kind]
    paces = [t.seconds[0] / t.steps for t in same[-1:] or known]
    return (max if trial.setting.newton else min)(paces, default=0.0) * trial.steps


def rerun(scene: Scene, trials: Sequence[Trial], deadline: float) -> Iterator[int]:
    """Run the trials again in turn and yield the number of each round, until each trial has TIMED_RUNS runs.

    A run that would not end before `deadline`, a value of the performance counter, is left out.
    """
    for number in range(2, TIMED_RUNS + 1):
        yield number
        for trial in trials:
            if time.perf_counter() + 1.5 * trial.seconds[-1] < deadline:
                trial.seconds.append(run(scene, trial.setting, trial.steps)[0])
