"""Markers that were mistaken: what they show instead of their vertices, and the motion with that put right.

A capture gives each marker to a vertex. Where it gives two of them to each other's, `Swap` says since which frame, and
the motion gets them back; where a marker shows no vertex at all, or not in some frames, these are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.messages import counted
from clothfit.motion.motion import Motion

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
            return dict(zip(("object", "vertex"), placed(vertex, counts), strict=True))

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
        if self.false:
            alone = len(self.false) == 1
            text = f"{many(self.false, counts)} {'shows' if alone else 'show'} another place than the cloth's"
            found.append(("false_markers", f"{text}; {'it is' if alone else 'they are'} left out"))
        if self.jumps:
            alone = len(self.jumps) == 1
            frames = counted(sum(len(each.frames) for each in self.jumps), "frame", "frames")
            text = f"{many([each.vertex for each in self.jumps], counts)} {'jumps' if alone else 'jump'} away and back"
            found.append(("false_markers", f"{text}; {frames} of {'it' if alone else 'them'} left out"))
        return found


def many(vertices: Sequence[int], counts: Sequence[int]) -> str:
    """The markers of some vertices, the first few by name."""
    names = [named(each, counts) for each in vertices[:MANY]] + ["others"] * (len(vertices) > MANY)
    return f"the marker{'s' if len(vertices) > 1 else ''} of {listed(names)}"


def placed(vertex: int, counts: Sequence[int]) -> tuple[int, int]:
    """The object of a vertex that is numbered through the scene, and its number there."""
    ends = np.cumsum(counts)
    own = int(np.searchsorted(ends, vertex, side="right"))
    return own, vertex - int(ends[own]) + int(counts[own])


def listed(names: Sequence[str]) -> str:
    """Names with commas and an "and"."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def named(vertex: int, counts: Sequence[int]) -> str:
    """A vertex as messages name it."""
    own, number = placed(vertex, counts)
    return f"objects[{own}] vertex {number}"
