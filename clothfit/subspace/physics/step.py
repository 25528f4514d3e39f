"""One iteration of an implicit step on the copies of `samples`, compiled.

On all vertices an iteration solves A w = M v + h [f(y, u) + K (x − y) − D u] (`engine.step.implicit`). With w = U ω on
the free vertices and the velocities of the pins elsewhere, projected on U, that is

    (Uᵀ M U (1 + h α) + Σ Rᵀ B R) ω = Uᵀ M U p + h Uᵀ M 1 g + Σ Rᵀ (b − B ċ),

the sums over copies, B = −h² K − h D and b the blocks and the right-hand sides that the engine's forces give, ċ the
velocity of the pins' part of a copy. Each block is symmetric: B = Σ d l lᵀ, and the rows √|d| lᵀ R of all blocks make
the matrix as one product, those with d < 0 subtracted. A block of rank one, as those of faces and of contacts, gives
one row. Arrays are (copies, 3) or (points, 3).
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from clothfit.engine.forces import colliders, meeting, spheres, springs, wind
from clothfit.engine.inputs.tables import set_inputs
from clothfit.engine.solve.sparse import XX, XY, XZ, YY, YZ, ZZ
from clothfit.kernels.kernel import kernel
from clothfit.subspace.physics.samples import Blocks

TINY = 1e-13
"""What of a block's pivot is rounding, relative to its trace."""


@kernel
def begin(own, t):
    """Set the inputs of step t."""
    set_inputs(own.inputs, own, t)
    meeting.clear(own.colliders)


@kernel
def spread(lay, points, out):
    """Give every copy the values of its point; the origin keeps 0."""
    for i in range(1, len(out)):
        j = lay.point[i]
        out[i, 0], out[i, 1], out[i, 2] = points[j, 0], points[j, 1], points[j, 2]


@kernel
def add_pins(lay, pins, out):
    """Add the part of the pins (P, 3) to points."""
    for e in range(len(lay.pinned)):
        j, p = lay.pinned[e, 0], lay.pinned[e, 1]
        for c in range(3):
            out[j, c] += lay.sign[e] * pins[p, c]


@kernel
def linearise(own, lay, points, h, y, u, A, b):
    """Write y and u of the copies for R q and R p in the rows of `points` (2, 3 m), and the blocks A and b of a step
    from there. What of y and u is the pins' is there.
    """
    for i in range(1, len(y)):
        j = lay.point[i]
        for c in range(3):
            y[i, c] += points[0, 3 * j + c] + lay.constant[j, c]
            u[i, c] += points[1, 3 * j + c]
    assemble(own, lay, y, u, h, False, A, b)


@kernel
def assemble(own, lay, y, u, h, ahead, A, b):
    """The blocks of A (copies) and b (copies, 3) of the forces at (y, u), without weights."""
    for i in range(len(A.diagonal)):
        for c in range(8):
            A.diagonal[i, c] = 0.0
    b[:] = 0.0
    s, f = lay.ends[0], lay.ends[1]
    springs.add_step(own.springs, y[:s], u[:s], h, ahead, Blocks(A.diagonal, A.upper), b[:s])
    wind.add_step(own.faces, y[s:f], u[s:f], h, ahead, Blocks(A.diagonal[s:], A.upper), b[s:f])
    spheres.add_step(own.spheres, y[f:], u[f:], h, ahead, Blocks(A.diagonal[f:], A.upper), b[f:])
    colliders.add_step(own.colliders, y[f:], u[f:], h, ahead, Blocks(A.diagonal[f:], A.upper), b[f:])


@kernel
def times_block(A, i, x0, x1, x2):
    """B x of copy i."""
    D = A.diagonal
    return (
        D[i, XX] * x0 + D[i, XY] * x1 + D[i, XZ] * x2,
        D[i, XY] * x0 + D[i, YY] * x1 + D[i, YZ] * x2,
        D[i, XZ] * x0 + D[i, YZ] * x1 + D[i, ZZ] * x2,
    )


@kernel
def of_copies(A, b, velocity, out):
    """out (copies, 3) = b − B w for velocities w."""
    for i in range(len(b)):
        p0, p1, p2 = times_block(A, i, velocity[i, 0], velocity[i, 1], velocity[i, 2])
        out[i, 0], out[i, 1], out[i, 2] = b[i, 0] - p0, b[i, 1] - p1, b[i, 2] - p2


@kernel
def factors(lay, A, up, down):
    """Write the rows √|d| lᵀ R of all weighted blocks, those with d > 0 to `up` and the others to `down`, (…, r) each;
    returns how many there are of both.
    """
    more, less = 0, 0
    f = np.empty((3, 4))
    for i in range(1, len(lay.point)):
        weight = lay.weight[i]
        for k in range(split(A.diagonal, i, f)):
            scale = weight * f[k, 3]
            if scale > 0.0:
                write_row(lay.rows, 3 * lay.point[i], sqrt(scale), f[k], up[more])
                more += 1
            elif scale < 0.0:
                write_row(lay.rows, 3 * lay.point[i], sqrt(-scale), f[k], down[less])
                less += 1
    return more, less


@kernel
def write_row(rows, j, scale, along, out):
    """out (r,) = scale · lᵀ R for `along` l (3,), R the three rows from j on."""
    l0, l1, l2 = scale * along[0], scale * along[1], scale * along[2]
    for c in range(rows.shape[1]):
        out[c] = l0 * rows[j, c] + l1 * rows[j + 1, c] + l2 * rows[j + 2, c]


@kernel
def split(D, i, f):
    """Block i as Σ d l lᵀ, largest pivot first: rows l, d of f (3, 4); returns how many there are."""
    a, b, c = D[i, XX], D[i, XY], D[i, XZ]
    d, e, g = D[i, YY], D[i, YZ], D[i, ZZ]
    least = TINY * (abs(a) + abs(d) + abs(g))
    for k in range(3):
        if max(abs(a), abs(d), abs(g)) <= least:
            return k
        if abs(a) >= abs(d) and abs(a) >= abs(g):
            pivot, l0, l1, l2 = a, 1.0, b / a, c / a
        elif abs(d) >= abs(g):
            pivot, l0, l1, l2 = d, b / d, 1.0, e / d
        else:
            pivot, l0, l1, l2 = g, c / g, e / g, 1.0
        f[k, 0], f[k, 1], f[k, 2], f[k, 3] = l0, l1, l2, pivot
        a, b, c = a - pivot * l0 * l0, b - pivot * l0 * l1, c - pivot * l0 * l2
        d, e, g = d - pivot * l1 * l1, e - pivot * l1 * l2, g - pivot * l2 * l2
    return 3
