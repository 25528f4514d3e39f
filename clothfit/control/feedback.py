"""Gains of a feedback around a found motion: the time-varying linear–quadratic regulator in a reduced basis.

Springs that pull each vertex to its place are the better feedback where forces act on all vertices: they know every
vertex, and act within the step. Where forces act on few, the others must be led by these, and that takes a model. With
k vibration modes of the cloth as a net under even tension, L φ = λ M φ and ΦᵀMΦ = I, a change of the state is
x = Φ q, v = Φ p, and z = (q, p) obeys z⁺ = A z + B g, the tangent of the steps that the engine takes, projected; g are
m shapes of forces. The gains K make the least of

    Σ over keys of mean |x|²/δ² + Σ over steps of mean |x|²/(δ² T) + h Σ |g|²/c,    g = −K z,

of a deviation δ that is small for the cloth, and with c the effort of the found forces: the first may be what the
second is. P = Q + Aᵀ P A − Aᵀ P B K with K = (R + Bᵀ P B)⁻¹ Bᵀ P A, from the last step to the first (D. P. Bertsekas,
Dynamic Programming and Optimal Control, volume I, section 4.1). Each step's A and B are made when they are needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.control.controls import modes_of
from clothfit.control.keyframes import Key
from clothfit.derivative.sensitivity import Columns, Point, Share, TangentSweep
from clothfit.engine.rollout import Rollout, rollout
from clothfit.engine.system import System, build
from clothfit.scene.forces import Forces, Regulator, state
from clothfit.scene.scene import Scene

MOST_SHAPES = 100
"""Modes k of a cloth, and shapes m of forces on it."""

MOST_NUMBERS = 8_000_000
"""Of all gains of a cloth: 32 MB in the file. Long motions get fewer modes."""

NEAR = 0.03
"""The deviation δ, relative to the size of the cloth: its bounding box's diagonal."""

NO_SHARE = Share(np.zeros(1, np.int32), np.zeros(0, np.int32), np.zeros(0))


Part: TypeAlias = tuple[Array, Array, Array, Rollout]
"""What `gains` finds of one cloth."""


class Tangent(TangentSweep):
    """The tangent of single steps: columns for changes of position and velocity along modes, and for forces."""

    def __init__(self, system: System, modes: Array, push: Array) -> None:
        """`modes` (f, k) and `push` (f, m) on the f free vertices."""
        self.along, self.forces = (np.kron(each, np.eye(3)) for each in (modes, push))
        self.count = self.along.shape[1]
        super().__init__(
            system, Columns(2 * self.count + self.forces.shape[1], NO_SHARE, NO_SHARE, NO_SHARE, (), (), ())
        )
        self.seen = (self.mass * self.along).T

    def right(self, at: Point, w: Array, du: Array) -> Array:
        """With the impulse of the forces."""
        found = super().right(at, w, du)
        found[:, 2 * self.count :] += at.system.h * self.forces
        return found

    def matrices(self, chunk: Rollout, t: int) -> tuple[Array, Array]:
        """A (6 k, 6 k) and B (6 k, 3 m) of step t; of a BDF2 step for changes that began with one of implicit Euler."""
        q = self.count
        self.dx[:], self.dv[:] = 0.0, 0.0
        self.dx[:, :q], self.dv[:, q : 2 * q] = self.along, self.along
        self.dx_before[:], self.dv_before[:] = self.dx - self.system.h * self.dv, self.dv
        self.through(chunk, t)
        after = np.concatenate([self.seen @ self.dx, self.seen @ self.dv])
        return after[:, : 2 * q], after[:, 2 * q :]


def with_gains(scene: Scene, plan: Forces, keys: Sequence[Key], bound: float = np.inf) -> Forces:
    """Planned forces, none of them above `bound`, N, with gains in place of the springs of those cloths with keys on
    which they act at some, but not all, of the vertices that are free.
    """
    parts = {}
    with threads.single():
        for cloth in sorted({key.cloth for key in keys}):
            own = [key for key in keys if key.cloth == cloth]
            acting: Flags = np.asarray(plan.values[:, scene.vertices(cloth)].any(axis=(0, 2)))
            if acting.any() and (~acting & ~scene.cloths[cloth].fixed).any():
                parts[cloth] = gains(scene, cloth, plan, own, acting)
    if not parts:
        return plan
    regulator = joined(scene, len(plan.times), parts, bound)
    if plan.gain is None:
        return replace(plan, regulator=regulator)
    springs = plan.gain.copy()
    for cloth in parts:
        springs[:, scene.vertices(cloth)] = 0.0
    if not springs.any():
        return replace(plan, gain=None, places=None, regulator=regulator)
    return replace(plan, gain=springs, regulator=regulator)


