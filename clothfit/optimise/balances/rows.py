"""The rows of the balances as linear equations C q = r in Q parameters, weighted by one over each vertex' mass.

C is never formed: the entries of a row are those of its vertex' mass and springs, the same ones in every step, and what
the parameters make of these is one sparse matrix. The normal matrix CᵀC couples masses and stiffnesses that share a
vertex, so it is as sparse as the cloth.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.system import System
from clothfit.kernels.kernel import kernel
from clothfit.optimise.balances.balances import Balances, Places

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class Pattern(NamedTuple):
    """Which masses and springs, M elements in all, the rows of each of n vertices have: its mass, and E springs."""

    start: Indices  # (n + 1,): vertex i has the springs from start[i] to start[i + 1] − 1
    spring: Indices  # (E,)
    side: Indices  # (E,), which end the vertex is
    first: Indices  # (n + 1,): the pairs of elements of vertex i in `place`
    place: Indices  # (Σ k²,), of the pairs of k elements: where they are in the entries of the normal matrix
    pointers: Indices  # (M + 1,), of the normal matrix, row by row
    columns: Indices  # (its entries,)


def pattern(system: System) -> Pattern:
    """The pattern of a cloth."""
    n, ends = len(system.x0), system.springs.ends
    vertex = ends.T.ravel()
    order = np.argsort(vertex, kind="stable")
    spring, side = np.tile(np.arange(len(ends)), 2)[order], np.repeat([0, 1], len(ends))[order]
    start = np.searchsorted(vertex[order], np.arange(n + 1))
    size = np.diff(start) + 1
    own = np.insert(n + spring, start[:-1], np.arange(n))  # the elements of each vertex, its mass first
    begin = np.append(0, np.cumsum(size))
    first = np.append(0, np.cumsum(size**2))
    count = n + len(ends)
    of = np.repeat(np.arange(n), size**2)
    at = np.arange(first[-1]) - first[of]
    keys = own[begin[of] + at // size[of]].astype(np.int64) * count + own[begin[of] + at % size[of]]
    distinct, place = np.unique(keys, return_inverse=True)
    pointers = np.searchsorted(distinct, np.arange(count + 1, dtype=np.int64) * count)
    found = (start, spring, side, first, place.reshape(-1), pointers, distinct % count)
    return Pattern(*(np.ascontiguousarray(each, dtype=np.int32) for each in found))


class Rows:
    """The rows of one run, T steps of them."""

    def __init__(
        self, found: Balances, system: System, spread: csr_array, shared: Pattern | None = None
    ) -> None:
        """`spread` (M, Q): the derivative of masses and stiffnesses by the parameters; `shared`: the cloth's pattern,
        where it is known.
        """
        self.found, self.system, self.spread = found, system, spread
        self.pattern = pattern(system) if shared is None else shared
        self.weight = 1.0 / system.vertex.mass
        self.base = np.concatenate([system.vertex.mass, system.springs.stiffness])

    @property
    def counts(self) -> Array:
        """The number of rows of each step (T,)."""
        return np.asarray(3 * self.found.valid.sum(axis=1))

    def replace(self, steps: Places, other: Balances) -> None:
        """Take the balances of some steps from others."""
        for mine, theirs in zip(self.found, other, strict=True):
            mine[steps] = theirs

    def sizes(self, q: Array) -> tuple[Array, Array]:
        """The root of the squares of each step's residuals r − C q at q (Q,), and of Σ_j |C_ij p_j| over all masses and
        stiffnesses p there, what residuals are small beside, (T,) each.
        """
        found, squares, terms = self.found, *(np.zeros(len(self.found.valid)) for _ in range(2))
        change = self.spread @ q
        measure(self.pattern, *found, self.weight, change, self.base + change, squares, terms)
        return np.sqrt(squares), np.sqrt(terms)

    def gram(self, kept: Flags) -> csr_array:
        """CᵀC (Q, Q) of the steps (T,) that are kept."""
        from scipy.sparse import csr_array

        made, M = np.zeros(len(self.pattern.columns)), self.spread.shape[0]
        for t in np.flatnonzero(kept):
            _, mass, stiffness, valid = (each[t] for each in self.found)
            add_squares(self.pattern, mass, stiffness, valid, self.weight, made)
            interrupts.check()
        whole = csr_array((made, self.pattern.columns, self.pattern.pointers), shape=(M, M))
        return csr_array(self.spread.T @ whole @ self.spread)

    def right(self, q: Array, kept: Flags) -> Array:
        """Cᵀ(r − C q) (Q,) of the steps (T,) that are kept."""
        found, out = self.found, np.zeros(self.spread.shape[0])
        add_right(self.pattern, *found[:3], found.valid & kept[:, None], self.weight, self.spread @ q, out)
        return np.asarray(self.spread.T @ out)


ANCHOR = 1e6
"""Weight of a mass that is held, relative to the largest of CᵀC."""


class Equations:
    """The rows of several runs by the same Q parameters; their steps one after the other, S in all."""

    def __init__(self, parts: Sequence[Rows], anchored: bool = False) -> None:
        """`anchored`: the mass of the whole cloth is held."""
        self.parts, self.anchor = parts, np.zeros(0)
        self.counts = np.concatenate([part.counts for part in parts])
        self.Q = parts[0].spread.shape[1]
        if anchored:
            n = len(parts[0].weight)
            whole = parts[0].spread[:n].sum(axis=0)
            largest = self.gram(self.counts > 0).diagonal().max(initial=0.0)
            self.anchor = whole * np.sqrt(ANCHOR * largest / max(whole @ whole, np.finfo(float).tiny))

    def of_parts(self, kept: Flags) -> list[Flags]:
        """Flags of all steps (S,), by parts."""
        return np.split(kept, np.cumsum([len(part.counts) for part in self.parts])[:-1])

    def sizes(self, q: Array) -> tuple[Array, Array]:
        """As `Rows.sizes`, (S,)."""
        found = [part.sizes(q) for part in self.parts]
        return np.concatenate([size for size, _ in found]), np.concatenate([terms for _, terms in found])

    def gram(self, kept: Flags) -> csr_array:
        """CᵀC (Q, Q) of the steps (S,) that are kept."""
        from scipy.sparse import csr_array

        first, *others = (part.gram(own) for part, own in zip(self.parts, self.of_parts(kept), strict=True))
        whole = sum(others, start=first)
        if not len(self.anchor):
            return whole
        column = csr_array(self.anchor[:, None])
        return whole + column @ column.T

    def right(self, q: Array, kept: Flags) -> Array:
        """Cᵀ(r − C q) (Q,) of the steps (S,) that are kept."""
        found = zip(self.parts, self.of_parts(kept), strict=True)
        right = np.asarray(sum((part.right(q, own) for part, own in found), start=np.zeros(self.Q)))
        return right - self.anchor * (self.anchor @ q) if len(self.anchor) else right


@kernel
def entries(pattern, i, mass, stiffness, factor, out):
    """Write the entries (k, 3) of the rows of vertex i in a step, times a factor; returns k."""
    for c in range(3):
        out[0, c] = factor * mass[i, c]
    count = 1
    for j in range(pattern.start[i], pattern.start[i + 1]):
        for c in range(3):
            out[count, c] = factor * stiffness[pattern.spring[j], pattern.side[j], c]
        count += 1
    return count


@kernel
def most(pattern):
    """The most elements that a vertex has."""
    found = 0
    for i in range(len(pattern.start) - 1):
        found = max(found, pattern.start[i + 1] - pattern.start[i] + 1)
    return found


@kernel
def element(pattern, i, k):
    """The k-th element of vertex i."""
    return i if k == 0 else len(pattern.start) - 1 + pattern.spring[pattern.start[i] + k - 1]


@kernel
def left(pattern, i, own, count, c, known, q):
    """What of a known number a row of vertex i, component c of its k = `count` entries `own`, leaves for q (M,)."""
    for k in range(count):
        known -= own[k, c] * q[element(pattern, i, k)]
    return known


@kernel(nogil=True)
def add_squares(pattern, mass, stiffness, kept, weight, out):
    """Add CᵀC of a step's kept rows (n,) to the entries of the normal matrix."""
    own = np.zeros((most(pattern), 3))
    for i in range(len(kept)):
        if not kept[i]:
            continue
        count, at = entries(pattern, i, mass, stiffness, weight[i], own), pattern.first[i]
        for a in range(count):
            for b in range(count):
                out[pattern.place[at]] += own[a, 0] * own[b, 0] + own[a, 1] * own[b, 1] + own[a, 2] * own[b, 2]
                at += 1


