"""The motion of a scene for h → 0, with an estimate of its error.

R_m is the motion by BDF2 with m steps per frame. m doubles until the last two motions agree; the finer one is the
result, and its distance from the coarser is reported as its error. That is a cautious estimate: at order q the error
that is left is (2^q − 1) times smaller, a third at the order 2 of BDF2. Where forces have kinks (spheres), q falls to
about 1 and the estimate remains valid. Where a motion is chaotic its late frames may not converge; the estimate of each
frame shows that.
"""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import dataclass, replace

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.memory import check_memory
from clothfit.engine.system import BDF2
from clothfit.motion.divergence import Diverged
from clothfit.motion.simulate import simulate
from clothfit.scene.kinds import INTEGRATORS
from clothfit.scene.scene import Scene

FIRST_SUBSTEPS, LEAST_SUBSTEPS, MOST_SUBSTEPS = 4, 128, 2**14
"""Steps per frame: of the first motion, of one that is fine enough where there is time, and of the finest: beyond,
rounding grows faster than the error falls."""
REFERENCE_ERROR = 1e-5
"""Estimated error, relative to the extent of the motion, at which the steps are short enough: the errors to measure are
1e-4 and more."""
EXTENT_ROUNDING = 1e-12  # smaller differences, relative to the extent of the motion, show no order
REFERENCE_TOLERANCE = 1e-10  # of the linear systems: far below what the steps' length leaves
KEPT_MOTIONS = 3


@dataclass(frozen=True, eq=False)
class Reference:
    """The motion of a scene for h → 0, with its estimated error."""

    positions: Array  # (frames, vertices, 3), m, all objects in file order
    errors: Array  # (frames,), m: estimated error of each frame, root mean square over the vertices
    step: float  # of the finest run, s
    order: float | None  # of convergence, measured; None: the runs agree to rounding, or only two were made
    integrator: str = INTEGRATORS[BDF2]

    @property
    def error(self) -> float:
        """Estimated error over all frames, m, root mean square."""
        return root_mean_square(self.errors)

    def upto(self, frames: int) -> Reference:
        """Its first `frames` frames."""
        return replace(self, positions=self.positions[:frames], errors=self.errors[:frames])


def converged(scene: Scene, frames: int, seconds: float = math.inf, error: float = REFERENCE_ERROR) -> Reference:
    """The motion of the scene for h → 0 over `frames` frames of its delta.

    Steps are halved until they are delta/128 or shorter and the estimated error is at most `error` times the extent of
    the motion, or until the next halving would not end within `seconds`. Raises InvalidInput when there are fewer than
    2 frames, or more than fit into memory; Diverged when fewer than two runs that fit into the time stay finite.
    """
    if frames < 2:
        raise InvalidInput(f"frames must be at least 2 to compare; {frames} was given")
    check_memory(frames, sum(scene.vertex_counts), KEPT_MOTIONS - 1)
    moving(scene, 2, 1)  # compiling shall not count
    runs: list[Array] = []
    substeps, began, last = FIRST_SUBSTEPS // 2, time.perf_counter(), 0.0
    while substeps < MOST_SUBSTEPS and time.perf_counter() - began + 2.0 * last <= seconds:
        if substeps >= LEAST_SUBSTEPS and agree(runs, error):
            break
        before = time.perf_counter()
        substeps *= 2
        found = moving(scene, frames, substeps)
        runs = [] if found is None else [*runs[-2:], found]
        last = time.perf_counter() - before
    if len(runs) < 2:
        raise Diverged(
            f"{scene.name}: no steps that fit into the time are short enough for a reference motion; allow more time "
            "(--budget) or fewer frames (--steps)",
            0,
        )
    return Reference(runs[-1], per_frame(runs[-1] - runs[-2]), scene.delta / substeps, order_of(runs))


def moving(scene: Scene, frames: int, substeps: int) -> Array | None:
    """Positions (frames, vertices, 3) of all objects with `substeps` steps per frame; None where one diverges."""
    fine = scene.with_step(scene.delta / substeps, (frames - 1) * substeps + 1, BDF2)
    try:
        return simulate(fine, tolerance=REFERENCE_TOLERANCE).positions[::substeps].copy()
    except Diverged:
        return None


def agree(runs: list[Array], error: float) -> bool:
    """Whether the last two runs differ by at most `error` times their extent."""
    return len(runs) > 1 and root_mean_square(per_frame(runs[-1] - runs[-2])) <= error * extent(runs[-1])


def order_of(runs: list[Array]) -> float | None:
    """The measured order of convergence of three runs; None where there are two, or they differ by rounding only."""
    gaps = [root_mean_square(per_frame(fine - coarse)) for coarse, fine in itertools.pairwise(runs)]
    if len(gaps) < 2 or min(gaps) <= EXTENT_ROUNDING * extent(runs[-1]):
        return None
    return math.log2(gaps[0] / gaps[1])


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
