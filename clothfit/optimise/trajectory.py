"""The trajectory fit: the cost of whole motions as the problem that Gauss–Newton solves.

Few parameters or small cloths: the sensitivity of each motion to all of them, dense, summed into the normal equations
(`accumulate`). Many parameters on large cloths: the Jacobian is never formed (`matrix_free`); its products with vectors
are tangent and adjoint sweeps along the motion.

The normal equations of a fit: H = JᵀJ and g = Jᵀr of the residuals r and their derivative J by Q coordinates.

J (N, Q) is the derivative of the residuals by the positions, sparse, times the sensitivity of the motion, dense. It
is never whole in memory: a few steps at a time, each row is added to H and g as soon as its last step has passed, in
a thread beside the sweep.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.derivative.sensitivity import at_start, columns, sensitivities
from clothfit.engine.system import mobile
from clothfit.kernels.parallel import together
from clothfit.motion.divergence import Diverged
from clothfit.objective.objective import Objective
from clothfit.objective.run import Run, residual_count
from clothfit.objective.running_cost import Residuals, running_cost
from clothfit.objective.whiteness import residual_test
from clothfit.optimise import gauss_newton
from clothfit.optimise.prior import Prior, first, guard, patterns
from clothfit.optimise.search import Search
from clothfit.scene.kinds import REST

CHUNK = 3_000_000
"""Numbers of the sensitivity that are kept at a time."""


def chunk_steps(wide: int) -> int:
    """Steps of the sensitivity that are kept at a time, of so many numbers each."""
    return max(1, CHUNK // max(wide, 1))


class Scores:
    """What each step of a motion adds to H and g, and how strongly it depends on the coordinates."""

    def __init__(self, by_step: bool) -> None:
        """`by_step`: H and g are kept, of each step that completes residuals."""
        self.by_step = by_step
        self.information: list[Array] = []  # JᵀJ (Q, Q) of the residuals that a step completes
        self.parts: list[Array] = []  # Jᵀr (Q,) of the same
        self.sizes: list[float] = []  # norm of dX after each step

    def add(self, J: Array, r: Array, dX: Array) -> None:
        """Take the residuals r (R,) that the next steps complete, their J (R, Q), and the sensitivities
        (steps, 3 f, Q) after these steps.
        """
        if self.by_step and len(r):
            self.information.append(J.T @ J)
            self.parts.append(J.T @ r)
        self.sizes += [float(np.linalg.norm(each)) for each in dX]


class Kept:
    """The scores of all runs of a model."""

    def __init__(self, by_step: bool = True) -> None:
        """`by_step`: as of `Scores`."""
        self.by_step = by_step
        self.runs: list[tuple[Indices, Scores]] = []

    def keep(self, own: Indices) -> Scores:
        """What takes the scores of the next run, which depends on the coordinates `own`."""
        self.runs.append((own, Scores(self.by_step)))
        return self.runs[-1][1]

    @property
    def growth(self) -> float:
        """How much the sensitivity of a run grows at most, from a quarter of its steps to where it is largest."""
        sizes = [np.array(scores.sizes) for _, scores in self.runs]
        early = [(float(each[len(each) // 4]), float(each.max())) for each in sizes if len(each)]
        return max((largest / first for first, largest in early if first > 0), default=1.0)

    def blocks(self, run: int, count: int, size: int) -> tuple[Array, Array]:
        """What each of so many blocks of the frames of a run adds to H and g (B, Q, …) of Q = `size` coordinates."""
        own, scores = self.runs[run]
        H, g = np.zeros((count, size, size)), np.zeros((count, size))
        for b, part in enumerate(np.array_split(np.arange(len(scores.parts)), count) if count else ()):
            H[b][np.ix_(own, own)] = sum(scores.information[t] for t in part)
            g[b][own] = sum(scores.parts[t] for t in part)
        return H, g


def accumulate(
    residuals: Residuals, steps: Iterator[Array], before: Array, scores: Scores | None = None
) -> tuple[Array, Array]:
    """H (Q, Q) and g (Q,) from the residuals and the sensitivities (3 f, Q) `before` the first and after each of their
    T steps. `scores` takes what each step adds.
    """
    rows, count = before.shape
    length = 1 if scores is not None and scores.by_step else chunk_steps(rows * count)
    H, g = np.zeros((count, count)), np.zeros(count)

    def add(sensitivity: Array, first: int, end: int) -> None:
        J, r = residuals.rows(sensitivity, first, end)
        H[:] += J.T @ J  # of one array, so that only half of the products are computed
        g[:] += J.T @ r
        if scores is not None:
            scores.add(J, r, sensitivity.reshape(-1, rows, count)[1:])

    with ThreadPoolExecutor(1) as pool:
        adding: Future[None] | None = None
        for first in range(0, residuals.steps, length):
            end = min(first + length, residuals.steps)
            chunk = np.empty((end - first + 1, rows, count))
            chunk[0] = before
            for t in range(1, len(chunk)):
                chunk[t] = next(steps)
            before = chunk[-1].copy()
            if adding is not None:
                adding.result()
            adding = pool.submit(add, chunk.reshape(-1, count), first, end)
        if adding is not None:
            adding.result()
    return H, g


LARGEST = 3e12
"""Operations of one dense model, about a minute, above which the matrix-free method takes over."""

MATRICES, CHUNKS = 8, 3
"""Arrays (Q, Q), and parts of the sensitivity (`chunk_steps`), that a step of Gauss–Newton works with."""

AIR = ("wind", "gusts")
"""Kinds of which only the product with the drag pushes a cloth."""

FABRIC = ("mass", "stiffness", "rest")
"""Kinds whose values scatter around a fabric's."""

