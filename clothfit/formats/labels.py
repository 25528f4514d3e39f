"""What mesh files say of a mesh beside its shape: texture coordinates of the corners, and named parts.

Tools name parts in many ways: objects, groups, materials. Here a part is a name and the vertices of its triangles.
Parts without vertices, or with all, are left out, and names are made to differ. None of this is worth a refusal: what
cannot be understood is left out.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Indices

Parts: TypeAlias = tuple[tuple[str, Indices], ...]
"""Names and vertices, rising."""

NO_NAMES = frozenset({"", "(null)", "none", "default", "off"})
"""What tools write, in either case, where there is no name."""

LONGEST_NAME, MOST_PARTS = 60, 64
"""Characters of a name, and parts of a mesh: with more than that names are numbers, such as those of fragments."""


def parts_of(found: Iterable[tuple[str, npt.NDArray[np.intp]]], triangles: Indices) -> Parts:
    """The parts of a mesh, from names and the indices of their triangles (T, 3)."""
    used = np.unique(triangles)
    made: dict[str, Indices] = {}
    for name, own in found:
        vertices = np.unique(triangles[own]).astype(np.int32)
        known = name.strip().lower() not in NO_NAMES
        if known and 0 < len(vertices) < len(used):
            made[unused(name, made)] = vertices
    return tuple(made.items()) if len(made) <= MOST_PARTS else ()


def unused(name: str, taken: Iterable[str]) -> str:
    """A name, short and printable, with a number where it is taken."""
    short = "".join(c if c.isprintable() else "?" for c in name.strip())[:LONGEST_NAME]
    known, made, number = set(taken), short, 1
    while made in known:
        number += 1
        made = f"{short} {number}"
    return made


def known(texture: Array) -> Array | None:
    """Texture coordinates (T, 3, 2), None where there are none at all."""
    return texture if np.isfinite(texture).any() else None
