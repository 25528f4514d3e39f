"""From the numbers of the controls to how far the cloths are from the keys, along the simulation, and its derivative.

The residuals are √w (x − x* + μ) of each key, in root mean square over its vertices, with μ the multipliers of hard
keys, and √γ R z of each block. J dz is a tangent sweep of each cloth, Jᵀ r an adjoint sweep, each about as long as a
simulation; for a few hundred numbers J is formed as a whole, by a sensitivity with forces as columns (`Pushed`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeAlias

import numpy as np
from scipy.sparse import block_diag, csr_array

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Elements, Indices
from clothfit.control.closed_loop import Costs
from clothfit.control.controls import Block, Controls, blocks, flagged
from clothfit.control.keyframes import Key, left_of
from clothfit.derivative import adjoint, sensitivity
from clothfit.derivative.sensitivity import LEADING, Columns, Point, TangentSweep
from clothfit.engine.rollout import Rollout, rollout
from clothfit.engine.system import System, build, mobile, with_elements, zeros
from clothfit.motion.simulate import limited
from clothfit.scene.forces import Forces
from clothfit.scene.scene import Scene

MOST_COLUMNS = 600
"""Numbers up to which J is formed."""

TOLERANCE = 1e-9
"""Of the linear systems of the derivatives, relative; the motion is the one that plays back."""


Moves: TypeAlias = Callable[[int, Indices], Array]
"""What gives the derivative (m, 3, Q) of the places of vertices after a step."""


@dataclass(frozen=True, eq=False)
class Shot:
    """The motions that controls lead to, of the cloths that have keys; None where one diverges."""

    z: Array
    systems: dict[int, System]
    motions: dict[int, Rollout]


class Shooting:
    """The residuals of a steered scene by the numbers z (Q,) of its controls."""

    def __init__(self, scene: Scene, keys: Sequence[Key], controls: Controls, steps: int, costs: Costs) -> None:
        """`scene` is steered (`controls.steered`)."""
        self.scene, self.keys, self.controls, self.steps, self.most = scene, list(keys), controls, steps, costs.most
        table = Forces(scene.delta * np.arange(steps, dtype=float), np.zeros((steps, sum(scene.vertex_counts), 3)))
        given = flagged(scene, controls)
        if controls.pushes and given.forces is None:
            given = given.with_forces(table)
        self.systems = {c: build(given, c, steps=steps) for c in sorted({key.cloth for key in keys})}
        self.blocks = blocks(given, controls, self.systems, steps * scene.delta, costs)
        self.parts = np.cumsum([0, *(block.size for block in self.blocks)])
        self.multipliers = [np.zeros_like(key.positions) for key in self.keys]
        self.gamma, self.evaluations = 0.0, 0
        self.horizon = steps  # only keys up to this step count

    @property
    def size(self) -> int:
        """Q."""
        return int(self.parts[-1])

    def own(self, z: Array) -> list[tuple[Block, Array]]:
        """The blocks with their numbers."""
        return [(block, z[self.parts[i] : self.parts[i + 1]]) for i, block in enumerate(self.blocks)]

    def values(self, z: Array, cloth: int) -> dict[str, Array]:
        """The values of the kinds that are moved of a cloth."""
        return {block.kind: block.values(own) for block, own in self.own(z) if block.cloth in (cloth, -1)}

    def compile(self) -> None:
        """Have all kernels compiled, which is no part of a search."""
        self.horizon = 1
        keys, self.keys = self.keys, [replace(key, step=1, velocities=None) for key in self.keys]
        shot = self.shoot(np.zeros(self.size))
        if shot is not None:
            self.pull(shot, self.residuals(shot))
            if self.is_small:
                self.matrix(shot)
            else:
                self.push(shot, np.zeros(self.size))
        self.keys, self.horizon, self.evaluations = keys, self.steps, 0

    def forces(self, z: Array) -> Forces:
        """The forces on all vertices."""
        u = np.zeros((self.steps, sum(self.scene.vertex_counts), 3))
        for block, own in self.own(z):
            if block.kind == "force":
                for t, row in enumerate(block.values(own)[: self.steps]):
                    u[t, self.scene.vertices(block.cloth)] = limited(row, self.most)
        return Forces(self.scene.delta * np.arange(self.steps, dtype=float), u)

    def shoot(self, z: Array) -> Shot | None:
        """Simulate up to the horizon."""
        self.evaluations += 1
        systems, motions = {}, {}
        for cloth, system in self.systems.items():
            given = Elements(system.vertex.mass, system.springs.stiffness, **self.values(z, cloth))
            systems[cloth] = with_elements(system, given)
            motions[cloth], good = rollout(systems[cloth], self.horizon, self.scene.tolerance)
            if good < self.horizon:
                return None
        return Shot(z.copy(), systems, motions)

    def counted(self) -> list[tuple[int, Key, float]]:
        """The keys up to the horizon: number, key and √w of a vertex."""
        return [
            (i, key, float(np.sqrt(key.weight / len(key.positions))))
            for i, key in enumerate(self.keys)
            if key.step <= self.horizon
        ]

    def residuals(self, shot: Shot) -> Array:
        """r (N,), m."""
        parts = []
        for i, key, weight in self.counted():
            x = shot.motions[key.cloth].x
            parts.append(weight * (left_of(key, x) + self.multipliers[i]).reshape(-1))
            if key.velocities is not None:  # missed over the time since the key before, m
                v = (x[key.step, key.vertices] - x[key.step - 1, key.vertices]) / self.scene.delta
                parts.append(weight * ((v - key.velocities) * self.since(key)).reshape(-1))
        return np.concatenate([*parts, *self.efforts(shot.z), *self.excess(shot.z)])

    def since(self, key: Key) -> float:
        """The time from the key before, or the start, to a key, s."""
        before = max((each.step for each in self.keys if each.step < key.step), default=0)
        return (key.step - before) * self.scene.delta

    def efforts(self, z: Array) -> list[Array]:
        """√γ R z of each block."""
        return [np.sqrt(self.gamma) * (block.gentle @ own) for block, own in self.own(z)]

    def excess(self, z: Array) -> list[Array]:
        """The excess of forces over their bound, as a penalty of the size of the keys'."""
        if not np.isfinite(self.most):
            return []
        forces = (block.values(own) for block, own in self.own(z) if block.kind == "force")
        return [10.0 * (np.maximum(np.linalg.norm(u, axis=2) / self.most - 1.0, 0.0)).reshape(-1) for u in forces]

    def excess_slope(self, z: Array) -> list[tuple[int, Array]]:
        """The derivative (rows, n, 3) of the excess by each force, with the number of its block."""
        found = []
        for i, (block, own) in enumerate(self.own(z)):
            if block.kind == "force" and np.isfinite(self.most):
                u = block.values(own)
                size = np.linalg.norm(u, axis=2, keepdims=True)
                found.append((i, np.where(size > self.most, 10.0 * u / np.maximum(size * self.most, 1e-300), 0.0)))
        return found

    def push(self, shot: Shot, dz: Array) -> Array:
        """J dz (N,)."""
        moves = {}
        for cloth, system in shot.systems.items():
            own = {b.kind: b.change(part) for b, part in self.own(dz) if b.cloth in (cloth, -1)}
            dx = adjoint.tangent(system, shot.motions[cloth], zeros(system)._replace(**own), TOLERANCE)
            moves[cloth] = partial(lambda dx, step, vertices: dx[step, vertices, :, None], dx)
        beyond = [
            (slope * self.blocks[i].change(self.own(dz)[i][1])).sum(axis=2).reshape(-1)
            for i, slope in self.excess_slope(shot.z)
        ]
        return np.concatenate([*(each[:, 0] for each in self.rows(moves, 1)), *self.efforts(dz), *beyond])

    def rows(self, moves: Mapping[int, Moves], columns: int) -> list[Array]:
        """The rows (…, columns) of all keys for what gives each cloth's derivative."""
        found = []
        for _, key, weight in self.counted():
            now = moves[key.cloth](key.step, key.vertices)
            mean = now if key.share is None else np.tensordot(key.share, now, 1)[None]
            found.append(weight * mean.reshape(-1, columns))
            if key.velocities is not None:
                rate = weight * self.since(key) / self.scene.delta
                found.append(rate * (now - moves[key.cloth](key.step - 1, key.vertices)).reshape(-1, columns))
        return found

    def matrix(self, shot: Shot) -> Array:
        """J (N, Q) whole, by sweeps with all columns at once."""
        rows = self.rows({cloth: self.moved(shot, cloth) for cloth in shot.systems}, self.size)
        return np.concatenate([*rows, self.gentle.toarray() * np.sqrt(self.gamma)])

    def moved(self, shot: Shot, cloth: int) -> Moves:
        """What gives the derivative (m, 3, Q) of the places of vertices after a step."""
        system, motion = shot.systems[cloth], shot.motions[cloth]
        needed = {key.step - back for _, key, _ in self.counted() if key.cloth == cloth for back in (0, 1)}
        mine = np.flatnonzero(np.repeat([block.cloth in (cloth, -1) for block in self.blocks], np.diff(self.parts)))
        known = derivatives(system, motion, self.directions(cloth), needed) if needed and len(mine) else {}
        moves = mobile(system)
        place = np.cumsum(moves) - 1

        def at(step: int, vertices: Indices) -> Array:
            found = np.zeros((len(vertices), 3, self.size))
            if len(mine):
                own = known[step].reshape(-1, 3, len(mine))
                led = moves[vertices]
                found[np.ix_(np.flatnonzero(led), np.arange(3), mine)] = own[place[vertices[led]]]
            return found

        return at

    def directions(self, cloth: int) -> list[tuple[str, int, Array]]:
        """The kind, number and change of each of the numbers that move a cloth, counted among these."""
        found, at = [], 0
        for block in self.blocks:
            if block.cloth in (cloth, -1):
                units = np.eye(block.size)
                found += [(block.kind, at + q, block.change(units[q])) for q in range(block.size)]
                at += block.size
        return found

    @cached_property
    def gentle(self) -> csr_array:
        """R of all blocks, (rows, Q)."""
        return csr_array(block_diag([block.gentle for block in self.blocks]))

    @property
    def is_small(self) -> bool:
        """Whether J is better formed as a whole: a few hundred columns, each of them at most as long as a sweep."""
        dense = all(sensitivity.is_dense(system) for system in self.systems.values())
        return self.size <= MOST_COLUMNS and dense and not np.isfinite(self.most)

    def pull(self, shot: Shot, r: Array) -> Array:
        """Jᵀ r (Q,)."""
        bars = {cloth: np.zeros_like(motion.x) for cloth, motion in shot.motions.items()}
        at = 0
        for _, key, weight in self.counted():
            bar, m = bars[key.cloth], len(key.positions)
            mine = weight * r[at : at + 3 * m].reshape(m, 3)
            bar[key.step, key.vertices] += mine if key.share is None else key.share[:, None] * mine
            at += 3 * m
            if key.velocities is not None:
                fast = weight * self.since(key) / self.scene.delta * r[at : at + 3 * m].reshape(m, 3)
                bar[key.step, key.vertices] += fast
                bar[key.step - 1, key.vertices] -= fast
                at += 3 * m
        found = np.zeros(self.size)
        for cloth, bar in bars.items():
            kinds = [block.kind for block in self.blocks if block.cloth in (cloth, -1)]
            grad = adjoint.gradient(shot.systems[cloth], shot.motions[cloth], bar, TOLERANCE, kinds)
            for i, block in enumerate(self.blocks):
                if block.cloth in (cloth, -1):
                    found[self.parts[i] : self.parts[i + 1]] += block.gradient(getattr(grad, block.kind))
        for i, block in enumerate(self.blocks):
            rows = block.gentle.shape[0]
            found[self.parts[i] : self.parts[i + 1]] += np.sqrt(self.gamma) * (block.gentle.T @ r[at : at + rows])
            at += rows
        for i, slope in self.excess_slope(shot.z):
            size = slope.shape[0] * slope.shape[1]
            beyond = slope * r[at : at + size].reshape(slope.shape[:2])[:, :, None]
            found[self.parts[i] : self.parts[i + 1]] += self.blocks[i].gradient(beyond)
            at += size
        return found

    def missed(self, shot: Shot) -> Array:
        """Root mean square distance from each key up to the horizon, m."""
        left = [left_of(key, shot.motions[key.cloth].x) for _, key, _ in self.counted()]
        return np.array([np.sqrt(np.mean((each**2).sum(axis=1))) for each in left])


