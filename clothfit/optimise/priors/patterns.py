"""Patterns in which the values of a fabric go together: what the prior of a fit takes their scatter apart into.

Springs of one family are alike, and so are those of one region; along a cloth values change smoothly, those of all
families together or of each by itself. Smooth maps are modes of the Laplacian of the mesh (`smooth_maps`), in bands of
frequencies: in two dimensions that of the j-th goes as √j, so each octave has four times as many modes as the one
before. How far the values follow a pattern is learned (`prior`).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.scene.block import Block
from clothfit.scene.cloth import Cloth
from clothfit.scene.families import spring_groups, vertex_groups
from clothfit.scene.smooth_maps import vertex_modes

BANDS = (1, 4, 16, 64)
"""The first mode of each band, and the end of the last one; mode 0 is constant."""

OWN_BANDS = 2
"""Bands of maps of each family by itself."""

SHARE = 4
"""Values, at least, for each mode."""


def patterns(cloth: Cloth, block: Block, chosen: NDArray[np.intp]) -> tuple[Array, ...]:
    """The patterns (n, ·) of the `chosen` (n,) values of a block of single values, each of mean square row sum 1."""
    on_springs = block.kind.of == "spring"
    groups = spring_groups(cloth) if on_springs else vertex_groups(cloth)
    modes = vertex_modes(cloth, min(BANDS[-1], max(len(chosen) // SHARE, 1)))
    if on_springs:
        modes = modes[cloth.springs].mean(axis=1)
    member = groups.of[chosen, None] == np.arange(len(groups.names))
    return tuple(scaled(B) for B in found(modes[chosen], member[:, member.any(axis=0)].astype(float)) if B.any())


def found(modes: Array, member: Array) -> Iterator[Array]:
    """Patterns from modes (n, K), and which group each value is in, (n, G)."""
    several = member.shape[1] > 1
    if several:
        yield member
    for i, (first, end) in enumerate(pairwise(BANDS)):
        band = modes[:, first:end]
        if not band.shape[1]:
            break
        yield band
        if several and i < OWN_BANDS:
            yield (member[:, :, None] * band[:, None]).reshape(len(band), -1)


def scaled(B: Array) -> Array:
    """B (n, ·) with a mean square row sum of 1."""
    return np.asarray(B / np.sqrt((B**2).sum() / len(B)))