PATTERNED = 1200
"""Values of one cloth, at most, whose patterns are asked for where there is a dense model: the widths of more take
longer to learn than a model to compute. Those of cloths that do not touch are learned apart.
"""

MOSTLY = 0.5
"""Share of the squares that must be no noise for the width of the prior to be held."""


class Trajectory:
    """An objective in the coordinates y (Q,) of the parameters that a search fits."""

    def __init__(self, search: Search, objective: Objective, tolerance: float | None = None) -> None:
        """`objective` is that of the search, or the same over fewer frames; the linear systems of the sensitivity are
        solved to its tolerance, or to another one.
        """
        self.search, self.objective, self.fitted = search, objective, search.fitted
        self.tolerance = tolerance or objective.tolerance
        self.column = np.where(self.fitted, np.cumsum(self.fitted) - 1, -1)  # (P,): the coordinate that moves each

    @property
    def size(self) -> int:
        """Q."""
        return int(self.column.max(initial=-1)) + 1

    def y(self, p: Array) -> Array:
        """Coordinates (Q,) of parameters (P,)."""
        return self.search.coordinates.y(p)[self.fitted]

    def parameters(self, y: Array) -> Array:
        """Parameters (P,) at coordinates y (Q,)."""
        return self.search.parameters(y)

    def derivative(self, p: Array) -> Array:
        """∂p/∂y (P,) at p (P,), of each parameter by its own coordinate."""
        return self.search.coordinates.derivative(p)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Ends (Q,) of the coordinates."""
        ends = self.search.coordinates
        return ends.lower[self.fitted], ends.upper[self.fitted]

    def believe(self, prior: Prior, sigma2: float) -> None:
        """Compare the points of the search by cost and penalty, with the variance of a residual, m² where positions are
        compared.
        """
        if self.objective is self.search.objective:
            self.search.best.believe(prior, lambda p: prior.value(self.y(p), sigma2))

    def is_noise(self, y: Array) -> bool:
        """Whether most of what is left at y may be noise, not the error of a model or of values that are still far off.
        """
        try:
            test = residual_test(self.objective, self.parameters(y))
        except Diverged:
            return False
        return test is None or test.structured < MOSTLY

    def accepted(self, prior: Prior, model: gauss_newton.Model, radius: float) -> None:
        """Go on from the point of a model, and report it."""
        self.search.best.go_on(prior=prior, y=model.y, radius=radius)
        self.search.advance(self.parameters(model.y))
        self.search.report()

    def passed(self, prior: Prior, model: gauss_newton.Model, radius: float) -> None:
        """Report an iteration on fewer frames."""
        self.search.advance(self.parameters(model.y), self.objective.rmse(model.cost))
        self.search.report()

    def problem(
        self, least: float = 0.0, patience: gauss_newton.Patience = gauss_newton.PATIENT
    ) -> gauss_newton.Problem:
        """What Gauss–Newton minimises, until a step would save less than the fraction `least` of the cost."""
        return gauss_newton.Problem(
            self.model, self.cost, *self.bounds, self.residuals(), least, patience, self.believe, self.is_noise,
            self.search.report,
        )  # fmt: skip

    @property
    def widths(self) -> Array | None:
        """Those of the coordinates where the wind is fitted: what counts as one of it is not known before the drag is.
        Else None.
        """
        windy = any(block.name in AIR and self.fitted[block.part].any() for block in self.objective.blocks)
        return self.own_widths if windy else None

    @property
    def own_widths(self) -> Array:
        """Changes (Q,) of the coordinates by a factor e, or by σ where they are linear."""
        return np.asarray(self.search.coordinates.weight[self.fitted])

    def cost(self, y: Array) -> float:
        """The cost at y, which becomes the best point where it is, as only all frames can say; infinite where the
        simulation diverges. Raises Stop as a visit of the search does.
        """
        p = self.parameters(y)
        cost = self.search.measure(p, self.objective)
        if self.objective is self.search.objective:
            self.search.accept(p, cost)
        return cost

    def residuals(self) -> int:
        """Number of residuals that a parameter can change."""
        return sum(residual_count(run) for run in self.objective.runs)

    def model(self, y: Array, keep: Callable[[Indices], Scores] | None = None) -> gauss_newton.Model:
        """The cost near y: its residuals, linear in the coordinates. `keep` gives what takes the scores of a run, from
        the coordinates that it depends on. Raises Diverged.
        """
        self.search.count()
        p = self.parameters(y)
        factor = self.derivative(p)
        H, g, cost = np.zeros((self.size, self.size)), np.zeros(self.size), 0.0
        parts, places = list[Callable[[], tuple[Array, Array, float]]](), list[Indices]()
        for run in self.objective.runs:
            acting = np.where(self.acts(run), self.column, -1)
            own, place = np.unique(acting[acting >= 0], return_inverse=True)
            local = np.full(len(p), -1, np.int32)
            local[acting >= 0] = place
            scores = keep(own) if keep and len(own) else None
            parts.append(partial(run_model, run, self.objective, p, local, factor, self.tolerance, scores))
            places.append(own)
        for own, (part, derivative, value) in zip(places, together(parts), strict=True):
            H[np.ix_(own, own)] += part
            g[own] += derivative
            cost += value
        return gauss_newton.Model(y, cost, H, g)

    def acts(self, run: Run) -> Flags:
        """Which parameters (P,) act in a run."""
        acts = np.zeros(len(self.fitted), bool)
        for block, _ in run.acting:
            acts[block.part] = True
        return acts

    def operations(self) -> float:
        """Operations of one dense model, roughly."""
        total = 0.0
        for run in self.objective.runs:
            rows, count = 3.0 * mobile(run.system).sum(), float((self.acts(run) & self.fitted).sum())
            solve = rows * min(rows, 40.0 * np.sqrt(rows)) * count
            total += run.steps * (2.0 * solve + rows * count**2)
        return total

    def fits(self) -> bool:
        """Whether the dense model fits into what the objective may hold."""
        needed = 8 * MATRICES * self.size**2
        for run in self.objective.runs:
            wide = 3 * int(mobile(run.system).sum()) * int((self.acts(run) & self.fitted).sum())
            steps = 1 + min(chunk_steps(wide), run.steps)
            needed += 8 * CHUNKS * steps * wide + running_cost(run.comparison).residual_bytes
        return needed <= self.objective.room

    def largest(self) -> int:
        """The most values that act in one run."""
        return max((int((self.acts(run) & self.fitted).sum()) for run in self.objective.runs), default=0)

    def prior(self, centre: Array, tau: float | None) -> Prior:
        """The belief that values scatter around the coordinates `centre` (Q,), by τ, which is learned where None, and
        then along the patterns of a fabric as well. Values of cloths at rest that nothing else is believed of are kept
        within a factor e or so, unless the shapes show another one: some hardly change these.
        """
        place, cloths = np.cumsum(self.fitted) - 1, self.objective.scene.cloths
        groups, shared = [], list[tuple[Array, ...]]()
        patterned = tau is None and (self.largest() <= PATTERNED or self.operations() > LARGEST)
        for block in self.objective.blocks:
            own = np.flatnonzero(self.fitted[block.part])
            if ((block.mode == "L" and block.name in FABRIC) or tau is not None) and len(own):
                groups.append(place[own + block.start])
                of = block.cloth if patterned else None
                shared.append(() if of is None else patterns(cloths[of], block, own))
        if tau is None and not groups and self.objective.scene.method == REST:
            return guard(centre, self.own_widths)
        return first(centre, groups, tau, shared)


def run_model(
    run: Run, objective: Objective, p: Array, column: Indices, factor: Array, tolerance: float,
    scores: Scores | None = None,
) -> tuple[Array, Array, float]:  # fmt: skip
    """H, g and the cost of one run at p (P,), by the columns of `column` (P,), with derivatives multiplied by `factor`
    (P,), their linear systems solved to `tolerance`; `scores` takes what each step adds. Raises Diverged.
    """
    cost = running_cost(run.comparison)
    system, tape = objective.simulate(run, p, cost.update, plan=objective.plan(run))
    count = int(column.max(initial=-1)) + 1
    if not count:
        return np.zeros((0, 0)), np.zeros(0), cost.value
    wanted = columns(system, run.acting, p, column, factor, count)
    residuals = cost.residuals(mobile(system))
    steps = sensitivities(system, tape, wanted, tolerance, residuals.update)
    H, g = accumulate(residuals, steps, at_start(system, wanted), scores)
    return H, g, cost.value
