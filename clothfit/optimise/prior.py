"""What is believed of the parameters before the data: that a cloth is not far from one fabric, or from a few.

In the coordinates y of a fit (log parameters), the values of one kind of one cloth scatter around their start:

    y − y₀ = m 1 + Σₖ Bₖ uₖ + e,   uₖ ~ N(0, τₖ²),   e ~ N(0, τ²)

with a common factor m that is free, τ the scatter of each value by itself, and patterns Bₖ in which the values of a
fabric go together (below): a value for each family of springs, smooth maps. With B = (1, B₁, …) and
T = diag(∞, τ₁², …) the penalty is

    σ² (y − y₀)ᵀ A (y − y₀),   A = (1 − B (τ² T⁻¹ + BᵀB)⁻¹ Bᵀ) / τ²

with σ² the variance of a residual. Where the data determine more than that, it does nothing; where they are noisy or
determine nothing, it keeps values near what the others say of them. All τ are found from the data with the fit, as
those that make the data most likely (`evidence`), so a pattern that the values do not follow costs little: its τₖ
vanishes. A τ that the user gives is kept, and then there are no patterns, and the mean is held to the start as well.

Patterns in which the values of a fabric go together: what the prior of a fit takes their scatter apart into.

Springs of one family are alike, and so are those of one region; along a cloth values change smoothly, those of all
families together or of each by itself. Smooth maps are modes of the Laplacian of the mesh (`smooth_maps`), in bands of
frequencies: in two dimensions that of the j-th goes as √j, so each octave has four times as many modes as the one
before. How far the values follow a pattern is learned.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Indices
from clothfit.optimise.evidence import Seen, inverse, most_likely, variance
from clothfit.scene.block import Block
from clothfit.scene.cloth import Cloth
from clothfit.scene.families import spring_groups, vertex_groups
from clothfit.scene.smooth_maps import vertex_modes

BANDS = (1, 4, 16, 64)
"""The first mode of each band, and the end of the last one; mode 0 is constant."""

OWN_BANDS = 2
"""Bands of maps of each family by itself."""

SHARE = 4
"""Values, at least, for each mode."""


def patterns(cloth: Cloth, block: Block, chosen: NDArray[np.intp]) -> tuple[Array, ...]:
    """The patterns (n, ·) of the `chosen` (n,) values of a block of single values, each of mean square row sum 1."""
    on_springs = block.kind.of == "spring"
    groups = spring_groups(cloth) if on_springs else vertex_groups(cloth)
    modes = vertex_modes(cloth, min(BANDS[-1], max(len(chosen) // SHARE, 1)))
    if on_springs:
        modes = modes[cloth.springs].mean(axis=1)
    member = groups.of[chosen, None] == np.arange(len(groups.names))
    return tuple(scaled(B) for B in found(modes[chosen], member[:, member.any(axis=0)].astype(float)) if B.any())


def found(modes: Array, member: Array) -> Iterator[Array]:
    """Patterns from modes (n, K), and which group each value is in, (n, G)."""
    several = member.shape[1] > 1
    if several:
        yield member
    for i, (first, end) in enumerate(pairwise(BANDS)):
        band = modes[:, first:end]
        if not band.shape[1]:
            break
        yield band
        if several and i < OWN_BANDS:
            yield (member[:, :, None] * band[:, None]).reshape(len(band), -1)


def scaled(B: Array) -> Array:
    """B (n, ·) with a mean square row sum of 1."""
    return np.asarray(B / np.sqrt((B**2).sum() / len(B)))


FIRST_TAU = 0.3
"""τ before the data have been asked, in log parameters: a third more or less."""

NARROWEST, WIDEST = 1e-3, 3.0

DOUBT = 2.0
"""How much more likely the data must become by a pattern, in its logarithm for each factor e of the width: else chance
alone lets values follow one, and those that scatter each by itself would come out worse than without patterns.
"""

ROUNDS, FINAL_ROUNDS = 12, 60
"""Rounds of learning the widths from one quadratic model, on the way and at its end."""


@dataclass(frozen=True)
class Prior:
    """The belief, and how sure it is."""

    centre: Array  # y₀, (Q,)
    groups: tuple[Indices, ...]  # coordinates that scatter together
    tau: tuple[float, ...]  # for each group that of single values, then one for each of its patterns
    learns: bool = True  # τ from the data, the mean free
    narrowest: float = NARROWEST  # of what is learned of single values
    patterns: tuple[tuple[Array, ...], ...] = ()  # Bₖ (n, ·) of each group, of mean square row sum 1
    guards: bool = False  # whether it only keeps values that the data do not show where they began

    @cached_property
    def widths(self) -> tuple[tuple[float, ...], ...]:
        """The τ of each group."""
        found, first = [], 0
        for own in self.patterns:
            found.append(self.tau[first : first + 1 + len(own)])
            first += 1 + len(own)
        return tuple(found)

    @property
    def scatter(self) -> tuple[float, ...]:
        """The standard deviation of a value of each group: all that its τ add up to."""
        return tuple(float(np.sqrt(np.sum(np.square(each)))) for each in self.widths)

    def matrix(self, sigma2: float) -> Array:
        """The penalty's matrix (Q, Q): penalty = (y − y₀)ᵀ A (y − y₀)."""
        A = np.zeros((len(self.centre), len(self.centre)))
        for group, (own, *_), (B, inner) in zip(self.groups, self.widths, self._shared, strict=True):
            spread, shared = np.eye(len(group)) - (1.0 / len(group) if self.learns else 0.0), B @ inner @ B.T
            A[np.ix_(group, group)] += sigma2 / own**2 * (spread - (shared + shared.T) / 2.0)  # symmetric to the bit
        return A

    def value(self, y: Array, sigma2: float) -> float:
        """The penalty at y (Q,)."""
        total = 0.0
        for group, (own, *_), (B, inner) in zip(self.groups, self.widths, self._shared, strict=True):
            away = y[group] - self.centre[group]
            away = away - away.mean() if self.learns else away
            along = B.T @ away
            total += sigma2 / own**2 * float(away @ away - along @ inner @ along)
        return total

    @cached_property
    def _shared(self) -> tuple[tuple[Array, Array], ...]:
        """B (n, M) without 1 and without its mean, and (τ² T⁻¹ + BᵀB)⁻¹ (M, M), of each group: with m integrated out, A
        is (P − B (τ² T⁻¹ + BᵀB)⁻¹ Bᵀ) / τ², P the projection to what has no mean.
        """
        found = []
        for group, (own, *more), patterns in zip(self.groups, self.widths, self.patterns, strict=True):
            B = np.concatenate([np.zeros((len(group), 0)), *patterns], axis=1)
            B = B - B.mean(axis=0)
            ratio = np.repeat([(own / tau) ** 2 for tau in more], [each.shape[1] for each in patterns])
            found.append((B, inverse(B.T @ B + np.diag(ratio))))
        return tuple(found)

    def times(self, z: Array) -> Array:
        """A z (Q,), with A that of `matrix` for σ² = 1, which is not formed."""
        out = np.zeros(len(z))
        for group, (own, *_), (B, inner) in zip(self.groups, self.widths, self._shared, strict=True):
            away = z[group] - (z[group].mean() if self.learns else 0.0)
            out[group] = (away - B @ (inner @ (B.T @ away))) / own**2
        return out

    def drawn(self, generator: np.random.Generator) -> Array:
        """A deviation (Q,) from the centre as the belief expects it, without what is free."""
        z = np.zeros(len(self.centre))
        for group, (own, *more), patterns in zip(self.groups, self.widths, self.patterns, strict=True):
            if not np.isfinite(own):  # nothing is believed
                continue
            z[group] = own * generator.standard_normal(len(group))
            for tau, B in zip(more, patterns, strict=True):
                z[group] += tau * (B @ generator.standard_normal(B.shape[1]))
            z[group] -= z[group].mean() if self.learns else 0.0
        return z

    def rescaled(self, z: Array, scatter: Sequence[Array], least: float, most: float) -> Prior:
        """The widths that follow from a deviation z (Q,) from the centre and samples of it, as `scatter` around that:
        each τₖ² = |uₖ|² / γₖ, of the expected uₖ of z and γₖ of its values that the data determine (MacKay's rule). A
        width changes by a factor from `least` to `most`.
        """
        found, A, means = list[float](), self.times(z), [self.times(x) for x in scatter]
        for group, widths, patterns, (B, inner) in zip(
            self.groups, self.widths, self.patterns, self._shared, strict=True
        ):
            for tau, pattern in zip(widths, (None, *patterns), strict=True):
                size, seen = effect(pattern, A[group]), [effect(pattern, each[group]) for each in means]
                rest = trace(pattern, B, inner, len(group), self.learns) / widths[0] ** 2
                count = len(size) - (pattern is None and self.learns)
                left = count - tau**2 * rest + tau**2 * float(np.mean([each @ each for each in seen]))
                new = tau**2 * float(np.linalg.norm(size)) / np.sqrt(max(count - left, 1.0))
                found.append(float(np.clip(new, max(tau * least, NARROWEST), min(tau * most, WIDEST))))
        return replace(self, tau=tuple(found))

    @property
    def believed(self) -> Array:
        """The reciprocal squares (Q,) of the widths of single values; 0 of values that nothing is believed of."""
        out = np.zeros(len(self.centre))
        for group, (own, *_) in zip(self.groups, self.widths, strict=True):
            out[group] = 1.0 / own**2
        return out

    def reopened(self) -> Prior:
        """The prior with widths that are at least those before the data were asked: where few frames are fitted values
        seem to scatter less than they do, and with more of them so narrow a prior would bar the way.
        """
        return replace(self, tau=tuple(max(tau, FIRST_TAU) for tau in self.tau)) if self.learns else self

    def between(self, other: Prior) -> Prior:
        """This prior with a τ half the way, in its logarithm, to the other's: steps of full length can overshoot."""
        return replace(self, tau=tuple(float(np.sqrt(a * b)) for a, b in zip(self.tau, other.tau, strict=True)))

    def learned(
        self, H: Array, g: Array, y: Array, cost: float, count: int, rounds: int = ROUNDS
    ) -> tuple[Prior, float]:
        """The prior with the τ that the data make most likely, and σ², both for the quadratic model (H, g) of the cost
        at y with `count` residuals. They follow from the model alone: the search for them begins with wide ones.
        """
        sigma2 = variance(cost, count, len(y))
        if not (len(y) and np.isfinite(H).all() and np.isfinite(g).all()):
            return self, sigma2
        if not (self.learns and self.groups):
            return self, self._variance(H, g, y, cost, count)
        seen = Seen.of(H, g, cost, count, WIDEST)
        if seen is None:
            return self, sigma2
        others = np.setdiff1d(np.arange(len(y)), np.concatenate(self.groups))
        free = np.zeros((len(y), len(self.groups) + len(others)))  # what no scatter holds: means, and all else
        free[others, len(self.groups) :] = np.eye(len(others))
        effects, least, doubts = [], list[float](), list[float]()
        for i, (group, patterns) in enumerate(zip(self.groups, self.patterns, strict=True)):
            free[group, i] = 1.0
            effects += [seen.L[group].T, *(seen.L[group].T @ B for B in patterns)]
            least += [self.narrowest, *[NARROWEST] * len(patterns)]
            doubts += [0.0, *[DOUBT] * len(patterns)]
        shown = replace(seen, data=seen.data + seen.L.T @ (y - self.centre))
        ends, widths, along = (np.array(least), WIDEST), np.array(self.reopened().tau), seen.L.T @ free
        tau, sigma2 = most_likely(shown, effects, along, count, widths, sigma2, ends, np.array(doubts), rounds)
        return replace(self, tau=tuple(tau.tolist())), sigma2

    def learned_fully(self, H: Array, g: Array, y: Array, cost: float, count: int) -> tuple[Prior, float]:
        """The same with widths that more rounds would not change."""
        return self.learned(H, g, y, cost, count, FINAL_ROUNDS)

    def _variance(self, H: Array, g: Array, y: Array, cost: float, count: int) -> float:
        """σ² beside this prior."""
        sigma2 = variance(cost, count, len(y))
        for _ in range(1 + bool(self.groups)):
            A = self.matrix(sigma2)
            covariance = inverse(H + A)
            step = -covariance @ (g + A @ (y - self.centre))
            determined = float((H * covariance).sum())  # γ = tr(H (H + A)⁻¹)
            sigma2 = variance(cost + float(2.0 * g @ step + step @ H @ step), count, determined)
        return sigma2


