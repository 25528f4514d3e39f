"""Which springs, faces and contacts of a cloth are evaluated in its subspace, and how often each counts.

In a step each element adds h Uᵀ F_e(w) to the momentum, F its model in the step (`engine.forces`). The sums over all
elements of a kind, at states and velocities of recorded motions, are to come out from few elements with weights of 0 or
more (`nnls`). Errors count as they change the velocity of the step: by A⁻¹, with A the mean matrix of the steps. For
fits they count by the energy of that change, by L⁻¹ with A = L Lᵀ: values are found by stiff shapes, too, which move
little. Of each state's r equations some random combinations are kept: enough to tell the weights, few enough to hold in
memory.

Few non-negative weights w with G w ≈ g: the active-set method of Lawson and Hanson, stopped early.

A column enters where it lowers the residual fastest, several at once at first; a weight that would become negative
leaves. The path is greedy, so the weights that are there when the residual is small enough are few: the cubature of
S. S. An, T. Kim, D. L. James, Optimizing cubature for efficient integration of subspace deformations, SIGGRAPH Asia
2008, and the sampling of C. Farhat et al., Int. J. Numer. Methods Eng. 98, 625, 2014.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.subspace.physics.samples import Reduced, Selection

EQUATIONS = 1600
"""Of each kind of element."""


class Sample(NamedTuple):
    """One step of a recorded motion, on the basis."""

    motion: int  # whose inputs it has
    t: int
    q: Array  # (r,), before the step
    p: Array  # (r,), the velocity before
    w: Array  # (r,), that after


class Found(NamedTuple):
    """A selection, and the relative error of each kind's sum."""

    selection: Selection
    errors: dict[str, float]


def find(runs: Sequence[Reduced], chosen: Sequence[Sample], errors: Sequence[float], seed: int) -> list[Found]:
    """The cubature for samples of motions, each with all its elements as a Reduced with its inputs, within each of some
    errors, the largest first.
    """
    whole = runs[0]
    kinds = whole.chosen.counts
    each = max(1, min(whole.r, EQUATIONS // len(chosen)))
    rng = np.random.default_rng(seed)
    mean = mean_matrix(runs, chosen)
    table = np.empty((each * len(chosen), sum(kinds.values())))
    for k, sample in enumerate(chosen):
        given = runs[sample.motion].impulses(sample.q, sample.p, sample.w, sample.t)
        mix = rng.standard_normal((each, whole.r)) / np.sqrt(each) if each < whole.r else np.eye(whole.r)
        table[k * each : (k + 1) * each] = (given @ np.linalg.solve(mean, mix.T)).T
    by_kind, there, first = [], [], 0
    for count in kinds.values():
        part = table[:, first : first + count]
        by_kind.append(weights_for(part, part.sum(axis=1), errors, len(table)))
        there.append(part.any())
        first += count
    return [
        Found(
            selection(whole.chosen, [weights for weights, _ in each]),
            {name: rest if some else 0.0 for name, (_, rest), some in zip(kinds, each, there, strict=True)},
        )
        for each in zip(*by_kind, strict=True)
    ]


def mean_matrix(runs: Sequence[Reduced], chosen: Sequence[Sample]) -> Array:
    """The mean of the matrices (r, r) of some of the steps, clamped so that it is positive definite."""
    some = chosen[:: max(1, len(chosen) // 8)]
    total = np.zeros((runs[0].r, runs[0].r))
    for sample in some:
        run = runs[sample.motion]
        total += run.matrix(run.linearised(sample.q, sample.p, sample.t, cap=1.0)[0])
    return total / len(some)


def selection(everything: Selection, weights: Sequence[Array]) -> Selection:
    """The elements whose weights are above 0."""
    parts: list[Any] = []
    for there, weight in zip(everything[::2], weights, strict=True):
        chosen = np.flatnonzero(weight > 0)
        parts += [there[chosen], weight[chosen]]
    return Selection(*parts)


SHARE = 16
"""The columns that enter at once are this part of those that are in."""

PATIENCE = 40
"""Rounds without a smaller residual after which the best weights are taken."""


def weights_for(G: Array, g: Array, errors: Sequence[float], most: int) -> list[tuple[Array, float]]:
    """Weights (N,), 0 or more, at most `most` of them above 0, with |G w − g| ≤ error |g| if that can be, for G (R, N);
    and the relative residual that is left: for each of some errors, the largest first, which lie on one way.
    """
    size = np.sqrt((G * G).sum(axis=0))
    scale = np.where(size > 0, size, np.inf)
    target, w = float(np.linalg.norm(g)), np.zeros(G.shape[1])
    best, least, since = w.copy(), 1.0, 0
    active: list[int] = []
    barred: set[int] = set()
    found: list[tuple[Array, float]] = []
    while target > 0 and len(active) < min(most, *G.shape) and least > errors[-1] and since < PATIENCE:
        interrupts.check()
        slope = (g - G[:, active] @ w[active]) @ G / scale
        slope[active] = -np.inf
        slope[list(barred)] = -np.inf
        room = min(most, *G.shape) - len(active)
        entering = [int(i) for i in np.argsort(-slope)[: min(room, 1 + len(active) // SHARE)] if slope[i] > 0]
        if not entering:
            break
        active, w, left = active_weights(G, g, [*active, *entering], w)
        barred = set(left) & set(entering)  # else they would enter again at once
        rest = float(np.linalg.norm(G[:, active] @ w[active] - g)) / target
        since = since + 1 if rest > 0.999 * least else 0
        if rest < least:
            best, least = w.copy(), rest
        while len(found) < len(errors) and least <= errors[len(found)]:
            found.append((best, least))
    return found + [(best, least)] * (len(errors) - len(found))


def active_weights(G: Array, g: Array, active: list[int], w: Array) -> tuple[list[int], Array, list[int]]:
    """The least-squares weights on the active columns, without those that it would make negative; which are left, the
    weights (N,), and which columns left.
    """
    left: list[int] = []
    w = w.copy()
    while active:
        columns = G[:, active]
        gram = columns.T @ columns
        gram[np.diag_indices(len(active))] *= 1.0 + 1e-12
        found = np.linalg.solve(gram, columns.T @ g)
        if (found > 0).all():
            w[:] = 0.0
            w[active] = found
            return active, w, left
        own = w[active]
        negative = found <= 0
        way = own[negative] / (own[negative] - found[negative])
        part = float(way.min()) if len(way) else 0.0
        moved = own + part * (found - own)
        out = [active[i] for i in np.flatnonzero(negative & (moved <= 1e-14 * max(moved.max(), 1e-300)))]
        out = out or [active[int(np.argmin(found))]]
        w[active] = np.maximum(moved, 0.0)
        w[out] = 0.0
        left += out
        active = [i for i in active if i not in set(out)]
    return active, w, left
