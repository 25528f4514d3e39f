"""The derivative of a motion by a few hundred numbers of its controls at once: a sensitivity with forces as columns."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.derivative import sensitivity as fitted
from clothfit.derivative.sensitivity import LEADING, Carried, Columns, Point
from clothfit.engine.rollout import Rollout
from clothfit.engine.system import System, mobile, zeros


def derivatives(
    system: System, motion: Rollout, directions: Sequence[tuple[str, int, Array]], needed: Collection[int]
) -> dict[int, Array]:
    """dX (3 f, Q) of the movable vertices after the steps that are needed, 0 the start; `directions` are kind, column
    and change.
    """
    width = 1 + max(column for _, column, _ in directions)
    carried = Pushed(system, columns(system, directions, width), directions)
    found = {0: carried.dx.copy()} if 0 in needed else {}
    for t in range(max(needed)):
        carried.through(motion, t)
        interrupts.check()
        if t + 1 in needed:
            found[t + 1] = carried.dx.copy()
    return found


def columns(system: System, directions: Sequence[tuple[str, int, Array]], width: int) -> Columns:
    """The columns of a sensitivity, those of forces left out."""
    led = [(q, zeros(system)._replace(**{kind: change})) for kind, q, change in directions if kind in LEADING]
    wind = [(q, zeros(system)._replace(gusts=change)) for kind, q, change in directions if kind == "gusts"]
    start = [(q, change) for kind, q, change in directions if kind == "velocity"]
    nothing = fitted.none(len(system.x0)), fitted.none(len(system.springs.rest)), fitted.none(0)
    return Columns(width, *nothing, tuple(wind), tuple(led), tuple(start))


class Pushed(Carried):
    """A sensitivity of which some columns are forces."""

    def __init__(self, system: System, given: Columns, directions: Sequence[tuple[str, int, Array]]) -> None:
        super().__init__(system, given)
        pushes = [(column, change) for kind, column, change in directions if kind == "force"]
        self.pushed = np.array([column for column, _ in pushes], int)
        moves = mobile(system)
        self.tables = np.array([change[:, moves].reshape(len(change), -1) for _, change in pushes])  # (P, T, 3 f)
        self.step = 0

    def solved(self, at: Point, w: Array, du: Array, step: int) -> Array:
        """The change of the velocity w of an iteration, for that of the one before, du (3 f, Q)."""
        self.step = step
        return super().solved(at, w, du, step)

    def right(self, at: Point, w: Array, du: Array) -> Array:
        """The right-hand side of an iteration to w; its matrix is left in the workspace."""
        found = super().right(at, w, du)
        if len(self.pushed):
            found[:, self.pushed] += at.system.h * self.tables[:, self.step].T
        return found
