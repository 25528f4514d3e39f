"""Few non-negative weights w with G w ≈ g: the active-set method of Lawson and Hanson, stopped early.

A column enters where it lowers the residual fastest, several at once at first; a weight that would become negative
leaves. The path is greedy, so the weights that are there when the residual is small enough are few: the cubature of
S. S. An, T. Kim, D. L. James, Optimizing cubature for efficient integration of subspace deformations, SIGGRAPH Asia
2008, and the sampling of C. Farhat et al., Int. J. Numer. Methods Eng. 98, 625, 2014.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array

SHARE = 16
"""The columns that enter at once are this part of those that are in."""

PATIENCE = 40
"""Rounds without a smaller residual after which the best weights are taken."""


def sparse_weights(G: Array, g: Array, error: float, most: int) -> tuple[Array, float]:
    """Weights (N,), 0 or more, at most `most` of them above 0, with |G w − g| ≤ error |g| if that can be, for G (R, N);
    and the relative residual that is left.
    """
    return weights_for(G, g, [error], most)[0]


def weights_for(G: Array, g: Array, errors: Sequence[float], most: int) -> list[tuple[Array, float]]:
    """The same for each of some errors, the largest first: on the way to the smallest there are the others."""
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
        active, w, left = settled(G, g, [*active, *entering], w)
        barred = set(left) & set(entering)  # else they would enter again at once
        rest = float(np.linalg.norm(G[:, active] @ w[active] - g)) / target
        since = since + 1 if rest > 0.999 * least else 0
        if rest < least:
            best, least = w.copy(), rest
        while len(found) < len(errors) and least <= errors[len(found)]:
            found.append((best, least))
    return found + [(best, least)] * (len(errors) - len(found))


def settled(G: Array, g: Array, active: list[int], w: Array) -> tuple[list[int], Array, list[int]]:
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
