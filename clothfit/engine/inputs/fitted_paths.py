"""Paths of pins that a fit changes: how the values of keys, and an offset, move the pins at every step.

    x(t) = x̂(t) + R(t) (Σ_k s_k(t) c_k + d),      s_k(t) = φ_k(t) − φ_k(0)

for the keys k of a pin, with values c_k and weights φ_k in the interpolated value, of which the change since time 0
counts; d is the offset of all pins, R the turn of axes that move, x̂ what neither changes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import NO_TABLE, NO_VECTORS, Array, Indices
from clothfit.kernels.kernel import kernel, record
from clothfit.scene.cloth import Cloth
from clothfit.scene.keys import Keys


@record
class FittedPaths(NamedTuple):
    """Those of P vertices, by K keys; row r of a table is at time r h. Without rows nothing is fitted."""

    keys: Array = NO_VECTORS  # (K, 3), m, c
    offset: Array = np.zeros(3)  # (3,), m, d
    share: Array = np.zeros((0, 0))  # (R, K), s
    owner: Indices = np.zeros(0, np.int32)  # (K,), the pin that each key leads
    pin: Indices = np.zeros(0, np.int32)  # (P,), the pin that each vertex belongs to, −1 for none
    turn: Array = np.zeros((0, 3, 3))  # (R, 3, 3); none where axes do not turn
    base: Array = NO_TABLE  # (R, P, 3), m, x̂
    change: Array = NO_VECTORS  # (P, 3), m: how places change that the step leads to, or the gradient by them, per m
    change_later: Array = NO_VECTORS  # (P, 3), m: the same one step later

    @property
    def path(self) -> Array:
        """Where the vertices are, (R, P, 3), m."""
        return self.base + self.added

    @property
    def added(self) -> Array:
        """What keys and offset add, (R, P, 3), m."""
        moved = np.where(self.pin[:, None] >= 0, self.offset, 0.0) + np.zeros((len(self.share), 1, 1))
        for pin in np.unique(self.owner):
            own = self.owner == pin
            moved[:, self.pin == pin] += (self.share[:, own] @ self.keys[own])[:, None]
        return np.asarray(moved @ self.turn.transpose(0, 2, 1)) if len(self.turn) else moved


def build(cloth: Cloth, path: Array, turn: Array, changes: Callable[[Keys], Array]) -> FittedPaths:
    """Those of a cloth whose pins, and after them other vertices that are led, go along `path` (R, P, 3), m; `changes`
    gives the change of keys since time 0 at all rows.
    """
    if cloth.mode("path") == "n" and cloth.mode("shift") == "n":
        return FittedPaths()
    own = [(i, pin.own) for i, pin in enumerate(cloth.pins) if pin.own and cloth.mode("path") != "n"]
    shares = [changes(replace(keys, values=np.eye(len(keys.times)))) for _, keys in own]
    counts = np.concatenate([[len(pin.vertices) for pin in cloth.pins]]).astype(int)
    pin = np.full(path.shape[1], -1, np.int32)
    pin[: counts.sum()] = np.repeat(np.arange(len(counts)), counts)
    found = FittedPaths(
        keys=np.concatenate([np.zeros((0, 3)), *(keys.values for _, keys in own)]),
        offset=np.array(cloth.shift),
        share=np.ascontiguousarray(np.concatenate([np.zeros((len(path), 0)), *shares], axis=1)),
        owner=np.repeat([i for i, _ in own], [len(keys.times) for _, keys in own]).astype(np.int32),
        pin=pin, turn=turn, base=np.zeros_like(path), change=np.zeros(path.shape[1:]),
        change_later=np.zeros(path.shape[1:]),
    )  # fmt: skip
    return found._replace(base=path - found.added)


def with_values(fitted: FittedPaths, keys: Array, offset: Array) -> FittedPaths:
    """The same with other values, (K, 3) and (3,), m, where they are not empty, and with memory of its own for changes.
    """
    return fitted._replace(
        keys=np.array(keys, float) if len(keys) else fitted.keys,
        offset=np.array(offset, float) if len(offset) else fitted.offset,
        change=np.zeros_like(fitted.change),
        change_later=np.zeros_like(fitted.change),
    )


def later(fitted: FittedPaths, steps: int) -> FittedPaths:
    """Those of a motion that begins so many steps later."""
    return fitted._replace(share=fitted.share[steps:], turn=fitted.turn[steps:], base=fitted.base[steps:])


def moves(fitted: FittedPaths, row: int, keys: Array, offsets: Array) -> Array:
    """Change (P, 3, Q) of the places at a row for Q changes of the keys (K, 3, Q) and of the offset (3, Q)."""
    found = np.where(fitted.pin[:, None, None] >= 0, offsets, 0.0)
    for pin in np.unique(fitted.owner):
        own = fitted.owner == pin
        found[fitted.pin == pin] += np.tensordot(fitted.share[row, own], keys[own], 1)
    return np.asarray(np.einsum("ij,pjq->piq", fitted.turn[row], found)) if len(fitted.turn) else found


@kernel
def push_places(fitted, row, direction, out):
    """out (P, 3) = the change of the places at a row along a direction."""
    out[:] = 0.0
    for k in range(len(direction.path)):
        if fitted.share[row, k] != 0.0:
            for p in range(len(out)):
                if fitted.pin[p] == fitted.owner[k]:
                    for c in range(3):
                        out[p, c] += fitted.share[row, k] * direction.path[k, c]
    for p in range(len(out)):
        if len(direction.shift) > 0 and fitted.pin[p] >= 0:
            for c in range(3):
                out[p, c] += direction.shift[c]
        if len(fitted.turn) > 0:
            R, a, b, d = fitted.turn[row], out[p, 0], out[p, 1], out[p, 2]
            for c in range(3):
                out[p, c] = R[c, 0] * a + R[c, 1] * b + R[c, 2] * d


@kernel
def pull_places(fitted, row, bar, grad):
    """Add to `grad` what the gradient `bar` (P, 3) by the places at a row makes of it; `bar` becomes 0."""
    for p in range(len(bar)):
        if len(fitted.turn) > 0:
            R, a, b, d = fitted.turn[row], bar[p, 0], bar[p, 1], bar[p, 2]
            for c in range(3):
                bar[p, c] = R[0, c] * a + R[1, c] * b + R[2, c] * d
        if len(grad.shift) > 0 and fitted.pin[p] >= 0:
            for c in range(3):
                grad.shift[c] += bar[p, c]
    for k in range(len(grad.path)):
        if fitted.share[row, k] != 0.0:
            for p in range(len(bar)):
                if fitted.pin[p] == fitted.owner[k]:
                    for c in range(3):
                        grad.path[k, c] += fitted.share[row, k] * bar[p, c]
    bar[:] = 0.0
