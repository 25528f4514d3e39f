"""What the program may move to take a cloth through keys: forces, handles, the wind, the velocity at the start.

Handles are fixed vertices on a path, the wind has keys: both are inputs of the scene that a fit knows as the kinds
`path` and `gusts`. So a scene to steer is the given one with such keys, and what was found is a scene again, which any
program that plays the scene can play.

The numbers z that a search moves, of order one each, and what they are of the scene.

Block by block: paths of handles, velocities at the start and forces of each cloth, the wind of all. A block is linear:
values = start + scale z, and its effort is |R z|², R (rows, Q) a sparse matrix that makes what counts as gentle of z,
without a unit: changes that are slow in time and smooth over the cloth are small in it. T is the time of the last key,
L the size of the cloth.

Forces may be those of the first modes of vibration of a cloth, as a net under even tension: smooth shapes over it, the
same for x, y and z. A flat cloth at rest has no stiffness across its plane, so its own modes would say nothing of the
shapes out of it. With L the Laplacian of its springs, weighted by stiffness, they are L φ = λ M φ, ΦᵀMΦ = I.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import block_diag, csc_array, csr_array, diags_array, eye_array, hstack, kron, vstack
from scipy.sparse.linalg import eigsh, spsolve

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.eigen import connected_components
from clothfit.base.errors import InvalidInput
from clothfit.control.closed_loop import Costs, neighbours
from clothfit.control.keyframes import Key
from clothfit.engine.inputs import knots
from clothfit.engine.inputs.interpolation import resolved
from clothfit.engine.system import System
from clothfit.meshes.new_scene import text
from clothfit.scene.cloth import Cloth
from clothfit.scene.keys import Keys, Pin
from clothfit.scene.scene import Scene, dumps, load


@dataclass(frozen=True, eq=False)
class Handle:
    """Vertices that move together, each from where it is at the start."""

    cloth: int  # of the scene, counted from 0
    vertices: Indices  # (m,)


@dataclass(frozen=True, eq=False)
class Controls:
    """What may move. Without forces, handles, wind and velocity: forces on all vertices that are not fixed."""

    forces: Sequence[Flags] | None = None  # of each object, the vertices (n,) that forces may act on
    handles: tuple[Handle, ...] = ()  # whose paths are found
    wind: bool = False  # over time
    velocity: bool = False  # at the start
    every: float | None = None  # s between two knots in time; None: forces of each step, and SPACING for the others
    modes: int | None = None  # forces in the first so many modes of vibration; None: by vertices

    @property
    def follows(self) -> bool:
        """Whether forces of every vertex and step alone are asked for, which a closed loop finds."""
        return not (self.handles or self.wind or self.velocity or self.every or self.modes)

    @property
    def pushes(self) -> bool:
        """Whether forces are asked for."""
        return self.forces is not None or not (self.handles or self.wind or self.velocity)

    def led(self, scene: Scene, cloth: int) -> Flags:
        """Which vertices (n,) of a cloth handles move."""
        found = np.zeros(scene.vertex_counts[cloth], bool)
        for handle in self.handles:
            if handle.cloth == cloth:
                found[handle.vertices] = True
        return found


def steered(scene: Scene, controls: Controls, end: float) -> Scene:
    """The scene with keys for its handles and its wind up to a time, s, that move as they did without control. Raises
    InvalidInput where a handle cannot be one.
    """
    if not controls.handles and not controls.wind:
        return scene
    document = json.loads(dumps(scene).decode(scene.source.encoding).lstrip("\ufeff"))
    at = knots.times(end, scene.delta, controls.every)
    if controls.wind:
        document["windVelKeys"] = knots.keyed(at, resolved(scene.wind_keys) if scene.wind_keys else None)
    for cloth in sorted({handle.cloth for handle in controls.handles}):
        own = [handle.vertices for handle in controls.handles if handle.cloth == cloth]
        lead(document["objects"][cloth], scene, cloth, own, at)
    made = load(io.StringIO(text(document)), folder=scene.folder)
    return replace(made, name=scene.name, title=scene.title, forces=scene.forces)


def lead(item: dict[str, Any], scene: Scene, cloth: int, handles: Sequence[Indices], at: Array) -> None:
    """Make handles pins of an object of a document, with a key at each knot (K,), s."""
    own, pins = scene.cloths[cloth], list(item.get("pins", []))
    fixed = list(item["vertIsFixed"])
    for vertices in handles:
        before = [i for i, pin in enumerate(own.pins) if np.isin(pin.vertices, vertices).any()]
        base = along(own.pins[before[0]], vertices, cloth) if before else None
        pin = {"vertices": vertices.tolist(), "posKeys": knots.keyed(at, base, 0.0)}
        if before:
            pins[before[0]] = pin
        else:
            pins.append(pin)
        for vertex in vertices.tolist():
            fixed[vertex] = True
    item["pins"], item["vertIsFixed"] = pins, fixed


def along(pin: Pin, vertices: Indices, cloth: int) -> Keys:
    """The path of a pin that becomes a handle. Raises InvalidInput where it cannot."""
    if not np.array_equal(np.sort(pin.vertices), np.sort(vertices)):
        raise InvalidInput(f"handles: a pin of objects[{cloth}] has some of these vertices and others; take it whole")
    if pin.rotation is not None or pin.position is None or pin.position.points:
        raise InvalidInput(f"handles: a pin of objects[{cloth}] turns, or follows a motion; it keeps its path")
    found = resolved(pin.position)
    if found.values.ndim != 2:
        raise InvalidInput(f"handles: a pin of objects[{cloth}] follows a motion; it keeps its path")
    return found


def flagged(scene: Scene, controls: Controls) -> Scene:
    """The steered scene with what is to be found as its only fitted kinds."""
    cloths = []
    for cloth in scene.cloths:
        own = {"path": bool(controls.handles) and any(pin.own for pin in cloth.pins), "velocity": controls.velocity}
        cloths.append(replace(cloth, settings="nn", fits={name: "L" for name, asked in own.items() if asked}))
    return replace(scene, cloths=tuple(cloths), fits={"gusts": "L"} if controls.wind else {})


def handle_keys(scene: Scene, controls: Controls, cloth: int) -> Flags:
    """Which of the keys (K,) of `Cloth.path` are those of handles, but for those at time 0."""
    own = scene.cloths[cloth]
    handles = [set(handle.vertices.tolist()) for handle in controls.handles if handle.cloth == cloth]
    mine = np.array([set(pin.vertices.tolist()) in handles for pin in own.pins], bool)
    owner = own.key_pins
    return np.asarray(mine[owner] & (np.arange(len(owner)) != own.datums)) if len(owner) else np.zeros(0, bool)


def immovable(scene: Scene, keys: Sequence[Key], controls: Controls) -> list[Flags]:
    """Of each key, which of its vertices (m,) no control can move: fixed ones that are no handles, and those that no
    springs join to a vertex that a control acts on.
    """
    reach = []
    for cloth, own in enumerate(scene.cloths):
        led = controls.led(scene, cloth)
        acts = led.copy()
        if controls.pushes:
            acts |= ~own.fixed & (True if controls.forces is None else controls.forces[cloth])
        if controls.velocity:
            acts |= ~own.fixed
        if controls.wind and own.drag > 0:
            acts[own.triangles] = True
        moves = ~own.fixed | led
        lot = connected_components(own.springs[moves[own.springs].all(axis=1)], len(own.mass))
        reach.append(moves & np.isin(lot, lot[acts & moves]))
    return [~reach[key.cloth][key.vertices] for key in keys]


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
