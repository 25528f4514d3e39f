"""Settings to simulate a scene with (integrator, time step, tolerance of the linear systems, Newton iterations); how
long the steps of each take, and how far from a reference they end.

The clock covers the compiled loop over all steps of all cloths, one after another, in one thread, with the garbage
collector off. It does not cover building arrays, comparing and writing.
"""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.rollout import Rollout, rollout
from clothfit.engine.system import BDF2, IMPLICIT, build
from clothfit.motion.times import interpolated, snapped
from clothfit.scene.kinds import INTEGRATORS
from clothfit.scene.scene import Scene

EXPLICIT_RATIOS = (1.0, 1 / 2, 1 / 4, 1 / 8, 1 / 16, 1 / 32)
"""Steps of the explicit integrators to try, relative to the scene's delta; they are stable only when short."""
IMPLICIT_RATIOS = (4.0, 2.0, 1.0, 1 / 2, 1 / 4, 1 / 8)
"""Steps of the implicit integrator and of BDF2 to try; powers of two, so they reach the frames without rounding."""
TOLERANCES = (1e-3, 1e-5, 1e-8)
NEWTON_COUNTS = (1, 2, 4)

TIMED_RUNS = 5
"""Most runs of each setting: their median is right even if the machine was disturbed during two of them."""
SOLVE_EFFORT = 5  # explicit steps that cost about as much as a linear solve
MOST_STATE_BYTES = 2e9  # for the states of one cloth in a run


@dataclass(frozen=True)
class Setting:
    """An integrator with its step and accuracy."""

    integrator: str  # one of INTEGRATORS
    ratio: float  # h over the scene's delta
    tolerance: float | None  # of the linear systems, relative; None: it solves none
    newton: int | None  # iterations per step; None: it makes none

    def applied(self, scene: Scene) -> Scene:
        """The scene with this setting."""
        method = INTEGRATORS.index(self.integrator)
        return replace(scene, method=method, delta=self.ratio * scene.delta, newton_iterations=self.newton or 1)

    def steps(self, frames: int) -> int:
        """Number of steps that reach the last of `frames` frames of the scene's delta, or go beyond it."""
        return math.ceil((frames - 1) / self.ratio)

    @property
    def step_name(self) -> str:
        """Its step in terms of the scene's delta, h: 4 h, h, h/4."""
        if self.ratio < 1.0:
            return f"h/{round(1.0 / self.ratio)}"
        return "h" if self.ratio == 1.0 else f"{self.ratio:g} h"

    @property
    def kind(self) -> tuple[str, float | None, int | None]:
        """All but the step."""
        return self.integrator, self.tolerance, self.newton


def own(scene: Scene) -> Setting:
    """The scene's own setting, with which the editor plays it."""
    solves = scene.method in (IMPLICIT, BDF2)
    tolerance, newton = (scene.tolerance, scene.newton_iterations) if solves else (None, None)
    return Setting(INTEGRATORS[scene.method], 1.0, tolerance, newton)


def grid(scene: Scene) -> list[Setting]:
    """The settings to try, including the scene's own: integrators in turn, long steps before short ones."""
    found = [Setting(name, ratio, None, None) for name in INTEGRATORS[:IMPLICIT] for ratio in EXPLICIT_RATIOS]
    # scenes write 1e-5 as a float32 in full, which is not exactly 1e-5
    others = [t for t in TOLERANCES if not math.isclose(t, scene.tolerance, rel_tol=1e-3)]
    tolerances = sorted([scene.tolerance, *others], reverse=True)
    iterations = sorted({scene.newton_iterations, *NEWTON_COUNTS})
    once = sorted({scene.newton_iterations, 1}) if scene.method == BDF2 else [1]  # more gain nothing: see `step.bdf2`
    found += [
        Setting(INTEGRATORS[method], ratio, tolerance, newton)
        for method, counts in ((IMPLICIT, iterations), (BDF2, once))
        for newton in counts
        for tolerance in tolerances
        for ratio in IMPLICIT_RATIOS
    ]
    return found


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
