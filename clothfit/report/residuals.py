"""What is left between a fitted motion and its target: in time, over the cloth, and relative to the way it goes.

C compared frames, F shown ones, V vertices of all objects. A residual is the fitted position minus the target's.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array, Flags


@dataclass(frozen=True, eq=False)
class Residuals:
    """The residuals of a fitted motion, over the vertices that are compared."""

    mean: Array  # (C, 3), m, over the vertices, by component: a drift of the whole cloth
    of_vertices: Array  # (V,), m, root mean square over the fitted frames; NaN where not observed
    travel: float  # m, root mean square distance of the target from where the cloth starts, over the fitted frames


def residuals(x: Array, wanted: Array, start: Array, part: Flags, near: Flags) -> Residuals:
    """The residuals of positions x (C, V, 3) to `wanted` (C, V, 3), NaN where not observed; m.

    The cloths start at `start` (V, 3). `part` (V,) flags the vertices that are compared, `near` (C,) the frames that
    are fitted.
    """
    left = x - wanted
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # means of nothing are NaN, as they should be
        mean = np.nanmean(left[:, part], axis=1)
        of_vertices = np.sqrt(np.nanmean((left[near] ** 2).sum(axis=2), axis=0))
        travel = float(np.sqrt(np.nanmean(((wanted[near][:, part] - start[part]) ** 2).sum(axis=2))))
    of_vertices[~part] = np.nan
    return Residuals(mean, of_vertices, travel if np.isfinite(travel) else 0.0)