def effect(pattern: Array | None, z: Array) -> Array:
    """Bᵀ z of a pattern B (n, ·), or of single values."""
    return z if pattern is None else np.asarray(pattern.T @ z)


def trace(pattern: Array | None, B: Array, inner: Array, count: int, learns: bool) -> float:
    """tr Bₖᵀ (P − B inner Bᵀ) Bₖ of a pattern Bₖ (n, ·), or of single values."""
    if pattern is None:
        return float(count - learns - np.vdot(inner, B.T @ B))
    own = pattern - pattern.mean(axis=0) * learns
    along = B.T @ own
    return float(np.vdot(own, own) - np.vdot(along, inner @ along))


def guard(centre: Array, widths: Array) -> Prior:
    """What keeps each value within such a width (Q,) or so of `centre` (Q,), unless the data show another one."""
    each = tuple(np.array([i]) for i in range(len(centre)))
    return Prior(np.array(centre), each, tuple(widths.tolist()), learns=False, patterns=((),) * len(each), guards=True)


def none(count: int) -> Prior:
    """No belief about `count` coordinates."""
    return Prior(np.zeros(count), (), ())


def first(
    centre: Array, groups: Sequence[Indices], tau: float | None, patterns: Sequence[Sequence[Array]] = ()
) -> Prior:
    """Groups of coordinates around `centre`, with a fixed τ or (None) those that are learned, of single values and of
    the `patterns` of each group.
    """
    own = patterns if patterns and tau is None else [()] * len(groups)
    kept = [(group, tuple(each)) for group, each in zip(groups, own, strict=True) if len(group) > (tau is None)]
    width = FIRST_TAU if tau is None else tau
    widths = (width,) * sum(1 + len(each) for _, each in kept)
    return Prior(np.array(centre), tuple(group for group, _ in kept), widths, tau is None,
                 patterns=tuple(each for _, each in kept))  # fmt: skip
