"""Steps along a target: each from the state that this shows, and how they change with the values (`AlongTarget`).

A step from where the target is to where it is next shows more than a whole motion does, which makes more and more of
any difference. What steps miss, and products with their derivatives, give the values with which they end nearest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.derivative.adjoint import Sweep
from clothfit.engine import prescribed
from clothfit.engine.system import EXPLICIT, System, mobile
from clothfit.objective.objective import Objective
from clothfit.objective.run import Run
from clothfit.optimise.balances import track
from clothfit.optimise.consensus import OUT_OF_BALANCE
from clothfit.scene.fit_vector import changes
from clothfit.scene.kinds import REST


class SingleSteps(NamedTuple):
    """How far steps end from a target if each begins in the state that this shows."""

    steps: int
    rmse: float  # m, of all of them
    largest: float  # m, of the one that ends farthest


LOOSE = 1e-3
"""Tolerance of the linear systems of products for single steps, whose errors do not grow."""


class Shown(NamedTuple):
    """A run whose steps begin in the states that its target shows."""

    run: Run
    system: System
    seen: Flags  # (T + 1, n)
    single: prescribed.Single


class AlongTarget:
    """Where the steps of p (P,) end that begin in the states of targets, and what changes of p make of that, by sweeps
    along the targets: the residuals (T + 1, n, 3), m, of each run, and products with their derivative J.

    Steps that end far out, as they take another form than the target's, are left out. As `whole` motions each step
    inherits what those before have missed: residuals of the motions from their starts, but to the first order about
    targets, not about motions that have left them.
    """

    def __init__(self, objective: Objective, p: Array, runs: Sequence[Shown], whole: bool) -> None:
        self.objective, self.p, self.runs, self.whole = objective, p, runs, whole
        self.tolerance = objective.tolerance if whole else max(LOOSE, objective.tolerance)  # of products

    @classmethod
    def of(cls, objective: Objective, p: Array, whole: bool = False) -> AlongTarget | None:
        """Those of p (P,), in the time of a simulation; None where a step fails, or where a step does not show in the
        positions after it.
        """
        if objective.scene.method in (EXPLICIT, REST):
            return None
        runs = list[Shown]()
        for run in objective.runs:
            system = run.changed(p)
            shown = track(run.comparison.goal, system)
            single = prescribed.single_steps(system, shown.x, shown.seen, objective.tolerance)
            if single is None:
                return None
            runs.append(Shown(run, system, shown.seen, single))
        return cls(objective, p, runs, whole)

    @property
    def forms(self) -> list[prescribed.Forms]:
        """Those that the steps of each run take."""
        return [prescribed.forms_of([each.single.part]) for each in self.runs]

    @property
    def steps(self) -> SingleSteps:
        """How far the single steps end from the targets."""
        sizes, counts = (np.concatenate([np.zeros(0), *each]) for each in zip(*map(sizes_of, self.runs), strict=True))
        rmse = float(np.sqrt((sizes**2 * counts).sum() / counts.sum()))
        return SingleSteps(len(sizes), rmse, float(sizes.max(initial=0.0)))

    @property
    def typical(self) -> float:
        """How far a step ends from the target in the median, m: a few take another form than the target's."""
        return float(np.median(np.concatenate([np.zeros(0), *(sizes_of(each)[0] for each in self.runs)])))

    def residuals(self) -> list[Array]:
        """The residuals."""
        return [self._swept(each, np.zeros(len(self.p)), each.single.away) for each in self.runs]

    def forward(self, z: Array) -> list[Array]:
        """J z of a change z (P,)."""
        return [self._swept(each, z, np.zeros_like(each.single.away)) for each in self.runs]

    def back(self, w: Sequence[Array]) -> Array:
        """Jᵀ w (P,)."""
        gradient = np.zeros(len(self.p))
        for (run, system, _, (part, _, _)), own in zip(self.runs, w, strict=True):
            for each in [part] if self.whole else [part.part(t, t + 1) for t in range(part.steps)]:
                self.objective.add_pullback(run, self.p, system, each, own, gradient, self.tolerance)
        return gradient

    def _swept(self, shown: Shown, z: Array, away: Array) -> Array:
        run, system, seen, (part, _, h) = shown
        sweep = Sweep(system, changes(run.scene, run.cloth, self.p, z), self.tolerance)
        change = np.zeros_like(part.x)
        for t in range(part.steps):
            for each in () if self.whole else sweep.state:
                each[:] = 0.0
            sweep.through(part.part(t, t + 1))
            sweep.state[0][:] += away[t]
            sweep.state[1][:] += away[t] / h[t]
            change[t + 1] = sweep.state[0]
        shows = seen.copy()
        shows[1:][sizes_of(shown)[0] > (np.inf if self.whole else OUT_OF_BALANCE * self.typical)] = False
        return np.asarray(np.where(shows[..., None], change, 0.0))


def sizes_of(shown: Shown) -> tuple[Array, Array]:
    """How far each step ends from the target, m, root mean square, and of how many vertices that is, at least 1, (T,)
    each.
    """
    counts = np.maximum((shown.seen[1:] & mobile(shown.system)).sum(axis=1), 1)
    return np.asarray(np.sqrt((shown.single.away**2).sum(axis=(1, 2)) / counts)), counts


ROUNDS_ALONG, SAVED = 20, 0.1
"""Products with J and Jᵀ, at most, for a change of the values, which ends where another one saves less than this share
of the squares.
"""


def nearer(along: AlongTarget, balance: Callable[[Array], Array], waiting: Callable[[], None]) -> Array:
    """The change z (P,) of values that makes the squares of r + J z least, by conjugate gradients on its normal
    equations; `balance` is their preconditioner, the solution of those of the balances. Gradients are made orthogonal
    to all before: of motions that make much of small changes J is large in a few directions, which rounding else brings
    back.
    """
    z, r, before = np.zeros(len(along.p)), along.residuals(), list[tuple[Array, Array]]()
    squares, d, last = sum(float((own * own).sum()) for own in r), z, 1.0
    for _ in range(ROUNDS_ALONG):
        g = -along.back(r)
        y = balance(g)
        for other, solved in before:
            y = y - solved * (other @ y) / (other @ solved)
        if not g @ y > 0.0:
            break
        before.append((g, y))
        d, last = y + d * (g @ y) / last, float(g @ y)
        change = along.forward(d)
        share = last / sum(float((own * own).sum()) for own in change)
        z, r = z + share * d, [own + share * more for own, more in zip(r, change, strict=True)]
        left, squares = squares, sum(float((own * own).sum()) for own in r)
        waiting()
        if squares > (1.0 - SAVED) * left:
            break
    return z
