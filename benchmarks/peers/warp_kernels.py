"""The kernels of the Warp program: a step, the solver, and the way back through a step."""

import warp as wp

wp.config.log_level = wp.LOG_ERROR  # nothing about missing graphics cards
wp.set_module_options({"enable_backward": False})
vec, mat = wp.vec3d, wp.mat33d


@wp.struct
class Cloth:
    """The problem, as kernels see it; `row`, `column` and `slots` as `block_pattern` gives them."""

    free: wp.array(dtype=wp.bool)
    mass: wp.array(dtype=wp.float64)
    ends: wp.array2d(dtype=wp.int32)
    slots: wp.array2d(dtype=wp.int32)
    rest: wp.array(dtype=wp.float64)
    corners: wp.array2d(dtype=wp.int32)
    row: wp.array(dtype=wp.int32)
    column: wp.array(dtype=wp.int32)
    drag: wp.float64
    damping: wp.float64
    wind: vec
    gravity: vec
    h: wp.float64
    tolerance: wp.float64


@wp.struct
class Work:
    """The matrix, the right-hand side and the vectors of the solver."""

    diagonal: wp.array(dtype=mat)
    inverse: wp.array(dtype=mat)
    blocks: wp.array(dtype=mat)
    b: wp.array(dtype=vec)
    r: wp.array(dtype=vec)
    d: wp.array(dtype=vec)
    q: wp.array(dtype=vec)
    iterations: wp.array(dtype=wp.int32)


@wp.kernel
def vertices(p: Cloth, t: int, v: wp.array2d(dtype=vec), work: Work):
    """Begin the system of step t: masses, node damping, weight."""
    i = wp.tid()
    unit = wp.identity(n=3, dtype=wp.float64)
    work.diagonal[i] = p.mass[i] * (wp.float64(1.0) + p.h * p.damping) * unit
    work.b[i] = p.mass[i] * (v[t, i] + p.h * p.gravity)


@wp.kernel
def springs(p: Cloth, k: wp.array(dtype=wp.float64), t: int, x: wp.array2d(dtype=vec), work: Work):
    """Add the springs to the matrix and the right-hand side."""
    s = wp.tid()
    i, j = p.ends[s, 0], p.ends[s, 1]
    e = x[t, i] - x[t, j]
    length = wp.length(e)
    d = e / length
    rho = p.rest[s] / length
    hk = p.h * k[s]
    block = hk * (p.h * rho + wp.float64(0.5) * p.damping) * wp.outer(d, d)
    block += hk * p.h * (wp.float64(1.0) - rho) * wp.identity(n=3, dtype=wp.float64)
    pull = hk * (length - p.rest[s]) * d
    work.diagonal[i] += block
    work.diagonal[j] += block
    work.blocks[p.slots[s, 0]] -= block
    work.blocks[p.slots[s, 1]] -= block
    work.b[i] -= pull
    work.b[j] += pull


@wp.kernel
def faces(p: Cloth, t: int, x: wp.array2d(dtype=vec), v: wp.array2d(dtype=vec), work: Work):
    """Add air drag."""
    f = wp.tid()
    i, j, m = p.corners[f, 0], p.corners[f, 1], p.corners[f, 2]
    n = wp.cross(x[t, j] - x[t, i], x[t, m] - x[t, i])
    kappa = p.h * p.drag / wp.float64(6.0) * wp.length(n)
    inflow = wp.dot(n, p.wind - (v[t, i] + v[t, j] + v[t, m]) / wp.float64(3.0))
    block = kappa * wp.outer(n, n)
    for corner in range(3):
        c = p.corners[f, corner]
        work.diagonal[c] += block
        work.b[c] += kappa * (inflow + wp.dot(n, v[t, c])) * n


@wp.func
def multiply(p: Cloth, work: Work, x: wp.array(dtype=vec), i: int):
    """Row i of A x."""
    total = work.diagonal[i] * x[i]
    for e in range(p.row[i], p.row[i + 1]):
        total += work.blocks[e] * x[p.column[e]]
    return total


@wp.kernel
def solve(p: Cloth, work: Work, x: wp.array(dtype=vec)):
    """Conjugate gradients from the guess in x; one element does it all."""
    n = p.free.shape[0]
    bb, rr, rz = wp.float64(0.0), wp.float64(0.0), wp.float64(0.0)
    for i in range(n):
        if p.free[i]:
            work.inverse[i] = wp.inverse(work.diagonal[i])
            r = work.b[i] - multiply(p, work, x, i)
            z = work.inverse[i] * r
            work.r[i] = r
            work.d[i] = z
            bb += wp.dot(work.b[i], work.b[i])
            rr += wp.dot(r, r)
            rz += wp.dot(r, z)
        else:
            work.d[i] = vec()
    goal = p.tolerance * p.tolerance * bb
    while rr > goal:
        work.iterations[0] += 1
        dq = wp.float64(0.0)
        for i in range(n):
            if p.free[i]:
                q = multiply(p, work, work.d, i)
                work.q[i] = q
                dq += wp.dot(work.d[i], q)
        alpha = rz / dq
        before = rz
        rr, rz = wp.float64(0.0), wp.float64(0.0)
        for i in range(n):
            if p.free[i]:
                x[i] += alpha * work.d[i]
                r = work.r[i] - alpha * work.q[i]
                work.r[i] = r
                rr += wp.dot(r, r)
                z = work.inverse[i] * r
                work.q[i] = z
                rz += wp.dot(r, z)
        beta = rz / before
        for i in range(n):
            if p.free[i]:
                work.d[i] = work.q[i] + beta * work.d[i]


