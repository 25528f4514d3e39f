"""The limit h → 0 of a motion by Richardson extrapolation, with an estimate of its error.

R_m is a motion with m steps per frame by a method of order q. m doubles; the errors of two successive motions are in
the ratio 2^q and give the extrapolant

    E_m = R_m + (R_m − R_{m/2}) / (2^q − 1).

The finer of two successive extrapolants is the result; |E_m − E_{m/2}|, which estimates the error of the coarser, is
reported as its error. The method is that of Runge and Kutta (`runge_kutta`), q = 4, which shares only the forces with
the steps that are measured. Where the affordable steps are too long for it, as for very strongly damped cloths, it is
the implicit step itself, q = 1.

Where forces have kinks (spheres) the errors fall more slowly; the extrapolation then gains nothing and does no harm,
and the estimate remains valid. Where a motion is chaotic its late frames may not converge; the estimate of each frame
shows that. L. F. Richardson (1911); E. Hairer et al. (1993), II.4.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.memory import check_memory
from clothfit.engine.inputs.tables import later
from clothfit.engine.rollout import rollout
from clothfit.engine.system import IMPLICIT, build
from clothfit.evaluation.runge_kutta import record
from clothfit.motion.divergence import Diverged
from clothfit.scene.scene import Scene

MOST_SUBSTEPS = 2**14  # steps per frame: beyond, rounding grows faster than the error falls
REFERENCE_ERROR = 1e-7
"""Estimated error, relative to the extent of the motion, at which the steps are short enough: the errors to measure, of
a method of first order, are 1e-3 and more."""
EXTENT_ROUNDING = 1e-12  # smaller differences, relative to the extent of the motion, show no order
REFERENCE_TOLERANCE = 1e-10  # tolerance of the implicit steps: far below what their length leaves

KEPT_MOTIONS = 5  # three runs and two extrapolants
RUNGE_KUTTA_SHARE = 0.5  # of the time, in which Runge–Kutta must find steps that are short enough

Recorder = Callable[[Scene, int, int, int], Array | None]
"""(scene, index of a cloth, frames, steps per frame) → its positions (frames, n, 3), m; None where it diverged."""


@dataclass(frozen=True, eq=False)
class Reference:
    """The motion of a scene for h → 0, with its estimated error."""

    positions: Array  # (frames, vertices, 3), m, all objects in file order
    errors: Array  # (frames,), m: estimated error of each frame, root mean square over the vertices
    step: float  # of the finest run, s
    order: float | None  # of convergence, measured; None: the runs agree to rounding
    integrator: str  # "Runge-Kutta" or "implicit"

    @property
    def error(self) -> float:
        """Estimated error over all frames, m, root mean square."""
        return root_mean_square(self.errors)

    def upto(self, frames: int) -> Reference:
        """Its first `frames` frames."""
        return replace(self, positions=self.positions[:frames], errors=self.errors[:frames])


class Halving:
    """Runs at steps that are halved repeatedly, and their extrapolants."""

    def __init__(self, run: Callable[[int], Array | None], order: int) -> None:
        """`run` maps steps per frame to positions (frames, n, 3), or None where it diverges; its error has `order`."""
        self.run = run
        self.gain = 2.0**order - 1.0
        self.substeps = 1  # of the last run
        self.runs: list[Array] = []  # the last three
        self.extrapolants: list[Array] = []  # the last two

    def refine(self) -> None:
        """Run with twice as many steps as before."""
        self.substeps *= 2
        found = self.run(self.substeps)
        if found is None:
            self.runs, self.extrapolants = [], []
            return
        if self.runs:
            self.extrapolants = [*self.extrapolants[-1:], found + (found - self.runs[-1]) / self.gain]
        self.runs = [*self.runs[-2:], found]

    def refine_to(self, error: float, seconds: float) -> float:
        """Refine until the error is at most `error` times the extent, or the next run would not end in time.

        Returns what is left of the `seconds`.
        """
        began, last = time.perf_counter(), 0.0
        while self.substeps < MOST_SUBSTEPS and time.perf_counter() - began + 2.0 * last <= seconds:
            if self.known and root_mean_square(self.errors()) <= error * extent(self.runs[-1]):
                break
            before = time.perf_counter()
            self.refine()
            last = time.perf_counter() - before
        return seconds - (time.perf_counter() - began)

    @property
    def known(self) -> bool:
        """Whether there is an extrapolant with an estimate of its error."""
        return len(self.extrapolants) == 2

    def errors(self) -> Array:
        """Estimated error (frames,), m, of the last extrapolant; only where `known`."""
        return per_frame(self.extrapolants[1] - self.extrapolants[0])

    def order(self) -> float | None:
        """The measured order of convergence of the last three runs; None where they differ by rounding only."""
        coarse, fine = (root_mean_square(per_frame(b - a)) for a, b in zip(self.runs, self.runs[1:], strict=False))
        if min(coarse, fine) <= EXTENT_ROUNDING * extent(self.runs[-1]):
            return None
        return math.log2(coarse / fine)


def converged(scene: Scene, frames: int, seconds: float = math.inf, error: float = REFERENCE_ERROR) -> Reference:
    """The motion of the scene for h → 0 over `frames` frames of its delta.

    Steps are halved until the estimated error is at most `error` times the extent of the motion, or until the next
    halving would not end within `seconds`. Raises InvalidInput when there are fewer than 2 frames, or more than fit
    into memory; Diverged when too few runs that fit into the time stay finite to estimate the error.
    """
    if frames < 2:
        raise InvalidInput(f"frames must be at least 2 to compare; {frames} was given")
    check_memory(frames, sum(scene.vertex_counts), KEPT_MOTIONS - 1)
    left = seconds
    for integrator, recorder, order in ("Runge-Kutta", explicit, 4), ("implicit", implicit, 1):
        moving(scene, recorder, 2, 1)  # compiling shall not count
        halving = Halving(partial(moving, scene, recorder, frames), order)
        left = (1.0 - RUNGE_KUTTA_SHARE) * left + halving.refine_to(error, RUNGE_KUTTA_SHARE * left)
        if halving.known:
            halving.refine_to(error, left)
            step = scene.delta / halving.substeps
            return Reference(halving.extrapolants[1], halving.errors(), step, halving.order(), integrator)
    raise Diverged(
        f"{scene.name}: no steps that fit into the time are short enough for a reference motion; allow more time "
        "(--budget) or fewer frames (--steps)",
        0,
    )


def moving(scene: Scene, recorder: Recorder, frames: int, substeps: int) -> Array | None:
    """Positions (frames, vertices, 3) of all objects with `substeps` steps per frame; None where one diverges."""
    found = []
    for index in range(len(scene.cloths)):
        positions = recorder(scene, index, frames, substeps)
        if positions is None:
            return None
        found.append(positions)
    return np.concatenate(found, axis=1)


def explicit(scene: Scene, index: int, frames: int, substeps: int) -> Array | None:
    """Move one cloth by the method of Runge and Kutta; not where inputs change over time, which it takes as constant.
    """
    if scene.changes or scene.cloths[index].pins:
        return None
    return record(build(scene, index), scene.delta, frames, substeps)


def implicit(scene: Scene, index: int, frames: int, substeps: int) -> Array | None:
    """Move one cloth by linearised implicit steps, frame by frame, keeping the states at the frames only."""
    short = replace(scene, method=IMPLICIT, delta=scene.delta / substeps, newton_iterations=1)
    system = build(short, index, steps=(frames - 1) * substeps)
    positions = np.empty((frames, *system.x0.shape))
    positions[0] = system.x0
    for frame in range(1, frames):
        memory, good = rollout(system, substeps, REFERENCE_TOLERANCE)
        if good < substeps:
            return None
        positions[frame] = memory.x[-1]
        velocity = memory.w[-1, memory.used[-1] - 1].copy()
        system = system._replace(x0=memory.x[-1].copy(), v0=velocity, inputs=later(system.inputs, substeps))
    return positions


def per_frame(gap: Array) -> Array:
    """Root mean square length of the vectors (frames, n, 3) of each frame."""
    size: Array = np.sqrt((gap**2).sum(axis=2).mean(axis=1))
    return size


def root_mean_square(values: Array) -> float:
    """The root mean square of values (frames,)."""
    return float(np.sqrt((values**2).mean()))


def extent(positions: Array) -> float:
    """Diagonal of the bounding box of all positions (frames, n, 3), m."""
    points = positions.reshape(-1, 3)
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
