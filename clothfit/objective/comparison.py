"""How far a motion is from its target: one number, its derivative, and residuals for least squares.

    G = Σ_k Σ_g w_g C² ρ(a_k |d_kg|² / C²)

over the objectives k (`measures`) and the groups g of each, with a_k the weight of an objective, which also turns its
unit into m², w_g the weight of a group (of a vertex, at a time), and ρ, C the robust loss (`Loss`). By default the one
objective is position, without a loss: G = Σ_frames Σ_vertices |s − x*|² over the observed positions, m².

As least squares: r = sqrt(w a ρ') d and J = sqrt(w a ρ') ∂d/∂x, so that ∂G/∂x = 2 Jᵀ r, exactly.

Robust losses: how much a large residual counts, so that outliers do not decide a fit.

A group of residuals d (the gap of a vertex, say) costs C² ρ(z), z = |d|² / C². As SciPy defines them (`least_squares`),

    linear   ρ = z                          every distance counts by its square
    soft_l1  ρ = 2 (sqrt(1 + z) − 1)        … far above C by its length, with a smooth transition
    huber    ρ = z where z ≤ 1, else 2 sqrt(z) − 1      … exactly quadratic below C

The scale C, in metres, is the largest gap that is still noise. Reference: B. Triggs, P. F. McLauchlan, R. I. Hartley,
A. W. Fitzgibbon, Bundle adjustment: a modern synthesis, section 3 (2000).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import meant
from clothfit.engine.system import System
from clothfit.motion.times import interpolation
from clothfit.objective.measures import (
    Cloud,
    Coverage,
    EdgeLength,
    Maker,
    Measure,
    Outline,
    Position,
    Spectrum,
    Surface,
    Velocity,
)
from clothfit.objective.target import Target

if TYPE_CHECKING:
    from scipy.sparse import csr_array
from typing import NamedTuple

LOSSES = ("linear", "soft_l1", "huber")

LOSS_SCALE = 0.01
"""C where none is given, m: ten times the noise of a good capture, far below the size of a cloth."""

SCALES = 1e-100, 1e100
"""Range of scales, m, whose squares and quotients of squares do not overflow."""


class Loss(NamedTuple):
    """One of LOSSES with its scale."""

    name: str = "linear"
    scale: float = LOSS_SCALE  # C, m

    @property
    def is_linear(self) -> bool:
        """Whether the cost is the plain sum of squares."""
        return self.name == "linear"

    def value(self, squares: Array) -> Array:
        """C² ρ of squared norms |d|², m²."""
        if self.is_linear:
            return squares
        z = squares / self.scale**2
        if self.name == "soft_l1":
            return np.asarray(2.0 * squares / (np.sqrt(1.0 + z) + 1.0))  # the same, without the difference
        return np.asarray(np.where(z <= 1.0, squares, self.scale**2 * (2.0 * np.sqrt(z) - 1.0)))

    def derivative(self, squares: Array) -> Array:
        """ρ' at squared norms |d|², m²: the derivative of `value`, between 0 and 1."""
        if self.is_linear:
            return np.ones_like(squares)
        z = squares / self.scale**2
        return np.asarray(1.0 / np.sqrt(1.0 + z if self.name == "soft_l1" else np.maximum(z, 1.0)))


def loss_named(name: str = "linear", scale: float | None = None) -> Loss:
    """The loss of that name, C in metres (default: LOSS_SCALE). Raises InvalidInput."""
    if name not in LOSSES:
        raise InvalidInput(f"loss: there is no {name!r}; use {', '.join(LOSSES)}{meant(name, LOSSES)}")
    if scale is None:
        return Loss(name)
    if name == "linear":
        raise InvalidInput("loss scale: the linear loss has none; choose the loss soft_l1 or huber with it")
    if not 0 < scale < np.inf:
        raise InvalidInput(f"loss scale must be above 0 and finite; {scale:g} m was given")
    if not SCALES[0] <= scale <= SCALES[1]:
        raise InvalidInput(f"loss scale must be within {SCALES[0]:g} … {SCALES[1]:g} m; {scale:g} m was given")
    return Loss(name, float(scale))


MATRIX_ENTRY = 60
"""Bytes for each entry of a sparse matrix while it is made: its value and its place, in the forms they go through."""

OBJECTIVES: dict[str, Maker] = {
    "position": Position,
    "velocity": Velocity,
    "edge-length": EdgeLength,
    "spectrum": Spectrum,
    "outline": Outline,
    "coverage": Coverage,
}


OWN = "own"
"""The name among the objectives of a cost of one's own (`own_cost`), which goes alone."""

UNITS = {"velocity": "m/s", OWN: ""}
"""Units of the errors of objectives that go alone, where they are not metres."""

WHOLE = {"spectrum", OWN}
"""Objectives that compare a whole motion, so that one of fewer frames says nothing of it."""


def objective_weights(objective: str | Mapping[str, float]) -> dict[str, float]:
    """The weight of each objective, from one name or from names and weights. Raises InvalidInput."""
    weights = {objective: 1.0} if isinstance(objective, str) else {k: float(a) for k, a in dict(objective).items()}
    if not weights:
        raise InvalidInput(f"objective: none is given; use one or more of {', '.join(OBJECTIVES)}")
    for name, weight in weights.items():
        if name not in OBJECTIVES:
            raise InvalidInput(f"objective: there is no {name!r}; use {', '.join(OBJECTIVES)}{meant(name, OBJECTIVES)}")
        if not 0 < weight < np.inf:
            raise InvalidInput(f"objective: {name}: the weight must be above 0 and finite; {weight:g} was given")
    return weights