@wp.kernel
def advance(p: Cloth, t: int, w: wp.array(dtype=vec), x: wp.array2d(dtype=vec), v: wp.array2d(dtype=vec)):
    """Keep the new velocities and positions."""
    i = wp.tid()
    v[t + 1, i] = w[i]
    x[t + 1, i] = x[t, i] + p.h * w[i]


@wp.kernel
def compare(
    t: int,
    x: wp.array2d(dtype=vec),
    target: wp.array2d(dtype=vec),
    x_bar: wp.array(dtype=vec),
    cost: wp.array(dtype=wp.float64),
):
    """Add what frame t costs, and its derivative by the positions."""
    i = wp.tid()
    gap = x[t, i] - target[t, i]
    cost[0] += wp.dot(gap, gap)
    x_bar[i] += wp.float64(2.0) * gap


@wp.kernel
def seed(p: Cloth, x_bar: wp.array(dtype=vec), v_bar: wp.array(dtype=vec), work: Work):
    """The right-hand side of the adjoint's system."""
    i = wp.tid()
    if p.free[i]:
        work.b[i] = v_bar[i] + p.h * x_bar[i]
    else:
        work.b[i] = vec()


@wp.kernel
def vertices_back(p: Cloth, lam: wp.array(dtype=vec), v_bar: wp.array(dtype=vec)):
    """The gradient by the velocity before the step, without drag."""
    i = wp.tid()
    v_bar[i] = p.mass[i] * lam[i]


@wp.kernel
def springs_back(
    p: Cloth,
    k: wp.array(dtype=wp.float64),
    t: int,
    x: wp.array2d(dtype=vec),
    v: wp.array2d(dtype=vec),
    lam: wp.array(dtype=vec),
    x_bar: wp.array(dtype=vec),
    gradient: wp.array(dtype=wp.float64),
):
    """With h k ψ = λᵀ(A w − b) of a spring, ψ = (1 − ρ) q·(e + h w) + σ (q·d)(w·d), σ = h ρ + α/2, q = λ_i − λ_j."""
    s = wp.tid()
    i, j = p.ends[s, 0], p.ends[s, 1]
    e, w, q = x[t, i] - x[t, j], v[t + 1, i] - v[t + 1, j], lam[i] - lam[j]
    length = wp.length(e)
    d = e / length
    rho = p.rest[s] / length
    sigma = p.h * rho + wp.float64(0.5) * p.damping
    qd, wd, qew = wp.dot(q, d), wp.dot(w, d), wp.dot(q, e + p.h * w)
    gradient[s] -= p.h * ((wp.float64(1.0) - rho) * qew + sigma * qd * wd)
    cl = wp.float64(1.0) - rho + sigma * wd / length
    cd = (rho * qew - (p.h * rho + wp.float64(2.0) * sigma) * qd * wd) / length
    by_e = p.h * k[s] * (cl * q + sigma * qd / length * w + cd * d)
    x_bar[i] -= by_e
    x_bar[j] += by_e


@wp.kernel
def faces_back(
    p: Cloth,
    t: int,
    x: wp.array2d(dtype=vec),
    v: wp.array2d(dtype=vec),
    lam: wp.array(dtype=vec),
    x_bar: wp.array(dtype=vec),
    v_bar: wp.array(dtype=vec),
):
    """With h κ φ = λᵀ(A w − b) of a face, φ = Σ_j (λ_j·n)(n·(w_j − v_j)) − (Λ·n)(n·(wind − v̄)), Λ = Σ_j λ_j."""
    f = wp.tid()
    i, j, m = p.corners[f, 0], p.corners[f, 1], p.corners[f, 2]
    e, g = x[t, j] - x[t, i], x[t, m] - x[t, i]
    n = wp.cross(e, g)
    size = wp.dot(n, n)
    if size == wp.float64(0.0):
        return
    kappa = p.h * p.drag / wp.float64(6.0) * wp.sqrt(size)
    air = p.wind - (v[t, i] + v[t, j] + v[t, m]) / wp.float64(3.0)
    inflow = wp.dot(n, air)
    total = lam[i] + lam[j] + lam[m]
    value = -wp.dot(total, n) * inflow
    by_n = -inflow * total - wp.dot(total, n) * air
    for corner in range(3):
        c = p.corners[f, corner]
        q = v[t + 1, c] - v[t, c]
        nu, theta = wp.dot(lam[c], n), wp.dot(q, n)
        value += nu * theta
        by_n += theta * lam[c] + nu * q
        v_bar[c] += kappa * (nu - wp.dot(total, n) / wp.float64(3.0)) * n
    by_n = kappa * (by_n + value / size * n)
    by_e, by_g = wp.cross(g, by_n), wp.cross(by_n, e)
    x_bar[j] -= by_e
    x_bar[m] -= by_g
    x_bar[i] += by_e + by_g
