"""Multigrid, the preconditioner of cloths of so many vertices that SSOR takes too many iterations.

A sweep of Gauss–Seidel carries news from vertex to vertex, so the finer a cloth, the more sweeps; sums over groups of
vertices carry it far at once. With P from a coarser level to a finer one (`coarsening`), A_c = Pᵀ A P, one cycle

    z = (D + L)⁻¹ r,    z += P A_c⁻¹ Pᵀ (r − A z),    z += (D + Lᵀ)⁻¹ (r − A z)

is symmetric and positive definite; A_c⁻¹ is again such a cycle, and on the last level some sweeps of Gauss–Seidel,
which suffice there because the mass outweighs the springs ever more. For that A itself need not be positive definite,
only its diagonal blocks: what a sweep leaves of S⁻¹ A, S = A + L D⁻¹ Lᵀ, has no eigenvalue above 1.

All of it is kept in single precision, and computed in double: a cycle takes as long as reading its matrices takes, and
rounding a preconditioner changes no solution. A right-hand side is scaled to length 1 first, lest it vanish.

References: as in `coarsening`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Indices, staggered
from clothfit.engine.solve import coarsening, sparse, ssor
from clothfit.engine.solve.coarsening import Coarsening
from clothfit.engine.solve.sparse import BlockMatrix, Pattern, times
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, clear3, fma, load, mul, splat, store, sub, sum3

LAST_SWEEPS = 4
"""Symmetric sweeps on the coarsest level."""

KEPT = 2
"""Patterns whose coarsenings are kept: a fit makes workspaces for the same ones again and again."""

Singles = NDArray[np.float32]


class Level(NamedTuple):
    """A level and the memory of its part of a cycle, (n, 4) each but for the last two, in single precision."""

    A: BlockMatrix  # of single precision as well
    r: Singles
    z: Singles
    own: Singles  # right-hand sides, which sweeps overwrite
    rest: Singles  # r − A z
    inverse: Singles  # (n + 1, 8), D⁻¹
    whole: Indices  # (2,), all rows as one subdomain


class Hierarchy(NamedTuple):
    """The levels, from the finest, and how each coarser one is made."""

    levels: tuple[Level, Level, Level]
    coarsenings: tuple[Coarsening, Coarsening]


_made: list[tuple[Indices, tuple[Coarsening, Coarsening]]] = []


def hierarchy(A: BlockMatrix) -> Hierarchy | None:
    """Two coarser levels for a matrix, by its pattern, and memory of cycles; None where it is small enough for SSOR."""
    if len(A.order) < sparse.MULTIGRID_FROM:
        return None
    n = len(A.diagonal) - 1
    pattern = Pattern(A.order, A.row, A.column, A.subdomains)
    both = next((found for column, found in _made if column is A.column), None)
    if both is None:
        first = coarsening.coarsen(pattern, n)
        both = first, coarsening.coarsen(first.pattern, len(first.pattern.order))
        _made.insert(0, (A.column, both))
        del _made[KEPT:]
    middle, last = (level(each.pattern, len(each.pattern.order)) for each in both)
    return Hierarchy((level(pattern, n), middle, last), both)


def level(pattern: Pattern, n: int) -> Level:
    """A level of this pattern for n vertices, and its memory."""
    r, z, own, rest = (singles(each, n, 4) for each in staggered(4, n, 2))
    blocks = [singles(each, len(each), sparse.BLOCK_SIZE) for each in (
        *staggered(2, n + 1, sparse.BLOCK_SIZE // 2), *staggered(1, len(pattern.column) + 1, sparse.BLOCK_SIZE // 2)
    )]  # fmt: skip
    matrix: Any = BlockMatrix(*pattern, blocks[0], blocks[2])  # type: ignore[arg-type]
    return Level(matrix, r, z, own, rest, blocks[1], np.array([0, len(pattern.order)], np.int32))


def singles(memory: Any, *shape: int) -> Singles:
    """Memory for float64 as twice as many float32."""
    return np.asarray(memory.view(np.float32).reshape(shape))


@kernel
def round_to(blocks, out):
    """out = blocks."""
    for k in range(len(blocks)):
        store(load(blocks, k, 0), out, k, 0)
        store(load(blocks, k, 4), out, k, 4)


@kernel
def prepare(A, levels, coarsenings, anyhow):
    """Fill the levels from a matrix; False when a diagonal block is not positive definite. `anyhow`: such blocks are
    made so, on each level, by what is added to their diagonals.
    """
    fine, middle, last = levels
    round_to(A.diagonal, fine.A.diagonal)
    round_to(A.upper, fine.A.upper)
    if not invert(fine, anyhow):
        return False
    coarsening.project(fine.A, coarsenings[0], middle.A)
    if not invert(middle, anyhow):
        return False
    coarsening.project(middle.A, coarsenings[1], last.A)
    return invert(last, anyhow)


@kernel
def invert(at, anyhow):
    """Fill the inverses of a level; see `prepare`."""
    if sparse.invert_diagonal(at.A, 1.0, at.inverse):
        return True
    if anyhow:
        for i in at.A.order:
            lift(at.A.diagonal[i])
        return sparse.invert_diagonal(at.A, 1.0, at.inverse)
    return False


@kernel
def lift(block):
    """Add twice a bound of its eigenvalues to a block that is not positive definite."""
    xx, xy, xz = block[sparse.XX], block[sparse.XY], block[sparse.XZ]
    yy, yz, zz = block[sparse.YY], block[sparse.YZ], block[sparse.ZZ]
    minor = xx * yy - xy * xy
    determinant = xx * (yy * zz - yz * yz) + xy * (xz * yz - xy * zz) + xz * (xy * yz - xz * yy)
    if xx > 0.0 and minor > 0.0 and determinant > 0.0:
        return
    more = 2.0 * (abs(xx) + abs(yy) + abs(zz) + 2.0 * (abs(xy) + abs(xz) + abs(yz)))
    block[sparse.XX] += more
    block[sparse.YY] += more
    block[sparse.ZZ] += more


@kernel
def precondition(hierarchy, r, size):
    """levels[0].z = M⁻¹ r / size for r (n, 4) of this length; returns r · M⁻¹ r."""
    fine, factor, total = hierarchy.levels[0], splat(1.0 / size), splat(0.0)
    for i in fine.A.order:
        store(mul(factor, load(r, i, 0)), fine.r, i, 0)
    cycle(hierarchy.levels, hierarchy.coarsenings)
    for i in fine.A.order:
        total = fma(load(r, i, 0), load(fine.z, i, 0), total)
    return size * sum3(total)


@kernel
def cycle(levels, coarsenings):
    """levels[0].z = M⁻¹ levels[0].r."""
    fine, middle, last = levels
    descend(fine)
    restrict(fine, coarsenings[0], middle)
    descend(middle)
    restrict(middle, coarsenings[1], last)
    relax(last)
    prolong(last, coarsenings[1], middle)
    ascend(middle)
    prolong(middle, coarsenings[0], fine)
    ascend(fine)


@kernel
def descend(at):
    """z = (D + L)⁻¹ r and rest = r − A z, which is −Lᵀ z."""
    A, r, z, own, rest, inverse, whole = at
    ssor.copy_rows(A, whole, r, own)
    ssor.solve_lower(A, whole, inverse, own, z)
    zero = splat(0.0)
    for k in range(len(A.order)):
        total = zero
        for e in range(A.row[k], A.row[k + 1]):
            total = times(A.upper, e, load(z, A.column[e], 0), total)
        store(sub(zero, clear3(total)), rest, A.order[k], 0)


@kernel
def ascend(at):
    """z = (D + Lᵀ)⁻¹ (r − L z)."""
    A, r, z, _, rest, inverse, whole = at
    zero = splat(0.0)
    ssor.copy_rows(A, whole, r, rest)
    for k in range(len(A.order)):
        ssor.push(A, A.row, k, sub(zero, load(z, A.order[k], 0)), rest)
    for k in range(len(A.order) - 1, -1, -1):
        i = A.order[k]
        total = zero
        for e in range(A.row[k + 1] - 1, A.row[k] - 1, -1):
            total = times(A.upper, e, load(z, A.column[e], 0), total)
        store(clear3(times(inverse, i, sub(load(rest, i, 0), total), zero)), z, i, 0)


@kernel
def restrict(fine, coarsening, coarse):
    """r of the coarse level = Pᵀ rest."""
    start, aggregate, weight = coarsening.start, coarsening.aggregate, coarsening.weight
    zero = splat(0.0)
    for i in range(len(coarse.r)):
        store(zero, coarse.r, i, 0)
    for i in fine.A.order:
        rest = load(fine.rest, i, 0)
        for a in range(start[i], start[i + 1]):
            store(fma(splat(weight[a]), rest, load(coarse.r, aggregate[a], 0)), coarse.r, aggregate[a], 0)


@kernel
def prolong(coarse, coarsening, fine):
    """z += P z of the coarse level."""
    start, aggregate, weight = coarsening.start, coarsening.aggregate, coarsening.weight
    for i in fine.A.order:
        z_i = load(fine.z, i, 0)
        for a in range(start[i], start[i + 1]):
            z_i = fma(splat(weight[a]), load(coarse.z, aggregate[a], 0), z_i)
        store(z_i, fine.z, i, 0)


@kernel
def relax(at):
    """z = A⁻¹ r, nearly: the result of some symmetric sweeps of Gauss–Seidel from z = 0."""
    A, r, z, own, rest, inverse, whole = at
    descend(at)
    ascend(at)
    for _ in range(1, LAST_SWEEPS):
        remainder(A, r, z, own)
        ssor.solve_lower(A, whole, inverse, own, rest)
        for i in A.order:
            store(add(load(z, i, 0), load(rest, i, 0)), z, i, 0)
        ascend(at)


@kernel
def remainder(A, r, z, out):
    """out = r − A z."""
    zero = splat(0.0)
    for i in A.order:
        store(load(r, i, 0), out, i, 0)
    for k in range(len(A.order)):
        i = A.order[k]
        less = sub(zero, load(z, i, 0))
        total = times(A.diagonal, i, less, load(out, i, 0))
        for e in range(A.row[k], A.row[k + 1]):
            total = times(A.upper, e, sub(zero, load(z, A.column[e], 0)), total)
        store(clear3(total), out, i, 0)
        ssor.push(A, A.row, k, less, out)
