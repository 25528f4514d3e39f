"""The motion that all time steps approach: h → 0 by Richardson, and how far from it the answer may be.

R_m is a motion with m steps per frame by a method of order q. m doubles; two successive ones, whose errors are in the
ratio 2^q, give the extrapolant

    E_m = R_m + (R_m − R_{m/2}) / (2^q − 1)

and two successive extrapolants the estimate |E_m − E_{m/2}| of the error of the coarser one, which is what is told: the
finer is given out. The method is that of Runge and Kutta (`runge_kutta`), q = 4, which shares nothing with the steps to
be judged but the forces. Where no steps that fit into the time are short enough for it, as in cloths that are damped
very strongly, it is the implicit step itself, q = 1.

Where the forces have kinks (spheres) the errors fall more slowly than that; the extrapolation then gains nothing, does
no harm, and the estimate stays one. Where the motion is chaotic a late frame may not settle at all: the estimate says
so, frame by frame. L. F. Richardson (1911); E. Hairer et al. (1993), II.4.
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
from clothfit.engine.rollout import rollout
from clothfit.engine.system import IMPLICIT, build
from clothfit.evaluation.runge_kutta import record
from clothfit.motion.divergence import Diverged
from clothfit.scene.scene import Scene

MOST_SUBSTEPS = 2**14  # steps per frame: beyond, rounding grows faster than the error falls
REFERENCE_ERROR = 1e-7
"""Estimated error, relative to the extent of the motion, at which the steps are small enough: coarse steps of a method
of first order, the ones to judge, are off by 1e-3 and more."""
EXTENT_ROUNDING = 1e-12  # differences below this, relative to the extent, show no order
REFERENCE_TOLERANCE = 1e-10  # tolerance of the implicit steps: far below what their length leaves

KEPT_MOTIONS = 5  # motions: three runs and two extrapolants
RUNGE_KUTTA_SHARE = 0.5  # of the time, after which Runge–Kutta must have shown that its steps can be short enough

Recorder = Callable[[Scene, int, int, int], Array | None]
"""Positions (frames, n, 3) of one cloth, by its index, with so many frames and steps per frame; None: it diverged."""


@dataclass(frozen=True, eq=False)
class Reference:
    """The motion of a scene for h → 0, as far as it is known."""

    positions: Array  # (frames, vertices, 3), m, all objects in file order
    errors: Array  # (frames,), m: estimated error of each frame, root mean square over the vertices
    step: float  # of its finest run, s
    order: float | None  # at which the runs approach each other; None: they agree to rounding
    integrator: str  # "Runge-Kutta" or "implicit"

    @property
    def error(self) -> float:
        """Estimated error over all its frames, m, root mean square."""
        return root_mean_square(self.errors)

    def upto(self, frames: int) -> Reference:
        """Its first frames alone."""
        return replace(self, positions=self.positions[:frames], errors=self.errors[:frames])


class Halving:
    """Runs at steps that are halved again and again, and their extrapolants."""

    def __init__(self, run: Callable[[int], Array | None], order: int) -> None:
        """`run` gives the positions (frames, n, 3) with so many steps per frame, None where it diverges; its error
        falls with that order.
        """
        self.run = run
        self.gain = 2.0**order - 1.0
        self.substeps = 1  # of the last run
        self.runs: list[Array] = []  # the last, at most three
        self.extrapolants: list[Array] = []  # the last, at most two

    def refine(self) -> None:
        """Make the next run, with twice as many steps as the last."""
        self.substeps *= 2
        found = self.run(self.substeps)
        if found is None:
            self.runs, self.extrapolants = [], []
            return
        if self.runs:
            self.extrapolants = [*self.extrapolants[-1:], found + (found - self.runs[-1]) / self.gain]
        self.runs = [*self.runs[-2:], found]

    def settle(self, seconds: float, goal: float) -> float:
        """Refine until the error is at most `goal` times the extent, or the next run would not end within `seconds`;
        returns what is left of them.
        """
        began, last = time.perf_counter(), 0.0
        while self.substeps < MOST_SUBSTEPS and time.perf_counter() - began + 2.0 * last <= seconds:
            if self.known and root_mean_square(self.errors()) <= goal * extent(self.runs[-1]):
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
        """Estimated error of the last extrapolant in each frame (frames,), where it is known."""
        return per_frame(self.extrapolants[1] - self.extrapolants[0])

    def order(self) -> float | None:
        """The order at which the last three runs approach each other; None where rounding is all that is left."""
        coarse, fine = (root_mean_square(per_frame(b - a)) for a, b in zip(self.runs, self.runs[1:], strict=False))
        if min(coarse, fine) <= EXTENT_ROUNDING * extent(self.runs[-1]):
            return None
        return math.log2(coarse / fine)


def converged(scene: Scene, frames: int, seconds: float = math.inf, goal: float = REFERENCE_ERROR) -> Reference:
    """The motion of the scene for h → 0 over `frames` frames of its delta.

    Steps are halved until the estimated error is `goal` times the extent of the motion, or the next halving would not
    end within `seconds`; what the error then is, it says. Raises InvalidInput when there are fewer than 2 frames, or
    more than memory holds; Diverged when no steps that fit into the time give a finite motion, or too few to know how
    good it is.
    """
    if frames < 2:
        raise InvalidInput(f"frames must be at least 2 to compare; {frames} was given")
    check_memory(frames, sum(scene.vertex_counts), KEPT_MOTIONS - 1)
    left = seconds
    for integrator, recorder, order in ("Runge-Kutta", explicit, 4), ("implicit", implicit, 1):
        moving(scene, recorder, 2, 1)  # so that compiling does not count
        halving = Halving(partial(moving, scene, recorder, frames), order)
        left = (1.0 - RUNGE_KUTTA_SHARE) * left + halving.settle(RUNGE_KUTTA_SHARE * left, goal)
        if halving.known:
            halving.settle(left, goal)
            step = scene.delta / halving.substeps
            return Reference(halving.extrapolants[1], halving.errors(), step, halving.order(), integrator)
    raise Diverged(
        f"{scene.name}: no steps that fit into the time are short enough for a reference motion; allow more of it "
        "(--budget), or fewer frames (--steps)",
        0,
    )


def moving(scene: Scene, recorder: Recorder, frames: int, substeps: int) -> Array | None:
    """Positions (frames, vertices, 3) of all objects, with so many steps per frame; None where one diverges."""
    found = []
    for index in range(len(scene.cloths)):
        positions = recorder(scene, index, frames, substeps)
        if positions is None:
            return None
        found.append(positions)
    return np.concatenate(found, axis=1)


def explicit(scene: Scene, index: int, frames: int, substeps: int) -> Array | None:
    """A cloth by the method of Runge and Kutta."""
    return record(build(scene, index), scene.delta, frames, substeps)


def implicit(scene: Scene, index: int, frames: int, substeps: int) -> Array | None:
    """A cloth by linearised implicit steps, frame by frame, so that only the states at the frames are kept."""
    short = replace(scene, method=IMPLICIT, delta=scene.delta / substeps, newton_iterations=1)
    system = build(short, index)
    positions = np.empty((frames, *system.x0.shape))
    positions[0] = system.x0
    for frame in range(1, frames):
        memory, good = rollout(system, substeps, REFERENCE_TOLERANCE)
        if good < substeps:
            return None
        positions[frame] = memory.x[-1]
        system = system._replace(x0=memory.x[-1].copy(), v0=memory.w[-1, memory.used[-1] - 1].copy())
    return positions


def per_frame(gap: Array) -> Array:
    """Root mean square length of the vectors (frames, n, 3) of each frame."""
    size: Array = np.sqrt((gap**2).sum(axis=2).mean(axis=1))
    return size


def root_mean_square(values: Array) -> float:
    """Of values (frames,)."""
    return float(np.sqrt((values**2).mean()))


def extent(positions: Array) -> float:
    """Diagonal of the box that all positions (frames, n, 3) fill, m."""
    points = positions.reshape(-1, 3)
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
