"""Axes and units of other tools' files, and the scene's: y up, left-handed, metres, as in Unity.

Where z is up in a file, (x, y, z) becomes (x, z, −y); where its axes are right-handed, x is negated, as Unity does with
the models that it imports. Lengths are multiplied by `scale`, m per unit of the file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from clothfit.base.arrays import Array, Indices

UPS, HANDS = ("y", "z"), ("left", "right")


class Axes(NamedTuple):
    """The axes and the unit of a file's coordinates."""

    up: str = "y"  # the axis that points up, one of UPS
    handedness: str = "right"  # one of HANDS
    scale: float = 1.0  # m per unit of the file

    def __str__(self) -> str:
        unit = "metres" if self.scale == 1 else f"units of {self.scale:g} m"
        return f"{self.up} up, {self.handedness}-handed, {unit}"


SCENE = Axes("y", "left", 1.0)

RIGHT = Axes("y", "right", 1.0)
"""The axes of most other programs."""


def to_scene(points: Array, axes: Axes) -> Array:
    """Points (…, 3) of a file in the scene's axes, m."""
    turned = points.astype(float)  # filled in place: points of a motion take much memory
    turned[..., 0] = -points[..., 0] if axes.handedness == "right" else points[..., 0]
    turned[..., 1] = points[..., 2 if axes.up == "z" else 1]
    turned[..., 2] = -points[..., 1] if axes.up == "z" else points[..., 2]
    turned *= axes.scale
    return turned


def from_scene(points: Array, axes: Axes) -> Array:
    """Points (…, 3) of the scene, m, in a file's axes: the inverse of `to_scene`."""
    turned = points.astype(float)
    turned[..., 0] = -points[..., 0] if axes.handedness == "right" else points[..., 0]
    turned[..., 1] = -points[..., 2] if axes.up == "z" else points[..., 1]
    turned[..., 2] = points[..., 1 if axes.up == "z" else 2]
    turned /= axes.scale
    return turned


def facing(triangles: Indices, axes: Axes) -> Indices:
    """Triangles (T, 3) turned from a file's axes to the scene's, or back: a mirror image reverses their corners, so
    that the same side stays the front.
    """
    return triangles[:, ::-1] if axes.handedness == "right" else triangles
