"""Speed against error: what each integrator, step, tolerance and number of Newton iterations costs on a scene, and how
far its motion is from the one that all of them approach as h → 0.

The error is the distance to that reference (`reference`), root mean square over all vertices of all cloths and over
the scene's frames, which are multiples of its delta, the initial one included. The cost is the time of the bare steps,
the median of runs that go round all settings, so that a machine that slows down does so for all. The clock covers the
compiled loop over all steps of all cloths, one after another, in one thread, with the garbage collector off, and not
building arrays, comparing and writing.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from timeit import timeit

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.engine.rollout import Rollout, rollout
from clothfit.engine.system import BDF2, IMPLICIT, build
from clothfit.evaluation.reference import EXTENT_ROUNDING, Reference, converged, extent, root_mean_square
from clothfit.motion.times import interpolated, snapped
from clothfit.scene.kinds import INTEGRATORS, REST
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


def run(scene: Scene, setting: Setting, steps: int) -> tuple[float, list[Rollout] | None]:
    """Run a setting; returns the seconds, and the states of each cloth, or None if one diverged."""
    applied, tolerance = setting.applied(scene), setting.tolerance or scene.tolerance
    seconds, found = 0.0, list[tuple[Rollout, int]]()
    for index in range(len(scene.cloths)):
        play = partial(rollout, build(applied, index, steps=steps), steps, tolerance)
        seconds += timeit(lambda play=play: found.append(play()), number=1)  # type: ignore[misc]  # collects no garbage
    return seconds, [motion for motion, _ in found] if all(end == steps for _, end in found) else None


def measured(scene: Scene, trial: Trial, reference: Array) -> None:
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


MEASURE_SECONDS = 60.0  # for everything
REFERENCE_SHARE, FIRST_RUN_SHARE = 0.25, 0.45
"""Parts of these seconds for the reference and for the first run of each setting; the rest is for repetitions."""
REFERENCE_SECONDS = 3.0  # for the reference at least, as nothing can be compared without one
REFERENCE_MARGIN = 5.0
"""A frame counts where the estimated error of the reference is this many times smaller than that of any setting."""
DIVERGED_EXTENTS = 1.0
"""A motion farther from the reference than this many times the extent of all positions has diverged, even though its
numbers are finite."""


@dataclass(frozen=True)
class Row:
    """One setting, its cost and its error; numbers are None unless the status is "done"."""

    setting: Setting  # integrator, step relative to delta, tolerance, Newton iterations
    step: float  # h, s
    status: str  # "done"; "diverged"; "skipped": it did not fit into the time or the memory
    own: bool  # whether this is the scene's own setting
    runs: int = 0  # timed
    ms_per_step: float | None = None  # of all cloths together
    seconds_per_second: float | None = None  # of computing, per simulated second
    error: float | None = None  # root mean square distance to the reference, m
    max_error: float | None = None  # largest distance of a vertex, m
    pareto: bool = False  # whether no other row is cheaper and as near, or nearer and as cheap

    @property
    def cost_and_error(self) -> tuple[float, float]:
        """Seconds per simulated second and error; infinite unless it is done."""
        if self.seconds_per_second is None or self.error is None:
            return math.inf, math.inf
        return self.seconds_per_second, self.error


@dataclass(frozen=True, eq=False)
class WorkPrecision:
    """The cost and the error of each setting."""

    scene: str  # its name
    delta: float  # its time step, s
    tolerance: float  # of its linear systems
    frames: int  # simulated, the initial one included
    reference: Reference  # over the frames that are compared: fewer where it is not known to the end
    rows: list[Row]  # integrators in turn, long steps before short ones

    @property
    def own(self) -> Row:
        """The row of the scene's own setting, with which the editor plays it."""
        return next(row for row in self.rows if row.own)

    @property
    def nearest(self) -> Row | None:
        """The row with the smallest error; None where all settings failed."""
        done = [row for row in self.rows if row.status == "done"]
        return min(done, key=lambda row: row.cost_and_error[::-1], default=None)

    def recommended(self, error: float) -> Row | None:
        """The cheapest row whose error, with that of the reference, is at most `error`, m; None where there is none.

        Raises InvalidInput unless `error` is above 0 and finite.
        """
        if not 0 < error < math.inf:
            raise InvalidInput(f"error must be above 0 and finite; {error:g} m was given")
        near = [row for row in self.rows if row.cost_and_error[1] + self.reference.error <= error]
        return min(near, key=lambda row: row.cost_and_error, default=None)


