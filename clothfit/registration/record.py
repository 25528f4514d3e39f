"""Registration: another clock and another place of a motion, and the same motion as the scene has it.

The motion's clock shows `offset` when the scene begins, and runs `rate` seconds for each second of the scene; its
points y lie, in the scene, at c R y + d:

    t = (t' − offset) / rate,    x = c R y + d

so a motion that was stretched in time by 1.1 and begins 0.03 s late has rate 1.1 and offset 0.03 s, and one that is
turned, moved and 5 % too large has the rotation R, the translation d and the scale c = 1 / 1.05 that bring it back.

Markers that were mistaken: what they show instead of their vertices, and the motion with that put right.

A capture gives each marker to a vertex. Where it gives two of them to each other's, `Swap` says since which frame, and
the motion gets them back; where a marker shows no vertex at all, or not in some frames, these are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.messages import counted, listed
from clothfit.motion.motion import Motion, at_frames
from clothfit.motion.times import TIME_SLACK
from clothfit.scene.scene import owner

NUMBERS: dict[str, int | slice] = {
    "rate": 0, "offset": 1, "rotation": slice(2, 5), "translation": slice(5, 8), "scale": 8,
}  # fmt: skip
"""The places of a registration's numbers."""

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

    def taken_back(self, x: Array) -> Array:
        """Points (…, 3), m, of the scene as the motion has them: the inverse of `placed`."""
        return np.asarray((x - self.translation) @ self.rotation / self.scale)

    def applied(self, motion: Motion, delta: float) -> Motion:
        """The motion with the scene's times and places; `delta`, s, is the scene's time step. Frames from before the
        scene begins are left out.
        """
        times = self.times(motion.times)
        begun = at_frames(motion, slice(int(np.searchsorted(times, -TIME_SLACK * delta)), None))
        own = self.times(begun.times)
        return replace(begun.moved(self.placed), times=np.where(np.abs(own) <= TIME_SLACK * delta, 0.0, own))

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
        ends = np.stack([self.numbers - self.within, self.numbers + self.within], axis=1)
        return {name: ends[part].tolist() for name, part in NUMBERS.items()}

    def __str__(self) -> str:
        parts = []
        rate = f"runs at a rate of {self.rate:.4g}, and " if self.rate != 1.0 else ""
        if (self.rate, self.offset) != (1.0, 0.0):
            parts.append(f"its clock {rate}shows {self.offset:.3g} s at the start")
        if not np.array_equal(self.rotation, np.eye(3)) or self.translation.any():
            turn, move = (", ".join(f"{x:.3g}" for x in each + 0.0) for each in (self.angles, self.translation))
            parts.append(f"turned by ({turn})° and moved by ({move}) m")
        if self.scale != 1.0:
            parts.append(f"scaled by {self.scale:.5g}")
        return ", ".join(parts) or "neither its clock nor its place is another one"

    def summary(self) -> dict[str, Any]:
        """As --json gives it."""
        numbers = self.numbers
        return {**{name: numbers[part].tolist() for name, part in NUMBERS.items()}, "intervals": self.intervals()}


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


MANY = 8
"""Vertices that a sentence names."""


class Swap(NamedTuple):
    """Vertices whose markers were mistaken for each other: the marker that was given to each shows the next one, and
    that of the last the first, or, where that is not `closed`, no vertex.
    """

    vertices: tuple[int, ...]  # numbered through the scene
    frame: int = 0  # of the target, from which on
    closed: bool = True


class Jump(NamedTuple):
    """A marker that is far from its way in single frames, or in two in a row."""

    vertex: int
    frames: tuple[int, ...]


@dataclass(frozen=True)
class Markers:
    """What is wrong with the markers of a target; vertices are numbered through the scene."""

    swapped: tuple[Swap, ...] = ()
    false: tuple[int, ...] = ()  # vertices whose markers show something else
    jumps: tuple[Jump, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.swapped or self.false or self.jumps)

    def applied(self, motion: Motion) -> Motion:
        """The motion with markers at their own vertices, and without what shows none. The same one where all is well.
        """
        if not self:
            return motion
        positions, observed = motion.positions.copy(), motion.seen().copy()
        weights = None if motion.weights is None else motion.weights.copy()
        arrays = [array for array in (positions, observed, weights) if array is not None]
        for vertices, frame, closed in self.swapped:
            own, others = list(vertices), [*vertices[1:], vertices[0]]
            for array in arrays:  # the marker of `others` was given to `own`
                array[frame:, others] = array[frame:, own]
            if not closed:
                observed[frame:, vertices[0]] = False
        observed[:, list(self.false)] = False
        for vertex, frames in self.jumps:
            observed[list(frames), vertex] = False
        positions[~observed] = np.nan
        return replace(motion, positions=positions, observed=observed, weights=weights)

    def summary(self, counts: Sequence[int]) -> dict[str, Any]:
        """As --json gives it, with vertices of objects that have these counts of them."""
        def of(vertex: int) -> dict[str, Any]:
            return dict(zip(("object", "vertex"), owner(vertex, counts), strict=True))

        swapped = [
            {"object": of(v[0])["object"], "vertices": [of(each)["vertex"] for each in v], "frame": frame}
            for v, frame, _ in self.swapped
        ]
        jumps = [{**of(each.vertex), "frames": list(each.frames)} for each in self.jumps]
        return {"swapped": swapped, "false": [of(each) for each in self.false], "jumps": jumps}

    def sentences(self, counts: Sequence[int]) -> list[tuple[str, str]]:
        """Codes of hints and what they say."""
        found = []
        for each in self.swapped:
            names = [named(vertex, counts) for vertex in each.vertices]
            since = f" from frame {each.frame} on" if each.frame else ""
            found.append(("swapped_markers", f"the markers of {listed(names)} are swapped{since}; they are exchanged"))
        frames = counted(sum(len(each.frames) for each in self.jumps), "frame", "frames")
        for vertices, one, several in (
            (self.false, "shows another place than the cloth's; it is left out",
             "show another place than the cloth's; they are left out"),
            ([each.vertex for each in self.jumps], f"jumps away and back; {frames} of it left out",
             f"jump away and back; {frames} of them left out"),
        ):  # fmt: skip
            names = [named(each, counts) for each in vertices[:MANY]] + ["others"] * (len(vertices) > MANY)
            if len(names) == 1:
                found.append(("false_markers", f"the marker of {listed(names)} {one}"))
            elif names:
                found.append(("false_markers", f"the markers of {listed(names)} {several}"))
        return found


def named(vertex: int, counts: Sequence[int]) -> str:
    """A vertex as messages name it."""
    own, number = owner(vertex, counts)
    return f"objects[{own}] vertex {number}"
