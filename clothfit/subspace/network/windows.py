"""The recorded motions as coordinates and inputs, and windows of them at random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices


@dataclass(frozen=True, eq=False)
class Motions:
    """Motions of equal length. Frame 0 is the one before the start, with the velocities at the start."""

    z: Array  # (E, T, r)
    w: Array  # (E, T − 2, m), what acts on the step from frame t + 1 to t + 2
    good: Flags  # (E, T)

    def scaled(self, size: float, kind: Any) -> Motions:
        """With coordinates relative to a size, in numbers of a kind."""
        return replace(self, z=(self.z / size).astype(kind), w=self.w.astype(kind))

    def of(self, episodes: Sequence[int]) -> Motions:
        """Some of them."""
        own = list(episodes)
        return Motions(self.z[own], self.w[own], self.good[own])

    def joined(self, other: Motions) -> Motions:
        """With more motions of the same length."""
        pairs = ((self.z, other.z), (self.w, other.w), (self.good, other.good))
        return Motions(*(np.concatenate(pair) for pair in pairs))  # type: ignore[arg-type]

    def steps(self) -> tuple[Array, Array, Array, Array]:
        """Of all good steps the coordinates before (N, r), the ways there (N, r), inputs (N, m), and after (N, r)."""
        kept = self.good[:, :-2] & self.good[:, 1:-1] & self.good[:, 2:]
        before, now, after = self.z[:, :-2][kept], self.z[:, 1:-1][kept], self.z[:, 2:][kept]
        return now, now - before, self.w[kept], after

    def starts(self, length: int) -> tuple[Indices, int]:
        """Episodes and first frames (N, 2) of all windows with two frames and then `length` more, all of them good;
        where there is none, of the longest that there are; and their length.
        """
        bad = np.cumsum(~self.good, axis=1)
        length = min(length, bad.shape[1] - 2)
        while length > 0:
            end = length + 2
            among: Indices = bad[:, end - 1 :] - np.pad(bad, ((0, 0), (1, 0)))[:, : bad.shape[1] - end + 1]
            if (among == 0).any():
                return np.argwhere(among == 0).astype(np.int32), length
            length -= 1
        return np.zeros((0, 2), np.int32), 0

    def windows(self, starts: Indices, length: int) -> tuple[Array, Array]:
        """Frames (B, length + 2, r), and inputs (B, length, m)."""
        frames = starts[:, 1:] + np.arange(length + 2)
        return self.z[starts[:, :1], frames], self.w[starts[:, :1], frames[:, :-2]]