def joined(scene: Scene, rows: int, parts: dict[int, Part], bound: float) -> Regulator:
    """One feedback of the parts of some cloths."""
    k, m = max(part[0].shape[1] for part in parts.values()), max(part[1].shape[1] for part in parts.values())
    n, cloths = sum(scene.vertex_counts), len(scene.cloths)
    found_gains, reference = np.zeros((cloths, rows, 3 * m, 6 * k), np.float32), np.zeros((cloths, rows, 6 * k))
    made = Regulator(np.zeros((n, k)), np.zeros((n, m)), found_gains, reference, bound)
    for cloth, (measure, push, found, motion) in parts.items():
        part, own_k, own_m = scene.vertices(cloth), measure.shape[1], push.shape[1]
        made.measure[part, :own_k], made.push[part, :own_m] = measure, push
        filled = made.gains[cloth].reshape(rows, 3 * m, 2, 3 * k)
        filled[:, : 3 * own_m, :, : 3 * own_k] = found.reshape(rows, 3 * own_m, 2, 3 * own_k)
        for t in range(rows):
            made.reference[cloth, t] = state(made.measure[part], motion.x[t], motion.velocity(t))
    return made


def gains(scene: Scene, cloth: int, plan: Forces, keys: Sequence[Key], acting: Flags) -> Part:
    """Weights W (n, k), shapes of forces E (n, m), gains (T, 3 m, 6 k), and the motion, of one cloth."""
    own, steps, h = scene.cloths[cloth], len(plan.times), scene.delta
    free = np.flatnonzero(~own.fixed).astype(np.int32)
    count, forces = count_of(len(free), int(acting.sum()), steps)
    shapes = modes_of(own, free, count)
    weights = own.mass[free, None] * shapes
    push = spanning(weights, acting[free], forces)
    system = build(scene.with_forces(plan), cloth, steps=steps)
    motion, _ = rollout(system, steps, scene.tolerance)
    sum_of_squares = float((plan.values[:, scene.vertices(cloth)] ** 2).sum())
    near = NEAR * float(np.linalg.norm(np.ptp(own.positions, axis=0))) or 1.0
    least = float((own.mass * near / (steps * h) ** 2) @ (own.mass * near / (steps * h) ** 2)) * steps
    price = np.eye(3 * push.shape[1]) / max(sum_of_squares, least)
    tangent, weight = Tangent(system, shapes, push), worths(shapes, free, keys, steps)
    found = riccati(tangent, motion, [each / near**2 for each in weight], price)
    measure, out = np.zeros((len(own.mass), shapes.shape[1])), np.zeros((len(own.mass), push.shape[1]))
    measure[free], out[free] = weights, push
    return measure, out, found, motion


def count_of(free: int, acting: int, steps: int) -> tuple[int, int]:
    """How many modes of so many free vertices, and shapes of forces on so many of them, a motion is regulated with."""
    k, m = min(free, MOST_SHAPES), min(acting, MOST_SHAPES)
    while 18 * k * m * steps > MOST_NUMBERS and k > 1:
        k, m = max(k // 2, 1), min(m, max(k // 2, 1))
    return k, m


def spanning(weights: Array, acting: Flags, count: int) -> Array:
    """Shapes of forces E (f, m), m at most `count`, 0 where none act, that do most to coordinates of these weights."""
    push = np.zeros((len(weights), min(count, int(acting.sum()))))
    left, _, _ = np.linalg.svd(weights[acting], full_matrices=False)
    push[acting] = left[:, : push.shape[1]]
    return push


def worths(shapes: Array, free: Indices, keys: Sequence[Key], steps: int) -> list[Array]:
    """What a deviation (k, k) along one axis of the modes (f, k) costs after each step, relative to δ²."""
    along = shapes.T @ shapes / (len(free) * steps)
    found = [along] * steps
    for key in keys:
        own = shapes[np.isin(free, key.vertices)]
        if not len(own):
            continue
        if key.share is None:
            at = own.T @ own / len(own)
        else:
            mean = shapes.T @ spread(key, free)
            at = np.outer(mean, mean)
        found[key.step - 1] = found[key.step - 1] + key.weight * at
    return found


def spread(key: Key, free: Indices) -> Array:
    """The share (f,) of each free vertex in the mean that a key asks for."""
    assert key.share is not None
    whole = np.zeros(max(int(free.max()), int(key.vertices.max())) + 1)
    np.add.at(whole, key.vertices, key.share)
    return np.asarray(whole[free])


def riccati(tangent: Tangent, motion: Rollout, weight: Sequence[Array], price: Array) -> Array:
    """The gains (T, 3 m, 6 k) for what deviations (k, k) cost after each step, and forces (3 m, 3 m) in each."""
    size, found = 2 * tangent.count, np.zeros((motion.steps, len(price), 2 * tangent.count))
    P = np.zeros((size, size))
    for t in range(motion.steps - 1, -1, -1):
        P[: size // 2, : size // 2] += np.kron(weight[t], np.eye(3))
        A, B = tangent.matrices(motion, t)
        found[t], P = backwards(A, B, P, price)
        interrupts.check()
    return found


def backwards(A: Array, B: Array, P: Array, price: Array) -> tuple[Array, Array]:
    """The gain of a step with z⁺ = A z + B g, and the cost zᵀ P z of what begins with it, for that after it."""
    from scipy.linalg import solve

    PB = P @ B
    gain = np.asarray(solve(price + B.T @ PB, PB.T @ A, assume_a="pos"))
    before = A.T @ (P @ A) - (A.T @ PB) @ gain
    return gain, 0.5 * (before + before.T)