@kernel(nogil=True)
def measure(pattern, residual, mass, stiffness, kept, weight, q, p, squares, terms):
    """Add the squares of the kept residuals r − C q (T, n) for q (M,) to those of each step, and those of Σ |C p|."""
    own = np.zeros((most(pattern), 3))
    for t in range(len(kept)):
        for i in range(len(weight)):
            if not kept[t, i]:
                continue
            count = entries(pattern, i, mass[t], stiffness[t], weight[i], own)
            for c in range(3):
                away, size = left(pattern, i, own, count, c, weight[i] * residual[t, i, c], q), 0.0
                for k in range(count):
                    size += abs(own[k, c] * p[element(pattern, i, k)])
                squares[t] += away * away
                terms[t] += size * size


@kernel(nogil=True)
def add_right(pattern, residual, mass, stiffness, kept, weight, q, out):
    """Add Cᵀ(r − C q) of the kept rows (T, n) for q (M,) to `out` (M,)."""
    own = np.zeros((most(pattern), 3))
    for t in range(len(kept)):
        for i in range(len(weight)):
            if not kept[t, i]:
                continue
            count = entries(pattern, i, mass[t], stiffness[t], weight[i], own)
            for c in range(3):
                away = left(pattern, i, own, count, c, weight[i] * residual[t, i, c], q)
                for k in range(count):
                    out[element(pattern, i, k)] += own[k, c] * away
