"""Checks of derivatives: does a gradient belong to its cost, does a transpose belong to its tangent?

For a cost G(p) with gradient g and a direction d, the remainder of the first-order Taylor expansion,

    R(t) = max over ± of |G(p ± t d) − G(p) ∓ t g·d| = O(t²),

falls a hundredfold when t falls tenfold, until rounding takes over. With a wrong g, however small the fault, it falls
only tenfold once t is small enough. The lowest order on a long range of t is therefore a sharp test; the mean over a
few halvings is not. (Both signs are taken because along one the second and the third order can cancel at a large t,
which would look like a fault.) For a linear map J and its transpose, w·(J d) = (Jᵀ w)·d to rounding.

Directions are scaled so that the step t = 1 changes some parameter by its own size and none by more (a parameter
that is 0 counts as 1): steps are relative to p, whatever its units are.
Reference: P. E. Farrell, D. A. Ham, S. W. Funke, M. E. Rognes, Automated derivation of the adjoint of high-level
transient finite element programs, SIAM J. Sci. Comput. 35 (2013), section 6.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput

TAYLOR_STEPS = tuple(10.0**-k for k in range(1, 8))
"""Steps of the Taylor test, relative to p."""

FEWEST_STEPS = 3
"""With fewer steps above the rounding floor an order means nothing."""

NOISE_STEPS = (1e-9, 2e-9, 3e-9)
"""Steps so small that the remainder is the rounding of the cost: a right gradient leaves nothing else, and a wrong one
too little to lift the floor above the steps."""

ABOVE_NOISE = 20.0
"""A remainder this many times above the rounding is known to a few percent, its order to 0.03."""

ORDER, DIFFERENCE, PRODUCT = 1.9, 1e-6, 1e-12
"""A right derivative is above the first and below the others."""

Cost = Callable[[Array], float]
Linear = Callable[[Array], Array]


class Differentiable(Protocol):
    """What `check` needs to know of a cost; `clothfit.objective.objective.Objective` has it."""

    def cost(self, p: Array) -> float:
        """G(p), m²."""

    def cost_and_gradient(self, p: Array) -> tuple[float, Array]:
        """G(p), m², and ∂G/∂p (P,)."""

    def tangent(self, p: Array, direction: Array) -> list[Array]:
        """Change of the positions (T + 1, n, 3), m, of each simulated cloth along `direction` (P,)."""

    def pullback(self, p: Array, by_position: Sequence[Array]) -> Array:
        """The transpose of `tangent`: Jᵀ w (P,) for one weight (T + 1, n, 3) per simulated cloth."""


class Report(NamedTuple):
    """The outcome of the three checks."""

    order: float  # lowest order of the Taylor remainder, 2 for a right gradient
    difference: float  # relative error against a central difference
    product: float  # relative error of the dot-product test

    @property
    def passed(self) -> bool:
        """Whether all three are as a right derivative has them: above 1.9, below 1e-6, below 1e-12."""
        return self.order > ORDER and self.difference < DIFFERENCE and self.product < PRODUCT


def taylor_order(cost: Cost, gradient: Array, p: Array, direction: Array) -> float:
    """The lowest order at which the Taylor remainder falls along the steps; above 1.9 the gradient is right.

    `gradient` (P,) is that of `cost` at p (P,), `direction` (P,) of any length. Raises InvalidInput when fewer than 3
    steps stand above the rounding of the cost, or when a cost is not finite; errors of the cost pass through.
    """
    d = scaled(p, direction)
    start, rate = _finite(cost(p)), float(np.dot(gradient, d))

    def remainder(t: float) -> float:
        return max(abs(_finite(cost(p + s * d)) - start - s * rate) for s in (t, -t))

    noise = max(np.finfo(float).eps * abs(start), *(remainder(t) for t in NOISE_STEPS))
    steps = [(t, r) for t, r in ((t, remainder(t)) for t in TAYLOR_STEPS) if r > ABOVE_NOISE * noise]
    if len(steps) < FEWEST_STEPS:
        raise InvalidInput(
            f"derivative check: only {len(steps)} of {len(TAYLOR_STEPS)} steps stand above rounding, "
            f"{FEWEST_STEPS} are needed; try another direction, or a point where the cost curves more"
        )
    return min(float(np.log(r / s) / np.log(t / u)) for (t, r), (u, s) in pairwise(steps))


def central_difference_error(cost: Cost, gradient: Array, p: Array, direction: Array, step: float = 1e-6) -> float:
    """The relative difference between `gradient`·`direction` and a central difference of `cost` along the direction.

    All arrays are (P,); `step` is relative to p. Raises InvalidInput when a cost is not finite.
    """
    d = scaled(p, direction)
    measured = (_finite(cost(p + step * d)) - _finite(cost(p - step * d))) / (2 * step)
    return _relative(measured, float(np.dot(gradient, d)))


def dot_product_error(tangent: Linear, transpose: Linear, direction: Array, weight: Array) -> float:
    """The relative difference between w·(J d) and (Jᵀ w)·d.

    `tangent` maps `direction` d to J d, of the shape of `weight` w; `transpose` maps w to Jᵀ w, of the shape of d.
    """
    forward = float(np.vdot(weight, tangent(direction)))
    return _relative(forward, float(np.vdot(transpose(weight), direction)))


def check(objective: Differentiable, p: Array, seed: int = 0) -> Report:
    """Run the three checks on an `Objective` at p (P,), with a direction and a weight drawn with `seed`.

    The direction takes the signs of the gradient, so that the terms of their product do not cancel. Raises
    InvalidInput as `taylor_order` does; errors of the objective, such as Diverged, pass through.
    """
    p = np.asarray(p, float)
    rng = np.random.default_rng(seed)
    gradient = objective.cost_and_gradient(p)[1]
    direction = direction_of(p, gradient, rng)
    shapes = [change.shape for change in objective.tangent(p, direction)]
    cuts = np.cumsum([0] + [int(np.prod(shape)) for shape in shapes])
    weight = rng.normal(size=int(cuts[-1]))

    def tangent(d: Array) -> Array:
        """J d, one cloth after the other."""
        return np.concatenate([change.reshape(-1) for change in objective.tangent(p, d)])

    def transpose(w: Array) -> Array:
        """Jᵀ w."""
        parts = zip(shapes, cuts, cuts[1:], strict=False)
        return objective.pullback(p, [w[a:b].reshape(shape) for shape, a, b in parts])

    return Report(
        taylor_order(objective.cost, gradient, p, direction),
        central_difference_error(objective.cost, gradient, p, direction),
        dot_product_error(tangent, transpose, direction, weight),
    )


def direction_of(p: Array, gradient: Array, rng: np.random.Generator) -> Array:
    """A random direction (P,) relative to p, scaled, with the signs of the gradient where that is not 0."""
    random = np.where(p == 0.0, 1.0, p) * rng.normal(size=p.shape)
    return scaled(p, np.where(gradient == 0.0, random, np.copysign(random, gradient)))


def scaled(p: Array, direction: Array) -> Array:
    """The direction (P,) at the length that changes some parameter of p (P,) by its own size and none by more.

    Raises InvalidInput when the direction is zero or not finite, or does not fit p.
    """
    d = np.asarray(direction, float)
    if d.shape != np.shape(p):
        raise InvalidInput(f"derivative check: direction of shape {d.shape} given, p has {np.shape(p)}")
    largest = np.max(np.abs(d) / np.where(p == 0.0, 1.0, np.abs(p)), initial=0.0)
    if not 0.0 < largest < np.inf:
        raise InvalidInput("derivative check: the direction is zero or not finite")
    return np.asarray(d / largest)


def _finite(value: float) -> float:
    if not np.isfinite(value):
        raise InvalidInput(f"derivative check: the cost is {value} near p; a finite one is needed")
    return float(value)


def _relative(a: float, b: float) -> float:
    return abs(a - b) / max(abs(a), abs(b), float(np.finfo(float).tiny))
