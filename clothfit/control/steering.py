"""Gauss–Newton through the simulation: from the numbers of few controls to those that bring the cloths nearest to keys.

The keys come in one after another, as a motion that has missed the first says little about the second. Each search is
SciPy's trust-region reflective method with LSMR, which takes products with J only. Keys come before effort: its weight
γ falls from round to round while that brings the cloths nearer. Hard keys are insisted on by multipliers. It begins
with no control, and with handles on the way that the keys suggest (`reference`), whichever comes nearer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.control.descent import NEAR, NEAR_HARD, Report
from clothfit.control.shooting import Shooting, Shot
from clothfit.motion.divergence import Diverged
from clothfit.optimise.status import Status

SHARES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
"""γ over the misses without control, from round to round."""

GAIN = 0.9
"""A round that leaves more than this share of the misses is the last."""

ROUGH, FINE = 12, 60
"""Evaluations of a search up to a key that is not the last, and of one over all keys."""

SLOW, SLOWEST = 3e-3, 1e-6
"""Relative reduction of the cost by a step that ends a search, and the last one."""

INSISTS = 12
"""Rounds with multipliers, at most."""


class Steering:
    """A search over the controls of a steered scene."""

    def __init__(self, problem: Shooting, report: Report) -> None:
        self.problem, self.report = problem, report
        self.best: Shot | None = None
        self.value, self.converged = np.inf, False

    def run(self, starts: Sequence[Array]) -> Status:
        """Search from the better of some starts (Q,). A deadline or an interrupt leaves the best."""
        problem = self.problem
        with interrupts.grace(np.inf):  # there is always a result
            problem.gamma = 0.0
            misses = [self.offer(z) for z in starts]
            if self.best is None:
                raise Diverged(f"{problem.scene.name}: no motion stays finite; try shorter steps", 0)
            whole = misses[0] if np.isfinite(misses[0]) else min(misses)
        try:
            return self.rounds(max(whole, 1e-300))
        except interrupts.OutOfTime:
            return Status.LIMIT
        except KeyboardInterrupt:
            return Status.INTERRUPTED
        finally:
            problem.horizon = problem.steps

    def rounds(self, whole: float) -> Status:
        """Searches over more and more keys, then with less and less weight of the effort; `whole`: m², misses at first.
        """
        problem, z = self.problem, self.found.z
        candidates = [z]
        problem.gamma = SHARES[0] * whole
        for step in sorted({key.step for key in problem.keys})[:-1]:
            problem.horizon = step
            z = self.search(z, ROUGH, SLOW)
        candidates, missed, problem.horizon = [*candidates, z], np.inf, problem.steps
        for share in SHARES:
            problem.gamma = share * whole
            self.again(candidates)
            self.search(self.found.z, FINE, SLOW)
            before, missed = missed, self.misses(self.found)
            if self.near() or missed > GAIN * before:
                break
            candidates = [self.found.z]
        return self.insisted(self.ended())

    def again(self, candidates: Sequence[Array]) -> None:
        """Compare by the cost as it is now."""
        self.value = np.inf
        for each in candidates:
            self.offer(each)

    def ended(self) -> Status:
        """A last search from the best point, and how it ended."""
        self.search(self.found.z, FINE, SLOWEST)
        return Status.CONVERGED if self.converged else Status.STALLED

    def insisted(self, status: Status) -> Status:
        """Raise the multipliers of hard keys until they are met or come no nearer."""
        problem, before = self.problem, np.inf
        hard = [i for i, key in enumerate(problem.keys) if key.hard]
        for _ in range(INSISTS if hard else 0):
            left = float(problem.missed(self.found)[hard].max())
            if left <= NEAR_HARD:
                return status
            if left > 0.95 * before:
                return Status.STALLED
            before = left
            for i in hard:
                problem.multipliers[i] = problem.multipliers[i] + problem.left(self.found, i)
            self.again([self.found.z])
            status = self.ended()
        return status

    @property
    def found(self) -> Shot:
        """The best point."""
        assert self.best is not None
        return self.best

    def near(self) -> bool:
        """Whether all keys are met."""
        return bool((self.problem.missed(self.found) <= NEAR).all())

    def misses(self, shot: Shot) -> float:
        """What the keys add to the cost, m²."""
        gamma, self.problem.gamma = self.problem.gamma, 0.0
        r = self.problem.residuals(shot)
        self.problem.gamma = gamma
        return float(r @ r)

    def offer(self, z: Array) -> float:
        """The cost at z (Q,), infinite where the motion diverges, noting the best."""
        shot = self.problem.shoot(z)
        if shot is None:
            return np.inf
        r = self.problem.residuals(shot)
        value = float(r @ r)
        if value < self.value:
            interrupts.hold()
            self.best, self.value = shot, value
        return value

    def search(self, z: Array, evaluations: int, slow: float) -> Array:
        """Gauss–Newton from z (Q,) until a step lowers the cost by less than a share `slow`; returns the last point. Over
        all keys it notes the best.
        """
        from scipy.optimize import least_squares
        from scipy.sparse.linalg import LinearOperator

        problem, last = self.problem, {}
        whole = problem.horizon == problem.steps

        def residuals(z: Array) -> Array:
            interrupts.check()
            shot = problem.shoot(z)
            if shot is None:
                return np.full(last["count"], np.inf)
            r = problem.residuals(shot)
            last.update(shot=shot, count=len(r))
            if whole and r @ r < self.value:
                interrupts.hold()
                self.best, self.value = shot, float(r @ r)
            missed = problem.missed(shot)
            self.report(0.0, float(missed.max()), problem.evaluations)
            return r

        def jacobian(z: Array, *_: Any) -> LinearOperator | Array:
            shot = last["shot"] if np.array_equal(last["shot"].z, z) else problem.shoot(z)
            if problem.is_small:
                return problem.matrix(shot)

            def push(dz: Array) -> Array:
                interrupts.check()
                return problem.push(shot, dz.reshape(-1))

            def pull(r: Array) -> Array:
                interrupts.check()
                return problem.pull(shot, r.reshape(-1))

            return LinearOperator((last["count"], problem.size), matvec=push, rmatvec=pull, dtype=float)

        solve: Any = least_squares
        found = solve(
            residuals, z, jacobian, method="trf", tr_solver="exact" if problem.is_small else "lsmr", max_nfev=evaluations, ftol=slow, xtol=1e-9, gtol=None,
        )  # fmt: skip
        self.converged = found.status > 0
        return np.asarray(found.x)
