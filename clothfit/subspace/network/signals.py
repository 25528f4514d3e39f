"""What acts on each step of a cloth, as numbers: the inputs of a network beside its coordinates.

Of step t, which leads from frame t to t + 1, they are in this order, each only where the scene has it:

    wind (3), gravity (3)   of the tables of the step, m/s and m/s²: with a moving frame, in the axes of the world
    carrier (6)             velocity and change of velocity of what carries the cloth (`translation`), m/s
    turn (6)                its angular velocity and the change of that, rad/s, where the pins turn
    pins (6 P)              the places of the pins past the translation after the step, and their way in it, m
    colliders (2 · 3 D)     the rows of the tables of colliders, their places past the translation, and their change

The last two are many and move together, so that a mix of them, found in recorded motions, takes their place.
Coordinates are those in the axes of the world: there the ground keeps its direction, and how the pins are turned is
in the places of the pins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.engine.forces.collider_rows import PLACE, STATE
from clothfit.engine.system import System
from clothfit.subspace import translation

PLAIN = ("wind", "gravity", "carrier", "turn")
"""Parts that are inputs as they are."""

COLLIDERS = "colliders"

ORDER = (*PLAIN, "pins", COLLIDERS)

NO_TURN = 1e-6
"""rad/s that are no turn."""

FLAT = 1e-6
"""Relative moment of inertia below which pins are in a line."""

MOST = 24
"""Numbers that take the place of those of pins, or of colliders."""

LEFT_OUT = 1e-3
"""What of their change may be left out, relative."""


@dataclass(frozen=True, eq=False)
class Signals:
    """How the inputs of a network follow from those of a scene: (raw − mean) mix."""

    parts: tuple[tuple[str, int], ...]  # name and number of the raw ones
    mean: Array  # (raw,)
    mix: Array  # (raw, m)

    def fits(self, m: int) -> bool:
        """Whether the shapes fit m inputs, and all is finite."""
        raw = sum(size for _, size in self.parts)
        shaped = self.mean.shape == (raw,) and self.mix.shape == (raw, m)
        return shaped and bool(np.isfinite(self.mean).all() and np.isfinite(self.mix).all())

    def of(self, system: System, steps: int) -> Array:
        """The inputs (steps, m) of a motion; what the scene has not is 0, and what the network has not is left out: it
        was clamped to 0 (`play`). Raises InvalidInput where pins or colliders are others.
        """
        found = dict(raw(system, steps))
        tables = [np.zeros((steps, 0))]
        for name, size in self.parts:
            table = found.get(name, np.zeros((steps, size)) if name != COLLIDERS else None)
            if table is None or table.shape[1] != size or (COLLIDERS in found and COLLIDERS not in dict(self.parts)):
                given = names([(each, own.shape[1]) for each, own in found.items()])
                raise InvalidInput(f"the network was trained with {names(self.parts)}; here there are {given}")
            tables.append(table)
        return np.asarray((np.concatenate(tables, axis=1) - self.mean) @ self.mix)


def names(parts: Sequence[tuple[str, int]]) -> str:
    """What acts, for messages."""
    return ", ".join(name if name in PLAIN else f"{name} ({size} numbers)" for name, size in parts) or "none"


def raw(system: System, steps: int) -> list[tuple[str, Array]]:
    """The numbers of all parts, (steps, size) each. Raises InvalidInput for what a network does not know."""
    inputs = system.inputs
    if inputs is None:
        return []
    if len(inputs.poses.body) and np.ptp(inputs.poses.first) > 0:
        raise InvalidInput("a network does not know bodies that change their shape; --method physics does")
    late = slice(inputs.lead, inputs.lead + steps)
    found = [(name, table[late]) for name, table in (("wind", inputs.wind), ("gravity", inputs.gravity)) if len(table)]
    shift = translation.shift(inputs, steps + 1)
    if inputs.path.size:
        found.append(("carrier", with_change(np.diff(shift[:, 0], axis=0) / system.h)))
        turn = turned(inputs.path[: steps + 1], system)
        if np.abs(turn).max(initial=0.0) > NO_TURN:
            found.append(("turn", turn))
        found.append(("pins", of_places(inputs.path[: steps + 1] - inputs.path[0] - shift)))
    if len(inputs.centre):
        places, spheres = inputs.centre[: steps + 1].copy(), len(system.spheres.radius)
        places[:, :spheres] -= shift
        places[:, spheres + PLACE :: STATE] -= shift
        found.append((COLLIDERS, of_places(places)))
    return found


def with_change(rate: Array) -> Array:
    """Rates (steps, 3), and their changes since the step before; at the start pins have the velocity of their first
    step (`engine.system.at_start`).
    """
    return np.concatenate([rate, np.diff(rate, axis=0, prepend=rate[:1])], axis=1)


def turned(path: Array, system: System) -> Array:
    """Angular velocity ω and its change (steps, 6), rad/s, of the nearest rigid motion of pins at places (steps + 1, P,
    3): (Σ |r|² − r rᵀ) ω = Σ r × ṙ, with r from their mean. About the line of pins in one the turn is 0.
    """
    away = path - path.mean(axis=1, keepdims=True)
    r, way = 0.5 * (away[1:] + away[:-1]), np.diff(away, axis=0)
    square = np.einsum("tpi,tpi->t", r, r)
    inertia = square[:, None, None] * np.eye(3) - np.einsum("tpi,tpj->tij", r, r)
    inverse, moment = np.linalg.pinv(inertia, rcond=FLAT, hermitian=True), np.cross(r, way).sum(axis=1)
    return with_change(np.einsum("tij,tj->ti", inverse, moment) / system.h)


def of_places(x: Array) -> Array:
    """Places after each step, and ways in it, (steps, 6 n), of places (steps + 1, n, 3)."""
    flat = x.reshape(len(x), -1)
    return np.concatenate([flat[1:], np.diff(flat, axis=0)], axis=1)


def fitted(tables: Sequence[list[tuple[str, Array]]]) -> Signals:
    """The signals of recorded motions, from the raw ones of each: those of many numbers as their main components. What
    some of the motions have not is 0 in them. Raises InvalidInput where pins or colliders are not the same in all.
    """
    from scipy.linalg import block_diag

    found = [dict(table) for table in tables]
    sizes = {name: table.shape[1] for each in found for name, table in each.items()}
    if any(table.shape[1] != sizes[name] for each in found for name, table in each.items()):
        raise InvalidInput("a network needs motions with the same pins and colliders in all")
    parts = tuple((name, sizes[name]) for name in ORDER if name in sizes)
    means, mixes = [np.zeros(0)], []
    for name, size in parts:
        every = np.concatenate([each.get(name, np.zeros((1, size))) for each in found])
        plain = name in PLAIN
        means.append(np.zeros(size) if plain else every.mean(axis=0))
        mixes.append(np.eye(size) if plain else components(every - means[-1]))
    return Signals(parts, np.concatenate(means), block_diag(np.zeros((0, 0)), *mixes))


def components(away: Array) -> Array:
    """The mix (size, k) of the main components of numbers (steps, size), places and ways each of their own size."""
    half = away.shape[1] // 2
    sizes = (np.abs(part).max(initial=0.0) for part in (away[:, :half], away[:, half:]))
    scale = np.repeat([1.0 / max(float(size), 1e-12) for size in sizes], half)
    _, values, rows = np.linalg.svd(away * scale, full_matrices=False)
    total = float((values**2).sum())
    if total < 1e-18:
        return np.zeros((away.shape[1], 0))
    rest = np.sqrt(np.maximum(total - np.cumsum(values**2), 0.0) / total)
    count = min(MOST, int(np.argmax(rest <= LEFT_OUT)) + 1 if (rest <= LEFT_OUT).any() else MOST, len(values))
    return np.asarray(rows[:count].T * scale[:, None])
