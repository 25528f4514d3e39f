"""Registration: another clock and another place of a motion, and the same motion as the scene has it.

The motion's clock shows `offset` when the scene begins, and runs `rate` seconds for each second of the scene; its
points y lie, in the scene, at c R y + d:

    t = (t' − offset) / rate,    x = c R y + d

so a motion that was stretched in time by 1.1 and begins 0.03 s late has rate 1.1 and offset 0.03 s, and one that is
turned, moved and 5 % too large has the rotation R, the translation d and the scale c = 1 / 1.05 that bring it back.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.motion.motion import Motion, at_frames
from clothfit.motion.times import TIME_SLACK

STRAIGHT = 1e-9
"""|cos| of the angle about x below which those about y and z cannot be told apart."""


@dataclass(frozen=True, eq=False)
class Registration:
    """The clock and the place of a motion."""

    rate: float = 1.0  # seconds of the motion's clock for each of the scene's
    offset: float = 0.0  # s that the motion's clock shows when the scene begins
    rotation: Array = field(default_factory=lambda: np.eye(3))  # R (3, 3)
    translation: Array = field(default_factory=lambda: np.zeros(3))  # d (3,), m
    scale: float = 1.0  # c
    within: Array | None = None  # half widths (9,) of 95 % intervals of `numbers`; None: not known

    def times(self, times: Array) -> Array:
        """Times of the scene, s, at which the motion's clock shows `times`, s; negative before the scene begins."""
        return np.asarray((times - self.offset) / self.rate)

    def placed(self, points: Array) -> Array:
        """Points (…, 3), m, of the motion as they lie in the scene."""
        return np.asarray(self.scale * (points @ self.rotation.T) + self.translation)

    def applied(self, motion: Motion, delta: float) -> Motion:
        """The motion with the scene's times and places; `delta`, s, is the scene's time step. Frames from before the
        scene begins are left out.
        """
        times = self.times(motion.times)
        begun = at_frames(motion, slice(int(np.searchsorted(times, -TIME_SLACK * delta)), None))
        own = self.times(begun.times)
        return replace(begun, times=np.where(np.abs(own) <= TIME_SLACK * delta, 0.0, own),
                       positions=self.placed(begun.positions))  # fmt: skip

    @property
    def angles(self) -> Array:
        """Degrees (3,) about x, y and z, applied about z, then x, then y, as in the editor: the inverse of `turn`."""
        R = self.rotation
        x = np.arcsin(np.clip(-R[1, 2], -1.0, 1.0))
        if np.cos(x) > STRAIGHT:
            y, z = np.arctan2(R[0, 2], R[2, 2]), np.arctan2(R[1, 0], R[1, 1])
        else:
            y, z = np.arctan2(-R[2, 0], R[0, 0]), 0.0
        return np.degrees([x, y, z])

    @property
    def numbers(self) -> Array:
        """Its numbers (9,): the rate, the offset, the angles in degrees, the translation and the scale."""
        return np.array([self.rate, self.offset, *self.angles, *self.translation, self.scale])

    def intervals(self) -> dict[str, Any] | None:
        """The 95 % intervals of its numbers, low and high, by name; None where they are not known."""
        if self.within is None:
            return None
        ends = np.stack([self.numbers - self.within, self.numbers + self.within], axis=1).tolist()
        return {"rate": ends[0], "offset": ends[1], "rotation": ends[2:5], "translation": ends[5:8], "scale": ends[8]}

    def __str__(self) -> str:
        parts = []
        if (self.rate, self.offset) != (1.0, 0.0):
            parts.append(f"its clock runs at a rate of {self.rate:.4g}, and shows {self.offset:.3g} s at the start")
        if not np.array_equal(self.rotation, np.eye(3)) or self.translation.any():
            turn, move = (", ".join(f"{x:.3g}" for x in each + 0.0) for each in (self.angles, self.translation))
            parts.append(f"turned by ({turn})° and moved by ({move}) m")
        if self.scale != 1.0:
            parts.append(f"scaled by {self.scale:.5g}")
        return ", ".join(parts) or "neither its clock nor its place is another one"

    def summary(self) -> dict[str, Any]:
        """As --json gives it."""
        return {
            "rate": self.rate,
            "offset": self.offset,
            "rotation": self.angles.tolist(),
            "translation": self.translation.tolist(),
            "scale": self.scale,
            "intervals": self.intervals(),
        }


def rigid(points: Array, others: Array) -> tuple[Array, Array]:
    """The rotation (3, 3) and translation (3,), m, that bring points (n, 3) nearest to others (n, 3).

    W. Kabsch, A solution for the best rotation to relate two sets of vectors, Acta Cryst. A 32 (1976).
    """
    centre, other = points.mean(axis=0), others.mean(axis=0)
    u, _, v = np.linalg.svd((points - centre).T @ (others - other))
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v)) or 1.0])
    R = (u @ turn @ v).T
    return R, other - R @ centre


def scale_between(points: Array, others: Array) -> float:
    """How much larger points (n, 3) are than others (n, 3), moved and turned as they may be; 1 where none have a size.
    """
    sizes = [float(np.linalg.norm(each - each.mean(axis=0))) for each in (points, others)]
    return sizes[0] / sizes[1] if min(sizes) > 0 else 1.0


def cross(w: Array) -> Array:
    """The matrix (3, 3) of the cross product with w (3,)."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def rotation(w: Array) -> Array:
    """The rotation (3, 3) by |w| rad about w (3,): O. Rodrigues, 1840."""
    angle, W = float(np.linalg.norm(w)), cross(w)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * W + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * W @ W)


def rotation_derivative(w: Array) -> Array:
    """J (3, 3) with rotation(w + dw) = rotation(J dw) rotation(w) for small dw.

    G. S. Chirikjian, Stochastic Models, Information Theory, and Lie Groups 2, section 10.6 (2012).
    """
    angle, W = float(np.linalg.norm(w)), cross(w)
    third = (1.0 - np.sinc(angle / np.pi)) / angle**2 if angle > 1e-4 else 1.0 / 6.0
    return np.asarray(np.eye(3) + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * W + third * W @ W)
