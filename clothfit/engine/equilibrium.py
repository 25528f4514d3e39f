"""The shape of a cloth at rest: where the forces on all free vertices are 0 and the energy has a minimum.

A step of endless length that moves nothing ends at rest: with h → ∞ and v = 0 the implicit step (`step.implicit`) asks
for f(x) = 0 alone, A/h² → −K, the tangent stiffness. So a cloth at rest is a motion whose steps stay where they are, of
a system without damping and with the time step `law.ENDLESS`. The derivatives of an implicit step are then, by the
implicit function theorem, those of the shape,

    K dx/dp = −∂f/∂p,

one linear solve backwards for a gradient, and one for each column of the sensitivity; what the shape was before does
not matter. M/h² is far below the rounding of K.

The shape itself is found by Newton's method, with the same steps: (M/h² − K) d = f. The step h grows while the energy
falls as it should and shrinks where it does not, as in pseudo-transient continuation (C. T. Kelley, D. E. Keyes,
Convergence analysis of pseudo-transient continuation, SIAM J. Numer. Anal. 35, 1998). A shape that is no minimum is
left along an unstable mode. Cloths have many shapes at rest, and which one is found depends on where the search begins.
A cloth that begins flat and level gets its weight little by little: so it folds as it would with ever less bending
stiffness, and nearly alike for nearly the same cloths. With its whole weight at once it falls into folds by chance.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.engine.forces import applied, collider_rows, total, vertex
from clothfit.engine.forces.law import ENDLESS
from clothfit.engine.solve import linear, sparse
from clothfit.engine.step import implicit
from clothfit.engine.system import System
from clothfit.kernels.kernel import kernel

IN_ORDER: dict[str, Any] = {"permc_spec": "NATURAL", "relax": 1, "panel_size": 1}
"""Of SuperLU, for unknowns in order: without panels, which take half the time of a small matrix."""

FIRST, CLOSE = 0.03, 0.3
"""The first step, s, and the longest one after one that failed; forces, relative to the weights, up to which the first
one is endless.
"""

LOADS, BORNE = (0.06, 0.12, 0.24, 0.48, 0.96), 1e-2
"""Shares of its weight that a cloth gets before the whole; forces that may be left then, relative to that share."""

UNLOADED = 1e-3
"""Forces along the weights, relative to these, below which nothing bears them."""

GROW, SHRINK = 1.4, 0.3
"""Factors of the step after one that lowers the energy, and after one that does not."""

MOST_STEPS = 2000
"""Steps before a search is given up."""

DONE, NEAR = 1e-12, 1e-6
"""Forces that are left, relative to the weights, where the search ends; and where it ends if rounding leaves more, or
where Newton's step is so short, in lengths of springs: that of stiff ones leaves more force.
"""

ENOUGH, GOOD = 0.05, 0.8
"""Share of the energy that Newton's model promises which a step needs, and above which the next one is longer."""

KICK, MODE_SEARCHES = 0.02, 5
"""How far a shape that is no minimum is moved along such a mode, in lengths of springs; and how often, at most."""


def shape_from(system: System, start: Array) -> tuple[Array, bool, int]:
    """The shape at rest (n, 3), m, that is found from `start`; whether it is one; and the direct solves it took."""
    search = _Search(system, start)
    for share in LOADS if search.is_unloaded() else ():
        search.bear(share)
        search.descend(BORNE)
    search.bear(1.0)
    for attempt in range(MODE_SEARCHES):
        if not search.descend():
            return search.x, False, search.solves
        mode = search.lowest()
        if mode is None:
            return search.x, True, search.solves
        reach = KICK * search.edge / np.abs(mode).max()
        search.x = search.x + (-1) ** attempt * reach * mode
    return search.x, False, search.solves


