"""Gains of a feedback in a reduced basis: what forces answer a cloth that is not where it should be.

Each object with n vertices is seen through k shapes. Weights W (n, k) make coordinates of positions and velocities,
q = Wᵀ x and p = Wᵀ v, each (k, 3). In a row of the forces with gains K and reference z₀ the answer is

    u = E g,    g = −K (z − z₀),    z = (q, p) as one vector (6 k,), g (3 m,) that of (m, 3)

with E (n, m) the m shapes of forces on the vertices that forces act on. Numbers are 0 in objects without a feedback.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput

NAMES = ("measure", "push", "gains", "reference", "bound")
"""The arrays of a file."""


@dataclass(frozen=True, eq=False)
class Regulator:
    """A feedback of C objects with n vertices in all, over R rows of forces."""

    measure: Array  # W, (n, k), kg^½
    push: Array  # E, (n, m)
    gains: Array  # K, (C, R, 3 m, 6 k), N and N s for each kg^½ m
    reference: Array  # z₀, (C, R, 6 k), kg^½ m and kg^½ m/s, at the beginning of each row
    bound: float = np.inf  # N, largest force on a vertex, that of the plan included

    def arrays(self) -> dict[str, Array]:
        """What a file has of it: the gains with 7 digits, which are more than a feedback needs."""
        gains: Any = self.gains.astype(np.float32)
        return dict(zip(NAMES, (self.measure, self.push, gains, self.reference, np.array(self.bound)), strict=True))

    def answer(self, cloth: int, part: slice, row: int, place: Array, x: Array, v: Array) -> Array:
        """The forces (n, 3), N, at x and v (n, 3) on the cloth that is this part of all vertices, the coordinates of
        which should be `place` (6 k,).
        """
        away = state(self.measure[part], x, v) - place
        return np.asarray(self.push[part] @ -(self.gains[cloth, row] @ away).reshape(-1, 3))


def state(measure: Array, x: Array, v: Array) -> Array:
    """The coordinates (6 k,) of positions and velocities (n, 3) by weights (n, k)."""
    return np.concatenate([(measure.T @ x).reshape(-1), (measure.T @ v).reshape(-1)])


def regulator(arrays: dict[str, Array], rows: int, vertices: int, name: str) -> Regulator | None:
    """The feedback in the arrays of a file, None where it has none. Raises InvalidInput where they do not fit so many
    rows of forces on so many vertices.
    """
    missing = [each for each in NAMES if each not in arrays]
    if len(missing) == len(NAMES):
        return None
    if missing:
        raise InvalidInput(f"{name}: {', '.join(NAMES)} belong together; missing: {', '.join(missing)}")
    measure, push, gains, reference, bound = (arrays[each] for each in NAMES)
    if measure.ndim != 2 or push.ndim != 2 or not len(measure) == len(push) == vertices:
        shapes = f"measure {measure.shape} and push {push.shape}"
        raise InvalidInput(f"{name}: {shapes} do not fit {vertices} vertices; (vertices, shapes) is needed")
    k, m = measure.shape[1], push.shape[1]
    if gains.ndim != 4 or gains.shape[1:] != (rows, 3 * m, 6 * k) or reference.shape != (*gains.shape[:2], 6 * k):
        shapes = f"gains {gains.shape} and reference {reference.shape}"
        needed = f"(objects, {rows}, {3 * m}, {6 * k}) and (objects, {rows}, {6 * k}) are needed"
        raise InvalidInput(f"{name}: {shapes} do not fit forces, measure and push; {needed}")
    for each, array in zip(NAMES[:4], (measure, push, gains, reference), strict=True):
        if not np.isfinite(array).all():
            raise InvalidInput(f"{name}: {each}: is not finite everywhere")
    if bound.shape != () or not bound > 0:
        raise InvalidInput(f"{name}: bound: must be one number above 0, N")
    return Regulator(measure, push, gains, reference, float(bound))
