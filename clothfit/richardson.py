"""The motion that all time steps approach: h → 0 by Richardson, and how far from it the answer may be.

R_m is the motion by the Runge–Kutta method (`runge_kutta`) with m steps per frame. m doubles; two successive ones,
whose errors are in the ratio 2⁴, give the extrapolant

    E_m = R_m + (R_m − R_{m/2}) / (2⁴ − 1)

and two successive extrapolants the estimate |E_m − E_{m/2}| of the error of the coarser one, which is what is told: the
finer is given out. Where the forces have kinks (spheres) the errors fall more slowly; the extrapolation then gains
nothing, does no harm, and the estimate stays one. Where the motion is chaotic a late frame may not settle at all: the
estimate says so, frame by frame. L. F. Richardson (1911); E. Hairer et al. (1993), II.4.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clothfit.arrays import Array
from clothfit.errors import Diverged, InvalidInput
from clothfit.runge_kutta import record
from clothfit.scene import Scene
from clothfit.system import build

ORDER = 4
FINEST = 2**14  # steps per frame: beyond, rounding grows faster than the error falls
GOAL = 1e-7
"""Estimated error, relative to the extent of the motion, at which the steps are small enough: coarse steps of a method
of first order, the ones to judge, are off by 1e-3 and more."""
ROUNDING = 1e-12  # differences below this, relative to the extent, show no order


@dataclass(frozen=True, eq=False)
class Reference:
    """The motion of a scene for h → 0, as far as it is known."""

    positions: Array  # (frames, vertices, 3), m, all objects in file order
    errors: Array  # (frames,), m: estimated error of each frame, root mean square over the vertices
    step: float  # of its finest run, s
    order: float | None  # at which the runs approach each other; None: they agree to rounding

    @property
    def error(self) -> float:
        """Estimated error over all its frames, m, root mean square."""
        return root_mean_square(self.errors)

    def upto(self, frames: int) -> Reference:
        """Its first frames alone."""
        return Reference(self.positions[:frames], self.errors[:frames], self.step, self.order)


def converged(scene: Scene, frames: int, seconds: float = math.inf, goal: float = GOAL) -> Reference:
    """The motion of the scene for h → 0 over `frames` frames of its delta.

    Steps are halved until the estimated error is `goal` times the extent of the motion, or the next halving would not
    end within `seconds`; what the error then is, it says. Raises InvalidInput when there are fewer than 2 frames;
    Diverged when no steps that fit into the time give a finite motion, or only one does.
    """
    if frames < 2:
        raise InvalidInput(f"frames: {frames} is too few to compare, at least 2 are needed")
    run(scene, 2, 1)  # so that compiling does not count
    sequence = Sequence(lambda m: run(scene, frames, m))
    began, substeps, last = time.perf_counter(), 1, 0.0
    while substeps < FINEST and (substeps == 1 or time.perf_counter() - began + 2.0 * last <= seconds):
        before = time.perf_counter()
        substeps *= 2
        sequence.refine(substeps)
        last = time.perf_counter() - before
        if sequence.error() <= goal * extent(sequence.best()):
            break
    if not np.isfinite(sequence.error()):
        raise Diverged(
            f"{scene.name}: steps of delta / {substeps} are still too long for a reference motion, and shorter ones "
            "do not fit into the time; allow more of it, or fewer steps",
            0,
        )
    return Reference(sequence.best(), sequence.errors(), scene.delta / substeps, sequence.order())


class Sequence:
    """Runs at steps that are halved again and again, and their extrapolants."""

    def __init__(self, run: Callable[[int], Array | None], order: int = ORDER) -> None:
        """`run` gives the positions (frames, n, 3) with so many steps per frame, None where it diverges; its error
        falls with that order.
        """
        self.run = run
        self.gain = 2.0**order - 1.0
        self.runs: list[Array] = []  # the last, at most three
        self.extrapolants: list[Array] = []  # the last, at most two

    def refine(self, substeps: int) -> None:
        """Make the next run, with twice as many steps as the last."""
        found = self.run(substeps)
        if found is None:
            self.runs, self.extrapolants = [], []
            return
        self.runs = [*self.runs[-2:], found]
        if len(self.runs) > 1:
            extrapolant = found + (found - self.runs[-2]) / self.gain
            self.extrapolants = [*self.extrapolants[-1:], extrapolant]

    def best(self) -> Array:
        """The best motion so far."""
        return self.extrapolants[-1] if self.extrapolants else np.zeros((1, 1, 3))

    def errors(self) -> Array:
        """Its estimated error in each frame (frames,); infinite with fewer than three runs."""
        if len(self.extrapolants) < 2:
            return np.array([np.inf])
        return per_frame(self.extrapolants[1] - self.extrapolants[0])

    def error(self) -> float:
        """Its estimated error over all frames."""
        return root_mean_square(self.errors())

    def order(self) -> float | None:
        """The order at which the last three runs approach each other; None where rounding is all that is left."""
        coarse, fine = (root_mean_square(per_frame(b - a)) for a, b in zip(self.runs, self.runs[1:], strict=False))
        if min(coarse, fine) <= ROUNDING * extent(self.runs[-1]):
            return None
        return math.log2(coarse / fine)


def run(scene: Scene, frames: int, substeps: int) -> Array | None:
    """Positions (frames, vertices, 3) of all objects, with so many steps per frame; None where one diverges."""
    found = []
    for index in range(len(scene.cloths)):
        positions = record(build(scene, index), scene.delta, frames, substeps)
        if positions is None:
            return None
        found.append(positions)
    return np.concatenate(found, axis=1)


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
