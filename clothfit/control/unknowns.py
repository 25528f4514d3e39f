"""The numbers z that a search moves, of order one each, and what they are of the scene.

Block by block: paths of handles, velocities at the start and forces of each cloth, the wind of all. A block is linear:
values = start + scale z, and its effort is |R z|², R (rows, Q) a sparse matrix that makes what counts as gentle of z,
without a unit: changes that are slow in time and smooth over the cloth are small in it. T is the time of the last key,
L the size of the cloth.

Forces may be those of the first modes of vibration of a cloth, as a net under even tension: smooth shapes over it, the
same for x, y and z. A flat cloth at rest has no stiffness across its plane, so its own modes would say nothing of the
shapes out of it. With L the Laplacian of its springs, weighted by stiffness, they are L φ = λ M φ, ΦᵀMΦ = I.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import block_diag, csc_array, csr_array, diags_array, eye_array, hstack, kron, vstack
from scipy.sparse.linalg import eigsh, spsolve

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput
from clothfit.control.closed_loop import Costs, neighbours
from clothfit.control.controls import Controls, handle_keys
from clothfit.engine.inputs import knots
from clothfit.engine.system import System
from clothfit.scene.cloth import Cloth
from clothfit.scene.scene import Scene

BREEZE = 5.0
"""m/s, the size of a change of the wind, unless the wind itself is stronger."""

SLOW = 0.1
"""Share of the whole time in which the wind may change by its size, and distance in springs over which velocities may.
"""


@dataclass(frozen=True, eq=False)
class Block:
    """Q numbers, and values (V,) of one kind of one cloth, or of all where that is −1."""

    kind: str  # of `Elements`
    cloth: int
    start: Array  # (V,), in the kind's unit
    basis: csr_array  # (V, Q), values per z
    gentle: csr_array  # R, (rows, Q)
    shape: tuple[int, ...]  # of the values in `Elements`

    @property
    def size(self) -> int:
        """Q."""
        return int(self.basis.shape[1])

    def values(self, z: Array) -> Array:
        """The values at z (Q,)."""
        return np.asarray(self.start + self.basis @ z).reshape(self.shape)

    def change(self, dz: Array) -> Array:
        """Their change for dz (Q,)."""
        return np.asarray(self.basis @ dz).reshape(self.shape)

    def gradient(self, by_values: Array) -> Array:
        """The gradient by z (Q,) from that by the values."""
        return np.asarray(self.basis.T @ by_values.reshape(-1))

    def nearest(self, change: Array) -> Array:
        """The z (Q,) whose change of the values is nearest to a given one."""
        return np.asarray(spsolve(csc_array(self.basis.T @ self.basis), self.gradient(change)))


def blocks(scene: Scene, controls: Controls, systems: dict[int, System], end: float, costs: Costs) -> list[Block]:
    """The blocks of a steered and flagged scene, up to a time, s; `systems` are those of its cloths with keys."""
    found, at = [], knots.times(end, scene.delta, controls.every)
    for cloth, system in systems.items():
        own = scene.cloths[cloth]
        mine = handle_keys(scene, controls, cloth)
        if mine.any():
            found.append(paths(own, cloth, mine, at))
        free = ~own.fixed
        if controls.velocity and free.any():
            found.append(velocities(own, cloth, end))
        if controls.pushes and (free & (True if controls.forces is None else controls.forces[cloth])).any():
            found.append(forces(scene, cloth, controls, system, end, costs))
    if controls.wind:
        found.append(gusts(scene, at))
    return found


def extent(cloth: Cloth) -> float:
    """L, m; 1 for a single vertex."""
    return float(np.ptp(cloth.positions, axis=0).max()) or 1.0


def per_component(matrix: Any) -> csr_array:
    """The same matrix for x, y and z of vectors."""
    return csr_array(kron(matrix, eye_array(3)))


def chosen(flags: Flags) -> csr_array:
    """The matrix (V, Q) that puts Q numbers where Q of V flags are set."""
    return csr_array(eye_array(len(flags)).tocsc()[:, np.flatnonzero(flags)])


def paths(own: Cloth, cloth: int, mine: Flags, at: Array) -> Block:
    """Keys of handles, at knots (K,), s: gentle is ∫ |acceleration|² dt T³/L², the start at rest."""
    scale, owner, count = extent(own), own.key_pins, len(at)
    second: Any = diags_array([1.0, -2.0, 1.0], offsets=[-1, 0, 1], shape=(count, count)).tolil()
    second[0, :2] = [-2.0, 2.0]
    second[-1, -2:] = [2.0, -2.0]
    gentle = csr_array(second * (at[1] ** -1.5 * at[-1] ** 1.5))[:, 1:]  # the first key keeps its value
    shares, costs = [], []
    for i, pin in enumerate(own.pins):
        if pin.own is None or not mine[owner == i].any():
            continue
        share = csr_array((len(owner), count - 1)).tolil()
        share[np.flatnonzero(owner == i)] = knots.shares(at, pin.own)[:, 1:]
        shares.append(csr_array(share))
        costs.append(gentle)
    return Block(
        "path", cloth, own.path.reshape(-1).copy(), scale * per_component(csr_array(hstack(shares))),
        per_component(csr_array(block_diag(costs))), own.path.shape,
    )  # fmt: skip


def gusts(scene: Scene, at: Array) -> Block:
    """Keys of the wind, at knots (K,), s: gentle is ∫ (|change|² + (SLOW T)² |its rate|²) dt/T, relative to the breeze.
    """
    assert scene.wind_keys is not None
    count, tau, end = len(at), float(at[1]), float(at[-1])
    rate = diags_array([-1.0, 1.0], offsets=[0, 1], shape=(count - 1, count)) * (SLOW * end / tau)
    gentle = csr_array(vstack([eye_array(count), rate])) * np.sqrt(tau / end)
    scale = max(BREEZE, float(np.linalg.norm(scene.wind)))
    basis = scale * per_component(csr_array(knots.shares(at, scene.wind_keys)))
    return Block("gusts", -1, scene.gusts.reshape(-1).copy(), basis, per_component(gentle), scene.gusts.shape)


def velocities(own: Cloth, cloth: int, end: float) -> Block:
    """Velocities at the start: gentle is their mean square, and that of differences along springs, relative to L/T."""
    basis = chosen(~own.fixed)
    count, springs = len(own.mass), own.springs[(~own.fixed[own.springs]).all(axis=1)]
    ends = np.arange(len(springs)).repeat(2), springs.reshape(-1)
    along = csr_array((np.tile([-1.0, 1.0], len(springs)), ends), shape=(len(springs), count)) * (1.0 / SLOW)
    free = int((~own.fixed).sum())
    differences = csr_array(along @ basis) * np.sqrt(free / max(len(springs), 1))
    gentle = csr_array(vstack([eye_array(free), differences])) / np.sqrt(free)
    scale = extent(own) / end
    return Block(
        "velocity", cloth, np.where(own.fixed[:, None], 0.0, own.velocity).reshape(-1), scale * per_component(basis),
        per_component(gentle), own.velocity.shape,
    )  # fmt: skip


def forces(scene: Scene, cloth: int, controls: Controls, system: System, end: float, costs: Costs) -> Block:
    """Forces at knots, linear in between, or in each step, of vertices or of modes: gentle is their mean square over
    time and vertices, relative to a vertex' mean weight or to what moves it by L in T, if that is more.
    """
    own, h = scene.cloths[cloth], scene.delta
    steps = round(end / h)
    assert system.inputs is not None
    rows, n = len(system.inputs.force), len(own.mass)
    acts = ~own.fixed & (True if controls.forces is None else controls.forces[cloth])
    scale = float(own.mass.mean()) * max(float(np.linalg.norm(scene.gravity)), extent(own) / end**2)
    share = hats(rows, steps, h, controls.every)
    if controls.modes:
        over = per_component(csr_array(shapes_of(own, acts, controls.modes)))
        across = csr_array(triangle(over.T @ over))
    else:
        over = per_component(chosen(acts))
        across = csr_array(eye_array(over.shape[1]))
    in_time: Any = triangle(share.T @ share) if controls.every else eye_array(steps)
    rows_of = [kron(in_time, across)]
    if costs.smooth > 0.0:
        change = csr_array(share[1:steps] - share[: steps - 1]) * (costs.smooth / h)
        rows_of.append(kron(change, across))
    if costs.even > 0.0:
        rows_of.append(kron(in_time, costs.even * (per_component(neighbours(own, acts)) @ over)))
    gentle = csr_array(vstack(rows_of)) / np.sqrt(steps * max(int(acts.sum()), 1))
    basis = scale * csr_array(kron(share, over))
    return Block("force", cloth, system.inputs.force.reshape(-1).copy(), basis, gentle, (rows, n, 3))


def shapes_of(own: Cloth, acts: Flags, count: int) -> Array:
    """The first modes of vibration (n, count), their largest value 1, and 0 where no force `acts` (n,). Raises
    InvalidInput where there are not so many.
    """
    free = np.flatnonzero(~own.fixed).astype(np.int32)
    if count > len(free):
        raise InvalidInput(f"modes: {count} are asked for; the cloth has {len(free)}")
    found = np.zeros((len(own.mass), count))
    found[free] = modes_of(own, free, count)
    found[~acts] = 0.0
    return np.asarray(found / np.maximum(np.abs(found).max(axis=0), 1e-300))


def triangle(gram: Any) -> csr_array:
    """The upper triangular factor of a Gram matrix (Q, Q)."""
    full = gram.toarray()
    return csr_array(np.linalg.cholesky(full + 1e-12 * np.eye(len(full)) * full.diagonal().max()).T)


def hats(rows: int, steps: int, h: float, every: float | None) -> csr_array:
    """The share (rows, K) of each knot in the rows of a table of which `steps` act: linear between knots."""
    if every is None:
        return csr_array(eye_array(rows, steps))
    count = max(round(steps * h / max(every, h)), 1) + 1
    places = np.linspace(0, max(steps - 1, 1), min(count, steps))
    found = np.zeros((rows, len(places)))
    for k, unit in enumerate(np.eye(len(places))):
        found[:steps, k] = np.interp(np.arange(steps), places, unit)
    return csr_array(found)


DENSE = 1500
"""Vertices up to which all modes are found at once."""


def modes_of(cloth: Cloth, free: Indices, count: int) -> Array:
    """The modes (f, count) with the lowest frequencies of the f free vertices."""
    ends, n = np.concatenate([cloth.springs, cloth.springs[:, ::-1]]), len(cloth.mass)
    graph = csr_array((np.concatenate([cloth.stiffness, cloth.stiffness]), (ends[:, 0], ends[:, 1])), shape=(n, n))
    scale = 1.0 / np.sqrt(cloth.mass[free])
    inner = csr_array(diags_array(graph.sum(axis=1)) - graph)[free][:, free]
    balanced = diags_array(scale) @ inner @ diags_array(scale)
    if len(free) <= DENSE or 3 * count > len(free):
        _, found = eigh(balanced.toarray(), subset_by_index=[0, count - 1])
    else:

        below = -1e-6 * float(balanced.diagonal().max())
        start = np.random.default_rng(0).normal(size=len(free))
        _, found = eigsh(balanced.tocsc(), count, sigma=below, v0=start)
    return np.asarray(scale[:, None] * found)
