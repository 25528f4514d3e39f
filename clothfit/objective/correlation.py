"""Which fitted values are hard to tell apart: the correlations of their errors.

Where the errors of two values have a correlation near 1 or −1, the motion determines a combination of the two much
better than each alone: masses and stiffnesses that grow together, a spring and its neighbour. The interval of each is
then wide, and another fit may share out their sum, or their difference, in another way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.scene.block import Block

FEW, NOTABLE, STRONG = 8, 0.5, 0.9
"""Of up to so many values the pairs with a notable correlation are listed, of more those with a strong one."""

MOST = 20  # pairs that are listed, the strongest ones


@dataclass(frozen=True)
class Value:
    """One fitted value."""

    object: int | None  # None: of the scene as a whole
    name: str  # of the kind
    index: int  # within its block; of a vector its component


@dataclass(frozen=True)
class Correlation:
    """How the errors of two fitted values go together."""

    first: Value
    second: Value
    correlation: float  # −1 … 1


def strongest(matrix: Array, places: NDArray[np.intp], blocks: Sequence[Block]) -> tuple[Correlation, ...]:
    """The strongest correlations of a covariance matrix (F, F) of the parameters at `places` (F,) of the fit vector,
    strongest first; of parameters without a variance none.
    """
    deviation = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.abs(matrix / np.outer(deviation, deviation))
    found = np.triu(np.where(np.isfinite(found), found, 0.0), 1)
    rows, columns = np.nonzero(found >= (NOTABLE if len(places) <= FEW else STRONG))
    order = np.argsort(-found[rows, columns], kind="stable")[:MOST]
    return tuple(
        Correlation(
            value_at(int(places[i]), blocks), value_at(int(places[j]), blocks),
            float(np.clip(matrix[i, j] / (deviation[i] * deviation[j]), -1.0, 1.0)),
        )
        for i, j in zip(rows[order], columns[order], strict=True)
    )  # fmt: skip


def value_at(place: int, blocks: Sequence[Block]) -> Value:
    """The value at a place of the fit vector."""
    (block,) = (each for each in blocks if each.part.start <= place < each.part.stop)
    return Value(block.cloth, block.name, place - block.part.start)
