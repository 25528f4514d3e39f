"""Pins whose paths are fitted, in a sensitivity: how they move along all columns, and the free vertices with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clothfit.base.arrays import Array, Elements, Indices
from clothfit.engine.forces import springs
from clothfit.engine.inputs.pin_derivatives import led, moves_of
from clothfit.engine.system import System
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import load3, store3


class Pins:
    """The rows of the pins among those of the f movable vertices, in arrays (3 f, Q)."""

    def __init__(self, system: System, columns: Sequence[tuple[int, Elements]], place: Indices) -> None:
        """`columns` are those that move the pins, `place` (n,) the place of each vertex among the movable ones, or −1.
        """
        self.system, self.place, self.given = system, place, [direction for _, direction in columns]
        self.columns = np.array([column for column, _ in columns], int)
        self.any = bool(led(system.inputs, len(place)).any())

    def changes(self, row: int, width: int) -> Array:
        """Change of their places at a row of the tables, (3 L, Q) for L pins in the order of the vertices."""
        inputs = self.system.inputs
        assert inputs is not None
        pinned = inputs.pins[inputs.fitted.pin >= 0]
        found = np.zeros((len(pinned), 3, width))
        if self.given:
            found[:, :, self.columns] = moves_of(inputs, row, self.given)[inputs.fitted.pin >= 0]
        return found[np.argsort(pinned)].reshape(-1, width)

    def start(self, dx: Array, dv: Array) -> None:
        """Write the change of the state at the start."""
        if self.any:
            first, second = (self.changes(row, dx.shape[1]) for row in (0, 1))
            rows = self.rows
            dx[rows], dv[rows] = first, (second - first) / self.system.h

    @property
    def rows(self) -> Indices:
        """Places (3 L,) of their coordinates among the rows."""
        own = np.sort(self.place[led(self.system.inputs, len(self.place))])
        return np.asarray((3 * own[:, None] + np.arange(3)).reshape(-1), np.int32)

    def velocity(self, step: int, system: System, dx: Array) -> Array:
        """Change of their velocity in a step of this system, for that of where it begins, dx (3 L, Q)."""
        return (self.changes(step + 1, dx.shape[1]) - dx) / system.h

    def sent(self, step: int, system: System, width: int) -> Array:
        """Change of their velocity after an explicit Euler step."""
        return (self.changes(step + 2, width) - self.changes(step + 1, width)) / system.h

    def couple(self, system: System, y: Array, dw: Array, right: Array) -> None:
        """right −= A_fp dw_p at y (n, 3)."""
        assert system.inputs is not None
        couple(system.springs, system.inputs.coupled, system.vertex.free, self.place, system.h, y, dw, right)


@kernel
def couple(links, coupled, free, place, h, y, dw, right):
    """The same for all springs of which one end is free and the other a pin that moves."""
    one, pull = np.zeros((1, 3)), np.zeros((3, 3))
    for c in range(len(coupled)):
        i = coupled[c]
        for end in range(2):
            pin, other = links.ends[i, end], links.ends[i, 1 - end]
            if free[pin] or place[pin] < 0:
                continue
            for b in range(3):
                one[:] = 0.0
                one[0, b] = 1.0
                store3(springs.pull_of(links, y, i, h, load3(one, 0)), pull, b)
            for a in range(3):
                for b in range(3):
                    for q in range(right.shape[1]):
                        right[3 * place[other] + a, q] += pull[b, a] * dw[3 * place[pin] + b, q]