def derivatives(
    system: System, motion: Rollout, directions: Sequence[tuple[str, int, Array]], needed: Collection[int]
) -> dict[int, Array]:
    """dX (3 f, Q) of the movable vertices after the steps that are needed, 0 the start; `directions` are kind, column
    and change.
    """
    width = 1 + max(column for _, column, _ in directions)
    sweep = Pushed(system, columns(system, directions, width), directions)
    found = {0: sweep.dx.copy()} if 0 in needed else {}
    for t in range(max(needed)):
        sweep.through(motion, t)
        interrupts.check()
        if t + 1 in needed:
            found[t + 1] = sweep.dx.copy()
    return found


def columns(system: System, directions: Sequence[tuple[str, int, Array]], width: int) -> Columns:
    """The columns of a sensitivity, those of forces left out."""
    led = [(q, zeros(system)._replace(**{kind: change})) for kind, q, change in directions if kind in LEADING]
    wind = [(q, zeros(system)._replace(gusts=change)) for kind, q, change in directions if kind == "gusts"]
    start = [(q, change) for kind, q, change in directions if kind == "velocity"]
    nothing = sensitivity.none(len(system.x0)), sensitivity.none(len(system.springs.rest)), sensitivity.none(0)
    return Columns(width, *nothing, tuple(wind), tuple(led), tuple(start))


class Pushed(TangentSweep):
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
