"""Gauss–Newton of many parameters on a large cloth, where no matrix of the fit is ever formed.

Each iteration solves for the step from products with J and Jᵀ (`Products`), some dozens of sweeps along the motion. Two
samples of the posterior go along: the directions that they ask for are good for the step as well, and they say how many
of the n values of an effect u (`priors.prior`) the data determine, from which its width follows:

    τ² = |u|² / γ,    γ = n − tr C / τ²,    C the covariance of u in the posterior

D. J. C. MacKay, Bayesian interpolation, Neural Computation 4, 1992.

A step that is too long for its trust region is the best one of the space that its solution has spanned. It ends as
`gauss_newton` does, where another step would save little beside the noise.

Products with the derivative J (N, Q) of the residuals of a fit, which is never formed.

J z is a tangent sweep along the motion, Jᵀ w an adjoint sweep, each about as expensive as a simulation. The motion is
simulated once; its states are kept as far as memory allows.

Block conjugate gradients: S X = B for several right sides at once, where S is only known by its products.

Each round adds as many directions as there are right sides, the residuals times a preconditioner D⁻¹, and X is the best
of the whole space W that was spanned so far, in the norm of S:

    X = X₀ + W (Wᵀ S W)⁻¹ Wᵀ (B − S X₀)

All right sides share W, so that they need far fewer rounds than conjugate gradients for each of them would. W is kept,
and orthogonalised anew, since S is only symmetric to the tolerance of its products. D. P. O'Leary, The block conjugate
gradient algorithm and related methods, Linear Algebra and its Applications 29, 1980.

Samples of the posterior of many values, and the step to its mean, by products with J and the prior alone.

With e ~ N(0, 1) of the residuals, and x₀ a draw from the prior with the precision A (for σ² = 1), the solution of

    (H + σ² A) x = σ Jᵀ e + σ² A x₀,    H = JᵀJ,

has the covariance σ² (H + σ² A)⁻¹ of the posterior (G. Papandreou, A. Yuille, Gaussian sampling by local perturbations,
NIPS 2010). All of them are solved together (`BlockGradients`), from the draws x₀ on: what few rounds leave undone is
then as wide as the prior, too wide and not too narrow. Beside them goes the step (H + σ² A) d = −g.

The preconditioner is the geometric mean of the diagonals of H and of σ² A: that of H + σ² A itself would leave what the
data hardly show to the end. The diagonal of H is the mean of (Jᵀ e)².
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.derivative import adjoint
from clothfit.derivative.adjoint import TrajectoryMemory
from clothfit.engine.system import System
from clothfit.engine.tape import Tape
from clothfit.motion.divergence import Diverged
from clothfit.objective.run import Run, play
from clothfit.objective.running_cost import KeptStates
from clothfit.optimise import trust_region
from clothfit.optimise.evidence import variance
from clothfit.optimise.gauss_newton import EACH, FIRST_RADIUS, GOOD, LEFT, MOST_GAIN, NEEDED, POOR, SMALL_GAIN, SMALLEST
from clothfit.optimise.prior import Prior
from clothfit.optimise.status import Status
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.fit_vector import changes

if TYPE_CHECKING:
    from scipy.sparse import csr_array

DEPENDENT = 1e-6
"""Singular value of the new directions, of unit length, below which they say nothing new."""


class BlockGradients:
    """Solutions X (Q, K), better with each round."""

    def __init__(self, product: Callable[[Array], Array], B: Array, X: Array, SX: Array, diagonal: Array) -> None:
        """`product` gives S z (Q,); from X (Q, K) on, with its products `SX`; `diagonal` (Q,) of the preconditioner D,
        above 0.
        """
        self.product, self.first, self.X = product, X, X.copy()
        self.root = np.sqrt(diagonal)[:, None]
        self.residual = B - SX
        self.start = self.residual / self.root
        self.W, self.SW = np.zeros((len(X), 0)), np.zeros((len(X), 0))  # with D = 1, by the change of variables √D x

    @property
    def inner(self) -> Array:
        """Wᵀ S W, symmetric to the last bit."""
        inner = self.W.T @ self.SW
        return np.asarray((inner + inner.T) / 2.0)

    def within(self, b: Array, radius: float) -> tuple[Array, float]:
        """The x (Q,) of the space that makes xᵀ S x − 2 bᵀ x least with |x| at most the radius, and minus that."""
        basis = self.W / self.root
        triangle = np.linalg.qr(basis, mode="r")  # |W v| = |R v|
        back = np.linalg.inv(triangle)
        H, g = back.T @ self.inner @ back, -back.T @ (basis.T @ b)
        v = trust_region.within(trust_region.Quadratic((H + H.T) / 2.0, g), radius)
        return np.asarray(basis @ (back @ v)), -float(2.0 * g @ v + v @ H @ v)

    def round(self) -> bool:
        """One round; whether it has found new directions."""
        new = self._directions()
        if not new.shape[1]:
            return False
        products = [self.product(z / self.root[:, 0]) / self.root[:, 0] for z in new.T]
        self.W = np.concatenate([self.W, new], axis=1)
        self.SW = np.concatenate([self.SW, np.stack(products, axis=1)], axis=1)
        along = np.linalg.lstsq(self.inner, self.W.T @ self.start, rcond=None)[0]
        self.X = self.first + self.W @ along / self.root
        self.residual = (self.start - self.SW @ along) * self.root
        return True

    def _directions(self) -> Array:
        """New directions (Q, ·), orthonormal, and orthogonal to all before."""
        Z = self.residual / self.root
        size = np.linalg.norm(Z, axis=0)
        Z = Z[:, size > 0] / size[size > 0]
        for _ in range(2):
            Z = Z - self.W @ (self.W.T @ Z)
        left, values, _ = np.linalg.svd(Z, full_matrices=False)
        Z = left[:, values > DEPENDENT]
        return np.linalg.qr(Z - self.W @ (self.W.T @ Z))[0]


class Simulated(NamedTuple):
    """One run at the point of the products."""

    run: Run
    system: System
    memory: TrajectoryMemory
    by_position: csr_array  # ∂r/∂x


class Products:
    """J at coordinates y (Q,)."""

    def __init__(self, part: Trajectory, y: Array, tolerance: float) -> None:
        """The linear systems of the sweeps are solved to `tolerance`, relative. Raises Diverged."""
        self.part, self.tolerance, self.p = part, tolerance, part.parameters(y)
        self.factor = part.search.coordinates.derivative(self.p)
        self.runs, residuals, objective = list[Simulated](), list[Array](), part.objective
        for run in objective.runs:
            system, at = run.changed(self.p), KeptStates(run.comparison)
            tape = Tape(system, run.steps, objective.tolerance, objective.plan(run), run.forms)
            play(run, tape, [at.update])
            self.runs.append(Simulated(run, system, tape, run.comparison.jacobian_of(at.states)))
            residuals.append(run.comparison.residual_of(at.states))
        self.r = np.concatenate(residuals)

    def _tangents(self, z: Array) -> Iterator[tuple[Simulated, Array]]:
        """Each run, and the change of its motion (T + 1, n, 3) along z (Q,)."""
        direction = np.zeros(len(self.p))
        direction[self.part.fitted] = z
        direction *= self.factor
        for each in self.runs:
            along = changes(each.run.scene, each.run.cloth, self.p, direction)
            yield each, adjoint.tangent(each.system, each.memory, along, self.tolerance)

    def forward(self, z: Array) -> Array:
        """J z (N,)."""
        return np.concatenate([each.by_position @ change.reshape(-1) for each, change in self._tangents(z)])

    def growth(self, z: Array) -> float:
        """How much the change of a motion along z (Q,) grows at most, from a quarter of its steps to where it is
        largest.
        """
        found = 1.0
        for _, change in self._tangents(z):
            sizes = np.linalg.norm(change[1:], axis=(1, 2))
            first = float(sizes[len(sizes) // 4]) if len(sizes) else 0.0
            found = max(found, float(sizes.max()) / first) if first > 0 else found
        return found

    def back(self, w: Array) -> Array:
        """Jᵀ w (Q,)."""
        gradient, start = np.zeros(len(self.p)), 0
        for run, system, memory, B in self.runs:
            weight = (B.T @ w[start : start + B.shape[0]]).reshape(-1, *system.x0.shape)
            start += B.shape[0]
            self.part.objective.add_pullback(run, self.p, system, memory, weight, gradient, self.tolerance)
        return (gradient * self.factor)[self.part.fitted]


PULLBACKS = 8
"""Draws, at least, that the diagonal of H is the mean of."""

LEAST = 1e-12
"""Diagonal of H relative to the largest, below which a value changes nothing that is compared."""


class Sampling:
    """K samples x (Q, K), and the step d (Q,), better with each round."""

    def __init__(
        self, products: Products, prior: Prior, y: Array, sigma2: float, count: int, generator: np.random.Generator,
        ends: tuple[Flags, Flags] | None = None, wide: bool = True,
    ) -> None:  # fmt: skip
        """`products` are those at y (Q,); `sigma2` is the variance of a residual. Draws `count` samples. `ends`: which
        values are at their lower and upper bound; those that the data push against it, more than noise does, stay.
        `wide`: few rounds leave the samples too wide, else too narrow.
        """
        self.products, self.prior, self.sigma2, self.count = products, prior, sigma2, count
        self.gradient = products.back(products.r) + sigma2 * prior.times(y - prior.centre)
        draws = np.stack([prior.drawn(generator) for _ in range(count)], axis=1)
        pulls = [products.back(generator.standard_normal(len(products.r))) for _ in range(max(count, PULLBACKS))]
        self.diagonal = np.mean(np.square(pulls), axis=0)  # of H
        push = np.where(self.gradient**2 > sigma2 * self.diagonal, np.sign(self.gradient), 0.0)
        low, high = ends or (np.zeros(len(y), bool), np.zeros(len(y), bool))
        self.free: Flags = ~((low & (push > 0)) | (high & (push < 0)))  # (Q,)
        believed = sigma2 * prior.believed
        draws *= self.free[:, None]
        B = np.stack([*(np.sqrt(sigma2) * pull for pull in pulls[:count]), -self.gradient], axis=1)
        B[:, :count] += sigma2 * np.stack([prior.times(x) for x in draws.T], axis=1)
        draws *= float(wide)
        X = np.concatenate([draws, np.zeros((len(y), 1))], axis=1)
        B *= self.free[:, None]
        SX = np.stack([*(self.product(x) if wide else x for x in draws.T), np.zeros(len(y))], axis=1)
        mean = np.where(believed > 0, np.sqrt(self.diagonal * believed) + believed, self.diagonal)
        self.block = BlockGradients(self.product, B, X, SX, np.where(mean > 0, mean, max(float(mean.max()), 1.0)))

    @property
    def shown(self) -> Flags:
        """Which values (Q,) change anything that is compared."""
        return np.asarray(self.diagonal > LEAST * self.diagonal.max(initial=0.0))

    def product(self, z: Array) -> Array:
        """(H + σ² A) z (Q,)."""
        whole = self.products.back(self.products.forward(z)) + self.sigma2 * self.prior.times(z)
        return np.asarray(np.where(self.free, whole, 0.0))

    def round(self) -> float:
        """One round; how much it has changed the samples, in standard deviations of theirs, root mean square."""
        before = self.samples
        if not self.block.round():
            return 0.0
        spread = np.maximum(self.deviation, np.finfo(float).tiny)[:, None]
        return float(np.sqrt(np.mean(((self.samples - before) / spread) ** 2)))

    @property
    def samples(self) -> Array:
        """x (Q, K)."""
        return self.block.X[:, : self.count]

    @property
    def step(self) -> Array:
        """d (Q,)."""
        return self.block.X[:, self.count]

    def within(self, radius: float) -> tuple[Array, float]:
        """The step (Q,) in a trust_region, and what it saves of the cost and the penalty of the model."""
        return self.block.within(np.where(self.free, -self.gradient, 0.0), radius)

    @property
    def deviation(self) -> Array:
        """Standard deviations (Q,) of the posterior, each of K samples."""
        return np.asarray(np.sqrt(np.mean(self.samples**2, axis=1)))

    @property
    def determined(self) -> float:
        """The number of combinations of values that the data determine, γ = tr H (H + σ² A)⁻¹."""
        return float(self.free.sum() - np.mean([x @ self.prior.times(x) for x in self.samples.T]))


SAMPLES = 2
"""Samples beside each step."""

ITERATIONS, ROUGH_ITERATIONS = 40, 8
"""Steps at most, of all frames and of a part of them."""

ROUNDS, FEWEST_ROUNDS = 60, 5
"""Rounds of the solution of a step."""

FEW = 3 * ROUNDS
"""Values up to which the step is solved whole."""

SAVED, FINELY = 0.05, 0.01
"""Share of what a step saves that another round must add: at first, and near the end, where the step before saved less
than a tenth of the cost.
"""

TOLERANCE = 1e-7
"""Of the linear systems of products, relative."""

SLOW, ROUGH = 1e-4, 1e-3
"""Saving relative to the cost that ends a fit; and one of a part."""

LATE, SPAN = 0.01, 5.0
"""Saving relative to the cost in so many seconds of computing, below which a fit ends that is late and leaves more than
noise.
"""

WIDER = 2.0
"""Factor by which a width changes at most from one step to the next, and the radius."""

VECTORS = 12
"""Arrays of the size of the residuals that the method works with."""


def fits(part: Trajectory) -> bool:
    """Whether the method fits into what the objective may hold."""
    matrices = sum(run.comparison.jacobian_bytes for run in part.objective.runs)
    moves = sum((run.steps + 1) * run.system.x0.nbytes for run in part.objective.runs)
    spanned = 16 * (SAMPLES + 1) * ROUNDS * part.size
    return 8 * VECTORS * part.residuals() + matrices + 3 * moves + spanned <= part.objective.room


def minimise(part: Trajectory, y: Array, prior: Prior, whole: bool) -> tuple[Array, Prior, Status]:
    """Go down from y (Q,); returns the last point, the prior that it learned and how it ended. Raises Stop."""
    prior, radius = prior.reopened(), FIRST_RADIUS * np.sqrt(max(part.size, 1))
    generator, cost, last = np.random.default_rng(part.size), part.cost(y), np.inf
    determined = 0.5 * part.size
    tolerance = max(TOLERANCE, part.objective.tolerance)
    for _ in range(ITERATIONS if whole else ROUGH_ITERATIONS):
        sigma2, began = variance(cost, part.residuals(), determined), part.search.progress.computing
        part.believe(prior, sigma2)
        part.search.count()
        try:
            products = Products(part, y, tolerance)
        except Diverged:
            return y, prior, Status.STALLED
        lower, upper = part.bounds
        ends = y <= lower, y >= upper
        sampling = Sampling(products, prior, y, sigma2, SAMPLES, generator, ends, wide=False)
        saving = rounds(sampling, float(np.clip(0.1 * last, FINELY, SAVED)), part.search.report)
        determined = min(max(sampling.determined, 1.0), float(part.size))
        least = max(LEFT * sigma2, min(EACH * determined * sigma2, MOST_GAIN * cost), (SLOW if whole else ROUGH) * cost)
        if saving <= least or max(saving / max(cost, np.finfo(float).tiny), last) <= SMALL_GAIN:
            return y, prior, Status.CONVERGED
        last = saving / cost
        total = cost + prior.value(y, sigma2)
        while radius > SMALLEST * np.sqrt(part.size):
            step, predicted = sampling.within(radius)
            new = np.clip(y + step, lower, upper)
            found = part.cost(new)
            saved = total - found - prior.value(new, sigma2)
            if saved >= NEEDED * predicted:
                break
            radius = POOR * min(radius, float(np.linalg.norm(step)))
        else:
            return y, prior, Status.STALLED
        radius = WIDER * radius if saved > GOOD * predicted else radius / WIDER if saved < POOR * predicted else radius
        spans = (part.search.progress.computing - began) / SPAN
        slow = part.search.is_late and cost - found < LATE * spans * cost
        y, cost = new, found
        if prior.learns:
            prior = prior.rescaled(y - prior.centre, list(sampling.samples.T), 1.0 / WIDER, WIDER)
        part.search.best.go_on(prior=prior, y=y.copy())  # a resumed fit begins there
        part.search.report()
        if slow and not part.is_noise(y):
            return y, prior, Status.STALLED
    return y, prior, Status.LIMIT


def rounds(sampling: Sampling, least: float, waiting: Callable[[], None]) -> float:
    """Solve for the step until another round adds less than the share `least`; returns what it saves of the model.
    `waiting` is called after each round.
    """
    saved, size = 0.0, len(sampling.gradient)
    fewest = ROUNDS if size <= FEW else FEWEST_ROUNDS
    for number in range(ROUNDS):
        changed = sampling.round()
        waiting()
        before, saved = saved, -float(sampling.gradient @ sampling.step)
        if changed == 0.0 or (number + 1 >= fewest and saved - before <= least * saved):
            break
    return saved
