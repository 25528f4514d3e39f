"""Values over time between keys, as in glTF: steps, straight lines, and cubic splines with given tangents.

glTF 2.0 specification, appendix C. Rotations are unit quaternions (x, y, z, w), on great arcs between their keys.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array

NEARLY_PARALLEL = 0.9995
"""Two quaternions whose angle has a larger cosine are joined by a straight line, as the sine is near 0."""


class Track(NamedTuple):
    """The keys of an animated quantity."""

    times: Array  # (keys,), s, increasing
    values: Array  # (keys, width); of splines (keys, 3, width): tangent before, value, tangent after
    kind: str  # STEP, LINEAR or CUBICSPLINE

    def at(self, times: Array, rotation: bool = False) -> Array:
        """Values (len(times), width); constant before the first key and after the last."""
        last = len(self.times) - 1
        index = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, last)
        after = np.minimum(index + 1, last)
        span = self.times[after] - self.times[index]
        u = np.clip((times - self.times[index]) / np.where(span > 0, span, 1.0), 0.0, 1.0)[:, None]
        if self.kind == "CUBICSPLINE":
            return self._spline(index, after, span[:, None], u)
        if self.kind == "STEP":
            return self.values[index]
        a, b = self.values[index], self.values[after]
        return _arc(a, b, u) if rotation else a + u * (b - a)

    def _spline(self, index: NDArray[Any], after: NDArray[Any], span: Array, u: Array) -> Array:
        """The cubic with the values and the tangents at both ends."""
        a, out = self.values[index, 1], span * self.values[index, 2]
        b, into = self.values[after, 1], span * self.values[after, 0]
        rise, bend = u * u * (3 - 2 * u), u * (u - 1)
        curve: Array = (1 - rise) * a + rise * b + bend * (u - 1) * out + bend * u * into
        return curve


def _arc(a: Array, b: Array, u: Array) -> Array:
    """The rotation between two others, along the shorter way: −b is the same rotation as b."""
    cosine = np.sum(a * b, axis=-1, keepdims=True)
    b, cosine = np.where(cosine < 0, -b, b), np.clip(np.abs(cosine), 0.0, 1.0)
    angle = np.arccos(np.minimum(cosine, NEARLY_PARALLEL))
    first, second = np.sin((1 - u) * angle) / np.sin(angle), np.sin(u * angle) / np.sin(angle)
    near = cosine > NEARLY_PARALLEL
    between: Array = np.where(near, 1 - u, first) * a + np.where(near, u, second) * b
    return between


def transform(translation: Array, rotation: Array, scale: Array) -> Array:
    """Matrices (n, 4, 4) that scale, then turn, then move; rotations (n, 4) of any length above 0."""
    length = np.linalg.norm(rotation, axis=1, keepdims=True)
    x, y, z, w = (rotation / np.where(length > 0, length, 1.0)).T
    turn = np.empty((max(len(translation), len(rotation), len(scale)), 4, 4))
    turn[:] = np.eye(4)
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    turn[:, 1, 0], turn[:, 1, 1], turn[:, 1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    turn[:, 2, 0], turn[:, 2, 1], turn[:, 2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    turn[:, :3, :3] *= scale[:, None, :]
    turn[:, :3, 3] = translation
    return turn
