"""From the fit vector to the columns of a sensitivity: which parameter moves which elements, and how much."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clothfit.base.arrays import Array, Elements, Indices
from clothfit.derivative.sensitivity import Columns, Share
from clothfit.engine.system import System, zeros
from clothfit.scene.block import Block

LOCAL = ("mass", "stiffness", "rest")
"""Kinds that act on one vertex or spring each; `velocity` acts at the start only, every other kind everywhere."""

LEADING = ("path", "shift")
"""Kinds that move pins, and other vertices through them alone."""


def columns(
    system: System, blocks: Sequence[Block], p: Array, column: Indices, factor: Array, count: int
) -> Columns:
    """The columns of one cloth's sensitivity by the parameters of `blocks` at p (P,).

    `column` (P,) gives the column of each parameter, −1 where it is held, `factor` (P,) a factor of its derivative,
    `count` the number of columns.
    """
    local = {"mass": none(len(system.x0)), "stiffness": none(len(system.springs.rest)), "rest": none(0)}
    everywhere: list[tuple[int, Elements]] = []
    velocity: list[tuple[int, Array]] = []
    led: list[tuple[int, Elements]] = []
    for block in blocks:
        own = np.flatnonzero(column[block.part] >= 0) + block.start
        if block.name in LOCAL and len(own):
            local[block.name] = share(block, p, column, factor)
            continue
        for i in own:
            unit = np.zeros(len(column))
            unit[i] = factor[i]
            change = np.array(block.spread(unit))
            if block.name == "velocity":
                velocity.append((int(column[i]), change))
            else:
                kept = led if block.name in LEADING else everywhere
                kept.append((int(column[i]), zeros(system)._replace(**{block.name: change})))
    shares = local["mass"], local["stiffness"], local["rest"]
    return Columns(count, *shares, tuple(everywhere), tuple(led), tuple(velocity))


def none(count: int) -> Share:
    """`count` elements without a column."""
    return one_each(np.full(count, -1, np.int32), np.zeros(count))


def one_each(column: Indices, factor: Array) -> Share:
    """One column for each element."""
    return Share(np.arange(len(column) + 1, dtype=np.int32), column, factor)


def share(block: Block, p: Array, column: Indices, factor: Array) -> Share:
    """The columns and factors of all elements of a block at p (P,)."""
    own, factors = column[block.part].reshape(-1), block.factors
    if factors is not None:
        entries = factors.entries(p[block.part]) * factor[block.part][factors.column]
        starts = np.searchsorted(factors.row, np.arange(len(factors.base) + 1)).astype(np.int32)
        return Share(starts, own[factors.column].astype(np.int32), entries)
    places = own if block.mode == "L" else np.full(block.shape[0], own[0])
    return one_each(places.astype(np.int32), np.array(block.spread(factor), float))
