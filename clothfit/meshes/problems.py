"""What is wrong with a triangle mesh, whether a cloth can be made of it, and welding, which cures most of it.

Tools split vertices where texture or normals jump, double faces to show both sides, and leave points behind. A network
of springs suffers from that: it is torn where two vertices lie at one place, a vertex in no triangle has no mass, a
spring between two vertices at one place has no length, and the editor does not define what it makes of an edge with
three triangles.

Welding joins the vertices that lie at one place and removes what no cloth can have: triangles that collapse, triangles
with the corners of an earlier one, and vertices in no triangle. The rest keeps its order, so a mesh with nothing to
join stays as it is.

n vertices, T triangles.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.eigen import connected_components
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted, metres
from clothfit.formats.animation import Parts
from clothfit.meshes.mesh import Mesh, areas
from clothfit.scene.directions import along, edges_of, opposite, pairs_of

Numbers: TypeAlias = npt.NDArray[np.integer[Any]]

MOST_PAIRS = 100
"""The most pairs of near vertices per vertex; with more, the distance finds more than seams."""

INDICES_SHOWN = 5
"""The most indices in a message."""

SAME_PLACE = 1e-6
"""Vertices nearer than this share of the bounding box's diagonal are meant to be one: texts of six digits and numbers
of single precision cannot show shorter distances.
"""

THIN = 1e-12
"""A triangle whose area is below this share of its longest side squared has only the area that rounding gives it."""


@dataclass(frozen=True)
class Problem:
    """A problem of a mesh."""

    kind: str  # a word for scripts: "seam", "unused", …
    count: int  # of the vertices, triangles, edges or parts that the sentence names
    first: tuple[int, ...]  # indices of the first few vertices or triangles; of parts one vertex each
    sentence: str  # for people
    fatal: bool  # whether no scene can be made
    weldable: bool  # whether `weld` cures it


def tiny(mesh: Mesh) -> float:
    """The distance, m, below which two vertices count as one: a millionth of the mesh's diagonal."""
    return SAME_PLACE * float(np.linalg.norm(np.ptp(mesh.positions, axis=0))) if len(mesh.positions) else 0.0


def problems(mesh: Mesh, distance: float | None = None) -> list[Problem]:
    """List the problems of a mesh, those that make a scene impossible first.

    Vertices within `distance`, m, of each other count as one place (default: `tiny`). Raises InvalidInput when the
    distance joins more than seams.
    """
    every = _found(mesh, tiny(mesh) if distance is None else distance)
    return sorted((problem for problem in every if problem is not None), key=lambda problem: not problem.fatal)


def _found(mesh: Mesh, distance: float) -> Iterator[Problem | None]:
    """Each problem that a mesh may have; None for those that it has not."""
    n, corners, twice = len(mesh.positions), mesh.triangles.reshape(-1), _collapsed(mesh.triangles)
    used, area = np.bincount(corners, minlength=n) > 0, np.bincount(corners, np.repeat(areas(mesh), 3), n)
    vertices = ("vertex is", "vertices are")
    if not len(mesh.triangles):
        yield Problem("empty", 0, (), "there is no triangle", True, False)
    said = "{} in no triangle{}, so without mass"
    yield _problem("unused", np.flatnonzero(~used), vertices, said, "removes them")
    said, named = "{} a vertex twice{}", ("triangle names", "triangles name")
    yield _problem("collapsed", np.flatnonzero(twice), named, said, "removes them")
    said = "{} only in triangles without area{}, so without mass; remove them or move them apart"
    yield _problem("massless", np.flatnonzero(used & (area == 0)), vertices, said, fatal=True)
    said, have = "{} the corners of one before{}", ("triangle has", "triangles have")
    again = np.flatnonzero(~first_of_each(np.sort(mesh.triangles, axis=1)))
    yield _problem("repeated", again, have, said, "removes them")

    kept = mesh.triangles[~twice]
    kept = kept[first_of_each(np.sort(kept, axis=1))]  # that no check above reports
    met, edge = edges_of(kept), ("edge", "edges")
    said = "more than two triangles share {}{}; at most 2 can: cut the mesh there"
    yield _problem("non-manifold", met.ends[met.uses > 2, 0], edge, said, fatal=True, of="at vertices ")
    # springs along an edge, or between the two vertices opposite it
    every = edges_of(mesh.triangles)
    pairs = np.concatenate([every.ends, np.sort(opposite(mesh.triangles, pairs_of(every)), axis=1)])
    away = mesh.positions[pairs[:, 0]] - mesh.positions[pairs[:, 1]]
    wrong = pairs[((away * away).sum(axis=1) == 0) & (pairs[:, 0] != pairs[:, 1])]
    said = "{} have no length{}: two vertices that need one are at the same place"
    yield _problem("no-length", wrong[:, 0], ("spring would", "springs would"), said, "joins them", of="vertices ")
    said = "{} no area{}; their sides alone hold nothing"
    yield _problem("flat", np.flatnonzero(_thin(mesh) & ~twice), have, said)
    once = np.bincount(met.of.reshape(-1), along(kept).reshape(-1), len(met.ends)) == 1
    said = "at {} two triangles face opposite ways{}; that changes how the cloth looks, not how it moves"
    # two triangles that walk their edge in the same direction
    yield _problem("orientation", met.ends[(met.uses == 2) & ~once, 0], edge, said, of="vertices ")
    sizes, first = components(mesh.triangles[:, [0, 1, 1, 2]].reshape(-1, 2), n)
    if len(sizes) > 1:
        shown = ", ".join(map(str, sizes[:INDICES_SHOWN])) + (", …" if len(sizes) > INDICES_SHOWN else "")
        said = f"it is in {len(sizes)} parts, of {shown} vertices, that nothing holds together"
        yield Problem("parts", len(sizes), tuple(first[:INDICES_SHOWN].tolist()), said, False, False)
    doubled = np.flatnonzero(together(mesh.positions, distance) != np.arange(n))
    said = f"{{}} at the place of another, within {metres(distance)}{{}}: the cloth is torn there"
    seam = _problem("seam", doubled, vertices, said, "joins them")
    yield seam and replace(seam, fatal=False)