class Comparison:
    """One cloth against one target. T is the number of steps of a motion x (T + 1, n, 3)."""

    def __init__(
        self,
        goal: Target,
        system: System,
        weights: Mapping[str, float] | None = None,
        loss: Loss | None = None,
        name: str = "motion",
        surface: Surface | Cloud | None = None,
    ) -> None:
        """`weights` of the objectives (default: position alone), `name` of the motion for messages, `surface`: points
        that are compared in place of vertices.

        Raises InvalidMotion where an objective cannot use the motion.
        """
        self.goal, self.loss, self.surface = goal, loss or Loss(), surface
        self.scales = dict(weights or {"position": 1.0})
        self.measures: dict[str, Measure] = {k: OBJECTIVES[k](goal, system, name) for k in self.scales}
        if surface and "position" in self.measures:
            self.measures["position"] = surface.measure(goal)
        self.last_step = goal.last_step
        alone = list(self.scales) == ["position"] and self.loss.is_linear
        self.plain = alone and self.scales["position"] == 1.0 and not len(goal.weights)  # G: squared distances, m²
        # G is this times the squared distances of vertices
        self.distance_scale = self.scales["position"] if alone and not surface else None
        self._constant: dict[str, csr_array] = {}

    @property
    def observed(self) -> Flags:
        """Which vertices (F, n), or points (F, m), the target shows."""
        return self.surface.seen if self.surface else self.goal.observed

    def points_of(self, s: Array) -> Array:
        """The vertices (F, n, 3), or the points (F, m, 3), of states s (F, n, 3)."""
        return self.surface.points_of(s) if self.surface else s

    @property
    def seen(self) -> Flags:
        """Which vertices (n,) are compared at some time after the initial state."""
        return np.asarray(np.any([measure.seen for measure in self.measures.values()], axis=0))

    @property
    def jacobian_bytes(self) -> int:
        """Bytes of J while it is made, roughly."""
        return MATRIX_ENTRY * int(sum(3 * measure.groups * measure.reach for measure in self.measures.values()))

    @cached_property
    def total_weight(self) -> float:
        """What G is divided by for a mean: Σ a_k w_g; the number of observed positions where G is plain."""
        sums = []
        for name, measure in self.measures.items():
            counted = measure.groups if measure.weights is None else float(measure.weights.sum())
            sums.append(self.scales[name] * counted)
        return float(sum(sums))

    def cost_of(self, s: Array) -> float:
        """G of the states s (F, n, 3) at the times of the frames."""
        return float(sum(self._value(name, measure.residual(s)) for name, measure in self.measures.items()))

    def derivative_of(self, s: Array) -> Array:
        """∂G/∂s (F, n, 3) of the states s at the times of the frames."""
        by_frame = np.zeros_like(s)
        for name, measure in self.measures.items():
            d = measure.residual(s)
            by_frame += measure.pullback(s, 2.0 * self._factor(name, d)[:, None] * d)
        return by_frame

    def residual_of(self, s: Array) -> Array:
        """r (N,) of the states s (F, n, 3) at the times of the frames: all groups of all objectives, each number with
        the square root of its factor.
        """
        parts = []
        for name, measure in self.measures.items():
            d = measure.residual(s)
            parts.append((np.sqrt(self._factor(name, d))[:, None] * d).ravel())
        return np.concatenate(parts)

    def jacobian_of(self, s: Array) -> csr_array:
        """J (N, 3 n (T + 1)), T = `last_step`, of the states s (F, n, 3) at the times of the frames; columns in the
        order of x.
        """
        from scipy.sparse import csr_array, vstack

        parts = [self._scaled_jacobian(name, s) for name in self.measures]
        return parts[0] if len(parts) == 1 else csr_array(vstack(parts))

    def _squares(self, name: str, d: Array) -> Array:
        return np.asarray(self.scales[name] * (d * d).sum(axis=1))

    def _value(self, name: str, d: Array) -> float:
        """Σ_g w C² ρ of the groups d (R, c) of one objective."""
        values, weights = self.loss.value(self._squares(name, d)), self.measures[name].weights
        return float(values.sum() if weights is None else weights @ values)

    def _factor(self, name: str, d: Array) -> Array:
        """w a ρ' (R,): the factors of the squares of the groups d (R, c)."""
        factor, weights = self.scales[name] * self.loss.derivative(self._squares(name, d)), self.measures[name].weights
        return factor if weights is None else weights * factor

    def _scaled_jacobian(self, name: str, s: Array) -> csr_array:
        """The part of J that belongs to one objective, for motions of `last_step` steps."""
        from scipy.sparse import csr_array

        measure = self.measures[name]
        jacobian = self._constant.get(name)
        if jacobian is None:
            jacobian = by_state(self.goal, measure.jacobian(s))
            if measure.linear:
                self._constant[name] = jacobian
        d = measure.residual(s)
        factor = np.repeat(np.sqrt(self._factor(name, d)), d.shape[1])
        values = jacobian.data * np.repeat(factor, np.diff(jacobian.indptr))
        return csr_array((values, jacobian.indices, jacobian.indptr), shape=jacobian.shape)


def by_state(goal: Target, by_frame: csr_array) -> csr_array:
    """∂d/∂x from ∂d/∂s: each column of a frame is shared by the steps that it lies between."""
    from scipy.sparse import csr_array, eye_array, kron

    coordinates = 3 * goal.observed.shape[1]
    times = interpolation(goal.step, goal.fraction, goal.last_step + 1)
    spread = kron(times, eye_array(coordinates), format="csr")
    return csr_array(by_frame @ spread)
