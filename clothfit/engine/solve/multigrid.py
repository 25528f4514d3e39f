"""Multigrid, the preconditioner of cloths of so many vertices that SSOR takes too many iterations.

A sweep of Gauss–Seidel carries news from vertex to vertex, so the finer a cloth, the more sweeps; sums over groups of
vertices carry it far at once. With P from a coarser level to a finer one (`coarsening`), A_c = Pᵀ A P, one cycle

    z = (D + Lᵀ)⁻¹ r,    z += P A_c⁻¹ Pᵀ (r − A z),    z += (D + L)⁻¹ (r − A z)

is symmetric and positive definite; A_c⁻¹ is again such a cycle, and on the last level some sweeps of Gauss–Seidel,
which suffice there because the mass outweighs the springs ever more. For that A itself need not be positive definite,
only its diagonal blocks: what a sweep leaves of S⁻¹ A, S = A + L D⁻¹ Lᵀ, has no eigenvalue above 1.

All of it is kept and computed in single precision: rounding a preconditioner changes no solution. A right-hand side is
scaled to length 1 first, lest it vanish. Levels are in the order of sweep: row k is vertex k.

The rows of the finest level are in subdomains (`sparse.Pattern`), and each function that is given one, s, does its part
of them: 0 and 1, which two threads may do at once, the separator's before that as 2 and after it as AFTER. Subdomain 1
adds to memory of its own. Sums are always made in the same order, whoever makes them.

References: as in `coarsening`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Indices, staggered
from clothfit.engine.solve import coarsening, smoothing, sparse
from clothfit.engine.solve.coarsening import Coarsening, in_places
from clothfit.engine.solve.sparse import BlockMatrix, Pattern
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import column, fma, load4, mul, splat, store4, store_column, sum3

LAST_SWEEPS = 4
"""Symmetric sweeps on the coarsest level."""

KEPT = 2
"""Patterns whose coarsenings are kept: a fit makes workspaces for the same ones again and again."""

AFTER = 3
"""What of a pass the separator does when both subdomains are done."""

Singles = NDArray[np.float32]


class Level(NamedTuple):
    """A level and the memory of its part of a cycle, (n, 4) each but for the last, in single precision."""

    A: BlockMatrix  # of single precision as well
    r: Singles
    z: Singles
    rest: Singles  # r − A z
    far: Singles  # what subdomain 1 adds to `rest`, or to the `r` of a coarser level
    inverse: Singles  # (n + 1, 8), D⁻¹


class Hierarchy(NamedTuple):
    """The levels, from the finest, and how each coarser one is made."""

    levels: tuple[Level, Level, Level]
    coarsenings: tuple[Coarsening, Coarsening]
    share: BlockMatrix  # of the middle level's matrix: that of subdomain 1


_made: list[tuple[Indices, tuple[Coarsening, Coarsening]]] = []


def hierarchy(A: BlockMatrix) -> Hierarchy | None:
    """Two coarser levels for a matrix, by its pattern, and memory of cycles; None where it is small enough for SSOR."""
    if len(A.order) < sparse.MULTIGRID_FROM:
        return None
    pattern = in_places(Pattern(A.order, A.row, A.column, A.subdomains), len(A.diagonal) - 1)
    both = next((found for column, found in _made if column is A.column), None)
    if both is None:
        first = coarsening.coarsen(pattern)
        both = first, coarsening.coarsen(first.pattern)
        _made.insert(0, (A.column, both))
        del _made[KEPT:]
    fine, middle, last = (level(each) for each in (pattern, both[0].pattern, both[1].pattern))
    return Hierarchy((fine, middle, last), both, singles_matrix(both[0].pattern))


def nothing() -> Hierarchy:
    """The hierarchy of a cloth without vertices."""
    empty: Indices = np.zeros(0, np.int32)
    pattern = Pattern(empty, np.zeros(1, np.int32), empty, np.zeros((3, 2), np.int32))
    coarse = Coarsening(pattern.row, empty, np.zeros(0), empty, empty, empty, pattern.subdomains, pattern)
    fine = level(pattern)
    return Hierarchy((fine, fine, fine), (coarse, coarse), fine.A)


def level(pattern: Pattern) -> Level:
    """A level of this pattern, and its memory."""
    n = len(pattern.order)
    r, z, rest, far = (singles(each, n, 4) for each in staggered(4, n, 2))
    (inverse,) = staggered(1, n + 1, sparse.BLOCK_SIZE // 2)
    return Level(singles_matrix(pattern), r, z, rest, far, singles(inverse, n + 1, sparse.BLOCK_SIZE))


def singles_matrix(pattern: Pattern) -> BlockMatrix:
    """A matrix of this pattern in single precision, all zero."""
    blocks: list[Any] = []
    for count in (len(pattern.order) + 1, len(pattern.column) + 1):
        (memory,) = staggered(1, count, sparse.BLOCK_SIZE // 2)
        blocks.append(singles(memory, count, sparse.BLOCK_SIZE))
    return BlockMatrix(*pattern, *blocks)


def singles(memory: Any, *shape: int) -> Singles:
    """Memory for float64 as twice as many float32."""
    return np.asarray(memory.view(np.float32).reshape(shape))


@kernel
def rows(A, s):
    """The first row of subdomain s, and the row behind its last."""
    return A.subdomains[min(s, 2), 0], A.subdomains[min(s, 2), 1]


@kernel
def prepare(A, hierarchy, anyhow):
    """Fill the levels from a matrix; False when a diagonal block is not positive definite. `anyhow`: such blocks are
    made so, on each level, by what is added to their diagonals.
    """
    bad = 0.0
    for s in (2, 0, 1):
        bad += prepare_part(A, hierarchy, s, anyhow)
    return bad == 0.0 and prepare_coarse(hierarchy, anyhow)


@kernel
def prepare_part(A, hierarchy, s, anyhow):
    """The part of subdomain s: its rows on the finest level, and what they add to the next one. Returns how many of its
    blocks are not positive definite.
    """
    fine, middle = hierarchy.levels[0].A, hierarchy.levels[1].A
    begin, end = rows(A, s)
    for k in range(begin, end):
        round_block(A.diagonal, A.order[k], fine.diagonal, k)
    bad = invert(hierarchy.levels[0], begin, end, anyhow)
    if bad > 0.0:  # all the rest is in vain
        return bad
    for e in range(A.row[begin], A.row[end]):
        round_block(A.upper, e, fine.upper, e)
    to = hierarchy.share if s == 1 else middle
    if s > 0:  # 2 comes before 0
        coarsening.clear(to)
    coarsening.project(fine, s, begin, end, hierarchy.coarsenings[0], to)
    return bad


@kernel
def round_block(blocks, i, out, k):
    """Block k of `out` = block i."""
    store_column(column(blocks, i, 0), out, k, 0)
    store_column(column(blocks, i, 4), out, k, 4)


@kernel
def prepare_coarse(hierarchy, anyhow):
    """The coarser levels, when the parts of all subdomains are there; returns what `prepare` does."""
    middle, last, share = hierarchy.levels[1], hierarchy.levels[2], hierarchy.share
    coarsening.join(middle.A, share)
    if invert(middle, 0, len(middle.A.order), anyhow) > 0.0:
        return False
    coarsening.clear(last.A)
    coarsening.project(middle.A, 0, 0, len(middle.A.order), hierarchy.coarsenings[1], last.A)
    return invert(last, 0, len(last.A.order), anyhow) == 0.0


@kernel
def invert(at, begin, end, anyhow):
    """Fill the inverses of rows of a level; see `prepare`. Returns how many blocks are not positive definite."""
    bad = 0.0
    for k in range(begin, end):
        if not sparse.invert_block(at.A.diagonal, k, 1.0, at.inverse):
            if anyhow:
                lift(at.A.diagonal[k])
            if not (anyhow and sparse.invert_block(at.A.diagonal, k, 1.0, at.inverse)):
                bad += 1.0
    return bad


@kernel
def lift(block):
    """Add twice a bound of its eigenvalues to a block that is not positive definite."""
    xx, xy, xz = block[sparse.XX], block[sparse.XY], block[sparse.XZ]
    yy, yz, zz = block[sparse.YY], block[sparse.YZ], block[sparse.ZZ]
    more = 2.0 * (abs(xx) + abs(yy) + abs(zz) + 2.0 * (abs(xy) + abs(xz) + abs(yz)))
    for place in (sparse.XX, sparse.YY, sparse.ZZ):
        block[place] += more


@kernel
def precondition(A, hierarchy, r, size):
    """levels[0].z = M⁻¹ r / size for r (n, 4) of this length; returns r · M⁻¹ r."""
    for s in (2, 0, 1, AFTER):
        descend_part(A, hierarchy, s, r, size)
    coarse_cycle(hierarchy)
    total = 0.0
    for s in (2, 0, 1, AFTER):
        total += ascend_part(A, hierarchy, s, r)
    return size * total


@kernel
def descend_part(A, hierarchy, s, r, size):
    """The first sweep over subdomain s, and what it leaves to the middle level."""
    fine, middle = hierarchy.levels[0], hierarchy.levels[1]
    begin, end = rows(A, s)
    if s != AFTER:
        factor = splat(1.0 / size)
        for k in range(begin, end):
            store4(mul(factor, load4(r, A.order[k])), fine.r, k)
        if s == 2:
            smoothing.clear(begin, end, fine.far)
        rest = fine.far if s == 1 else fine.rest
        smoothing.descend(fine.A, fine.inverse, begin, end, fine.r, fine.z, rest)
        if s != 2:
            to = middle.far if s == 1 else middle.r
            smoothing.clear(0, len(to), to)
            smoothing.restrict(hierarchy.coarsenings[0], begin, end, rest, to)
    else:
        smoothing.gather(begin, end, fine.far, fine.rest)
        smoothing.restrict(hierarchy.coarsenings[0], begin, end, fine.rest, middle.r)
        smoothing.gather(0, len(middle.r), middle.far, middle.r)


@kernel
def coarse_cycle(hierarchy):
    """The z of the middle level by its r."""
    _, middle, last = hierarchy.levels
    count = len(middle.A.order)
    smoothing.descend(middle.A, middle.inverse, 0, count, middle.r, middle.z, middle.rest)
    smoothing.clear(0, len(last.r), last.r)
    smoothing.restrict(hierarchy.coarsenings[1], 0, count, middle.rest, last.r)
    smoothing.relax(last.A, last.inverse, LAST_SWEEPS, last.r, last.z, last.rest)
    smoothing.prolong(hierarchy.coarsenings[1], 0, count, last.z, middle.r, middle.z, middle.rest)
    smoothing.ascend(middle.A, middle.inverse, 0, count, middle.rest, middle.z)


@kernel
def ascend_part(A, hierarchy, s, r):
    """What the middle level found and the second sweep, over subdomain s; returns r · z there."""
    fine, middle = hierarchy.levels[0], hierarchy.levels[1]
    begin, end = rows(A, s)
    rest = fine.far if s == 1 else fine.rest
    if s == AFTER:
        smoothing.gather(begin, end, fine.far, rest)
    else:
        smoothing.prolong(hierarchy.coarsenings[0], begin, end, middle.z, fine.r, fine.z, rest)
        if s == 2:
            smoothing.clear(begin, end, fine.far)
            return 0.0
    smoothing.ascend(fine.A, fine.inverse, begin, end, rest, fine.z)
    total = splat(0.0)
    for k in range(begin, end):
        total = fma(load4(r, A.order[k]), load4(fine.z, k), total)
    return sum3(total)