def _collapsed(triangles: Indices) -> Flags:
    a, b, c = triangles.T
    return np.asarray((a == b) | (b == c) | (a == c))


def _thin(mesh: Mesh) -> Flags:
    corner = mesh.positions[mesh.triangles]
    side = corner - np.roll(corner, 1, axis=1)
    longest = (side * side).sum(axis=2).max(axis=1, initial=0.0)
    return np.asarray(areas(mesh) <= THIN * longest)


def _problem(
    kind: str, wrong: Numbers, noun: tuple[str, str], sentence: str, cure: str = "", fatal: bool = False, of: str = ""
) -> Problem | None:
    """The problem of the indices `wrong`; None where there are none. What welding cures is fatal without it."""
    if not len(wrong):
        return None
    first = tuple(np.unique(wrong)[:INDICES_SHOWN].tolist())
    more = ", …" if len(wrong) > len(first) else ""
    text = sentence.format(counted(len(wrong), *noun), f" ({of}{', '.join(map(str, first))}{more})")
    hint = f"; --weld {cure}" if cure else ""
    return Problem(kind, len(wrong), first, text + hint, fatal or bool(cure), bool(cure))


def together(positions: Array, distance: float) -> Indices:
    """For each of the positions (n, 3) the first index of its group, in which steps of at most `distance`, m, lead from
    one to the next. Raises InvalidInput where that joins more than seams.
    """
    from scipy.spatial import KDTree

    n = len(positions)
    if not 0 <= distance < np.inf:
        raise InvalidInput(f"weld: the distance must be at least 0 and finite; {distance:g} m was given")
    tree = KDTree(positions)
    if tree.count_neighbors(tree, distance) > (MOST_PAIRS + 1) * n:
        raise InvalidInput(f"weld: within {metres(distance)} of most vertices are too many others; give a smaller one")
    label = connected_components(tree.query_pairs(distance, output_type="ndarray"), n)
    first = np.full(label.max(initial=-1) + 1, n)
    np.minimum.at(first, label, np.arange(n))
    return np.asarray(first[label].astype(np.int32))


def components(pairs: Indices, n: int) -> tuple[Indices, Indices]:
    """The parts into which pairs (P, 2) connect n vertices: the number of vertices of each, largest first, and its
    first vertex; vertices in no pair are left out.
    """
    label = connected_components(pairs, n)
    used = np.unique(pairs)
    _, first, sizes = np.unique(label[used], return_index=True, return_counts=True)
    order = np.argsort(-sizes, kind="stable")
    return sizes[order].astype(np.int32), used[first][order].astype(np.int32)


def first_of_each(rows: Indices) -> Flags:
    """Which of the rows (R, k) are the first of their kind."""
    order = np.lexsort(rows.T)  # keeps equal ones in their order; faster than np.unique of rows
    new = np.ones(len(rows), bool)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    found = np.zeros(len(rows), bool)
    found[order[new]] = True
    return found


class Welded(NamedTuple):
    """A welded mesh, which had n vertices before."""

    mesh: Mesh  # the welded one
    vertices: Indices  # (n,), the new index of each old vertex; −1: it was in no triangle and is removed
    joined: int  # number of vertices that became part of another
    triangles: int  # number of triangles that were removed

    @property
    def unused(self) -> int:
        """Number of vertices that were removed."""
        return int((self.vertices < 0).sum())

    @property
    def renumbered(self) -> bool:
        """Whether some vertex has another index than before."""
        return not np.array_equal(self.vertices, np.arange(len(self.mesh.positions)))


def weld(mesh: Mesh, distance: float | None = None) -> Welded:
    """Join vertices within `distance`, m, of each other (default: a millionth of the mesh's diagonal). The first vertex
    of each group keeps its place. Raises InvalidInput when the distance joins more than seams.
    """
    lot = together(mesh.positions, tiny(mesh) if distance is None else distance)
    triangles = lot[mesh.triangles]
    stay = np.flatnonzero(~_collapsed(triangles))
    stay = stay[first_of_each(np.sort(triangles[stay], axis=1))]
    triangles = triangles[stay]
    kept = np.unique(triangles)
    number = np.full(len(lot), -1, np.int32)
    number[kept] = np.arange(len(kept))
    texture = None if mesh.texture is None else mesh.texture[stay]
    made = Mesh(mesh.positions[kept], number[triangles].reshape(-1, 3), texture, _parts(mesh.parts, number[lot]))
    joined = int((lot != np.arange(len(lot))).sum())
    return Welded(made, number[lot], joined, len(mesh.triangles) - len(triangles))


def _parts(parts: Parts, number: Indices) -> Parts:
    """The parts with the new vertices; those that are left with none are left out."""
    moved = ((name, np.unique(number[own])) for name, own in parts)
    left = ((name, own[own >= 0]) for name, own in moved)
    return tuple((name, own) for name, own in left if len(own))