class _Search:
    """A search for a minimum of the energy."""

    def __init__(self, system: System, start: Array) -> None:
        self.whole, self.work, self.x, self.solves = system, implicit.workspace(system), np.array(start), 0
        self.rest, self.free = np.zeros_like(self.x), np.flatnonzero(system.vertex.free)
        weight = system.vertex.mass[self.free, None] * system.vertex.gravity
        pull = 1e-9 * system.springs.stiffness @ system.springs.rest / max(len(system.springs.rest), 1)
        self.most = max(float(np.linalg.norm(weight)), float(pull))
        self.edge = float(np.median(system.springs.rest)) if len(system.springs.rest) else 0.0
        self.bear(1.0)

    def bear(self, share: float) -> None:
        """Let the cloth have a share of its weight."""
        vertices, self.scale = self.whole.vertex, share * self.most
        self.system = self.whole._replace(vertex=vertices._replace(gravity=share * vertices.gravity))

    def is_unloaded(self) -> bool:
        """Whether nothing bears the weight: what else acts on the cloth is level, as where it is flat."""
        gravity = self.whole.vertex.gravity
        self.bear(0.0)
        return bool(np.linalg.norm(self.force(self.x) @ gravity) < UNLOADED * self.most * np.linalg.norm(gravity))

    def force(self, x: Array, h: float = ENDLESS) -> Array:
        """The forces on the free vertices (m, 3), N; A of that step is left in the workspace."""
        form = self.system._replace(h=h)
        collider_rows.begin(form.colliders, 0.0)
        implicit.assemble(form, x, self.rest, False, self.work.A, self.work.b)
        return np.asarray(self.work.b[self.free] / h)

    def energy(self, x: Array) -> float:
        """The energy of springs, colliders and weight, J."""
        return float(stored(self.system, x))

    @cached_property
    def ordered(self) -> tuple[Any, Any, Any, Any]:
        """An order (3 m,) of the unknowns in which factors are sparse, one for all A, as these have one pattern; and
        back; the places of the entries of A in that order in its arrays; and a matrix of them.
        """
        from scipy.sparse import csc_array, eye_array
        from scipy.sparse.linalg import splu

        own = sparse.places(self.work.A)  # a scene at rest has no self-contact
        regular = csc_array((np.ones(own.nnz), own.indices, own.indptr)) + own.nnz * eye_array(own.shape[0])
        back = splu(csc_array(regular), **linear.SYMMETRIC).perm_c
        order = np.argsort(back)
        own = own[order][:, order].sorted_indices()
        return order, back, own.data, own.astype(float)

    def solver(self) -> Callable[[Array], Array]:
        """A⁻¹ times forces (m, 3), by the A that is left in the workspace; NaN where it is singular."""
        from scipy.sparse.linalg import splu

        self.solves += 1
        order, back, entries, A = self.ordered
        A.data = np.concatenate([self.work.A.diagonal, self.work.A.upper]).reshape(-1)[entries]
        try:
            factors = splu(A, **linear.SYMMETRIC | IN_ORDER)
        except RuntimeError:  # exactly singular
            return lambda f: np.full_like(f, np.nan)
        return lambda f: np.asarray(factors.solve(f.reshape(-1)[order])[back].reshape(f.shape))

    def descend(self, done: float = DONE) -> bool:
        """Go to where the forces are 0, but for a part of the weights; whether they are."""
        energy, f = self.energy(self.x), self.force(self.x)
        h, tried = ENDLESS if np.linalg.norm(f) < CLOSE * self.scale else FIRST, False
        for _ in range(MOST_STEPS):
            size = float(np.linalg.norm(f))
            if not np.isfinite(size):
                return False
            if size <= done * self.scale:
                return True
            interrupts.check()
            f = self.force(self.x, h)
            solved = self.solver()
            d = h * h * solved(f)
            slope, trial = float((f * d).sum()), self.x.copy()
            trial[self.free] += d
            after = self.energy(trial) if slope > 0.0 else np.inf
            g = self.force(trial) if np.isfinite(after) else f
            noise = 1e-13 * abs(energy) + 1e-300  # rounding of the energy
            gain = (energy - after) / (0.5 * slope) if slope > 0.0 else -np.inf
            small = slope <= noise
            step = float(np.abs(d).max())
            newton = small and h == ENDLESS and after <= energy + noise
            nearer = newton and np.abs(h * h * solved(g)).max() < 0.5 * step
            if gain >= ENOUGH or nearer:
                self.x, energy, f, tried = trial, after, g, False
                h = min(h * (GROW if gain > GOOD else 1.0), ENDLESS)
            elif newton and (size <= NEAR * self.scale or step <= NEAR * self.edge):
                return True
            elif small and not tried:
                h, tried = ENDLESS, True
            else:
                h = min(h * SHRINK, FIRST)
                if h < 1e-9:  # forces are 0, but no step lowers the energy: a saddle, which is left along its mode
                    return size <= NEAR * self.scale
        return False

    def lowest(self) -> Array | None:
        """A mode (n, 3) of −K with a negative eigenvalue; None where the shape is a minimum."""
        from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh, splu

        if not len(self.free):
            return None
        self.force(self.x)
        A = sparse.to_scipy(*self.work.A)
        try:
            factors = splu(A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError:
            return None
        if (factors.U.diagonal() > 0.0).all():
            return None
        inverse = LinearOperator(A.shape, matvec=factors.solve, dtype=float)
        guess = np.random.default_rng(0).standard_normal(A.shape[0])
        try:  # the least 1 / λ: inverse iteration would find the λ nearest to 0, which may be positive
            mode = eigsh(A, 1, sigma=0.0, which="SA", OPinv=inverse, v0=guess)[1][:, 0]
        except ArpackError:
            return None
        if not mode @ (A @ mode) < 0.0:
            return None
        whole = np.zeros_like(self.x)
        whole[self.free] = mode.reshape(-1, 3)
        return whole


@kernel
def stored(system: System, x: Array) -> float:
    """The energy of springs, colliders, weight and what is applied at x (n, 3), J."""
    return float(
        total.stored_energy(system, x, x) + vertex.energy(system.vertex, x) + applied.energy(system.applied, x)
    )