def work_precision(
    scene: Scene,
    frames: int | None = None,
    seconds: float = MEASURE_SECONDS,
    report: Callable[[float, str], None] | None = None,
) -> WorkPrecision:
    """Measure integrators, steps, tolerances and Newton iterations on a scene, over `frames` frames (default: its own).

    It takes about `seconds`, or less. With less time, settings run less often, the most expensive are skipped, and the
    reference is less exact. `report` is called with the seconds since the start and what is being done. Raises
    InvalidInput on impossible values, Diverged when no steps that fit into the time give a reference.
    """
    if not 0 < seconds < math.inf:
        raise InvalidInput(f"seconds must be above 0 and finite; {seconds:g} was given")
    if scene.self_contact:
        raise InvalidInput(
            f"{scene.name}: integrators are compared by a motion that follows the forces alone, and with selfCollision "
            "steps also keep the cloth from passing through itself; leave that out of the scene"
        )
    count = scene.frames if frames is None else frames
    for name in INTEGRATORS[:REST]:  # a step of each, so that compiling is not timed
        run(scene, Setting(name, 1.0, None, 2), 1)
    began = time.perf_counter()

    def announce(task: str) -> float:
        now = time.perf_counter() - began
        if report:
            report(now, task)
        return now

    announce("reference motion")
    reference = converged(scene, count, max(REFERENCE_SHARE * seconds, REFERENCE_SECONDS))
    trials = [Trial(setting, setting.steps(count)) for setting in grid(scene)]
    cheap_first = sorted(trials, key=lambda trial: trial.effort)
    limit = announce("settings") + FIRST_RUN_SHARE * seconds
    for done, trial in enumerate(cheap_first):
        spent = announce(f"setting {done + 1} of {len(trials)}")
        fits = spent + expected(trial, cheap_first[:done]) <= limit or trial.setting == own(scene)
        if fits and trial.needs(scene) <= MOST_STATE_BYTES:
            measured(scene, trial, reference.positions)
    for number in rerun(scene, [trial for trial in cheap_first if trial.status == "done"], began + seconds):
        announce(f"repetition {number - 1}")
    return table(scene, trials, reference)


def table(scene: Scene, trials: Sequence[Trial], reference: Reference) -> WorkPrecision:
    """The results of trials, over the frames where the reference is known."""
    known = reference.upto(known_frames(trials, reference))
    rows = [row(scene, trial, known) for trial in trials]
    best = front([r.cost_and_error for r in rows])
    marked = [replace(r, pareto=bool(flag)) for r, flag in zip(rows, best, strict=True)]
    return WorkPrecision(scene.name, scene.delta, scene.tolerance, len(reference.positions), known, marked)


def known_frames(trials: Sequence[Trial], reference: Reference) -> int:
    """The number of frames before the error of the reference comes near that of the most exact setting.

    Raises InvalidInput when it is less than two.
    """
    floor = EXTENT_ROUNDING * extent(reference.positions)
    errors = [rmse_until(t.squares) for t in trials if t.squares is not None]
    nearest = np.min(errors, axis=0) if errors else np.full(len(reference.errors), np.inf)
    unknown = rmse_until(reference.errors**2) > np.maximum(nearest / REFERENCE_MARGIN, floor)
    frames = int(np.argmax(unknown)) if unknown.any() else len(unknown)
    if frames < 2:
        raise InvalidInput("the reference motion is not known well enough to judge by; allow more time (--budget)")
    return frames


def rmse_until(squares: Array) -> Array:
    """Root mean square over all frames up to each one (F,), from the squares (F,) of each."""
    size: Array = np.sqrt(np.cumsum(squares) / np.arange(1, len(squares) + 1))
    return size


def row(scene: Scene, trial: Trial, reference: Reference) -> Row:
    """The row of a trial, over the frames of the reference."""
    setting, frames = trial.setting, len(reference.positions)
    made = Row(setting, setting.ratio * scene.delta, trial.status, setting == own(scene))
    if trial.squares is None or trial.largest is None:
        return made
    error = root_mean_square(np.sqrt(trial.squares[:frames]))
    if error > DIVERGED_EXTENTS * extent(reference.positions):
        return replace(made, status="diverged")
    per_step = float(np.median(trial.seconds)) / trial.steps
    return replace(
        made,
        runs=len(trial.seconds),
        ms_per_step=1e3 * per_step,
        seconds_per_second=per_step / made.step,
        error=error,
        max_error=float(trial.largest[:frames].max()),
    )


def front(points: Sequence[tuple[float, float]]) -> Flags:
    """Which (cost, error) are Pareto-best: finite, and no other is cheaper and as near, or nearer and as cheap.

    Of equal ones the first.
    """
    best = np.zeros(len(points), bool)
    lowest = math.inf
    for i in sorted(range(len(points)), key=lambda i: points[i]):  # cheapest first; keeps the order of equal ones
        if points[i][1] < lowest:
            best[i], lowest = True, points[i][1]
    return best
