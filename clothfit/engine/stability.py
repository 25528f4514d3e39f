"""How long the steps of the explicit and the symplectic method may be before what they compute grows without bound.

Near its start a cloth moves as M ẍ + D ẋ + K x = 0. In the direction of an oscillation of frequency ω (1/s) and
damping d (1/s), ẍ + d ẋ + ω² x = 0, a step of h multiplies (v, x) by a matrix of trace T and determinant Δ:

    symplectic   T = 2 − h d − h² ω²,  Δ = 1 − h d           explicit   T = 2 − h d,  Δ = 1 − h d + h² ω²

Both its eigenvalues are within the unit circle where |T| − 1 < Δ < 1 (the criterion of Jury), that is where

    symplectic   h² ω² + 2 h d < 4                           explicit   h ω² < d  and  2 h d < 4 + h² ω²

So without damping symplectic steps may be as long as 2/ω, and explicit ones gain in every step, whatever its length:
the largest eigenvalue is √(1 + h² ω²). The fastest oscillation decides. Its ω² is the largest eigenvalue of M⁻¹ K, by
the method of Lanczos (G. Golub, C. Van Loan, Matrix Computations, section 10.1). Fixed vertices do not move.

K is that of the start: a spring counts k along its axis, k (1 − L₀/L) across it where it is stretched, and 0 where
it is compressed; a touched sphere counts κ along its normal. The damping d is α of the vertices and (α/2) ω² of the
springs, at their rest length; the air adds at most what it takes of the vertex it slows most.

Springs turn and stretch while the cloth moves, and its fastest frequency with them. Whatever their directions, it stays
below that of `frequency(…, turned=True)`, where each spring counts k in all directions, a fifth to a quarter above that
of the start on grids as the editor makes them: a cloth folded into a line. The start predicts better what happens:
those examples whose springs keep their length diverge between 1.03 and 1.2 times its limit.
"""

from __future__ import annotations

from collections.abc import Callable
from math import hypot, inf, isfinite, isnan, log10, sqrt
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.forces import collider_rows
from clothfit.engine.forces.air import SHARE
from clothfit.engine.forces.spheres import STIFFNESS
from clothfit.engine.system import BDF2, EXPLICIT, IMPLICIT, SYMPLECTIC, System, build
from clothfit.scene.kinds import INTEGRATORS
from clothfit.scene.scene import Scene

UNLIMITED = (IMPLICIT, BDF2)
"""Methods whose steps are stable however long they are."""

ACCURACY = 0.01
"""Of ω², relative."""

LANCZOS_STEPS = 300
"""Products with K, at most; what is found then is a lower bound."""

HARMLESS_GROWTH = 2.0
"""No warning where no oscillation grows more than this over a run: in explicit steps some always do."""


class Limit(NamedTuple):
    """What is known of the explicit or symplectic steps of a cloth before they are taken."""

    frequency: float  # ω of the fastest oscillation, 1/s
    step: float  # longest stable step, s: 0 where none is, infinite where all are
    growth: float  # factor per step of the scene's delta on the fastest growing oscillation; at most 1 where stable


def limit(system: System, omega: float | None = None) -> Limit:
    """The limit of a cloth, with its own method; nothing limits some. `omega`: its `frequency`, if known."""
    if system.method in UNLIMITED:
        return Limit(0.0, inf, 1.0)
    with np.errstate(all="ignore"):  # of values at the ends of the range of doubles
        omega = frequency(system) if omega is None else omega
        alpha, beta, air = system.vertex.damping.max(), system.springs.damping.max(), drag(system)
        damping = alpha + beta * omega * omega
        modes = [(omega, damping, damping + air), (0.0, alpha, alpha + air)]  # the second: what no spring holds
        step = min(longest_step(system.method, *mode) for mode in modes)
        growths = [growth(system.method, system.h, w, d) for w, *ds in modes for d in ds]
    return Limit(omega, step, inf if any(map(isnan, growths)) else max(growths))


def warning(scene: Scene, steps: int) -> str | None:
    """The warning before so many steps of a scene, where some of its cloths will not stay stable; None otherwise."""
    if scene.method in UNLIMITED:
        return None
    limits = {group[0]: limit(build(scene, group[0])) for group in scene.groups}
    index = max(limits, key=lambda i: limits[i].growth)
    worst = limits[index]
    decades = steps * log10(max(worst.growth, 1.0))
    if decades <= log10(HARMLESS_GROWTH):
        return None
    over = f"{10**decades:.2g}" if decades < 4 else f"1e{decades:.0f}" if decades < inf else "inf"
    return (
        f"{scene.name}: objects[{index}]: {INTEGRATORS[scene.method]} steps of {scene.delta:.4g} s will not stay "
        f"stable ({known(worst.step)}): the fastest oscillation, of {worst.frequency:.3g} rad/s, grows "
        f"{worst.growth:.3g} times per step, {over} times over {steps} steps; try a smaller delta or "
        "integrationMethod 2 (implicit)"
    )


NO_REST = (
    "no shape at rest was found: a cloth that nothing holds has none, and one whose stiffnesses differ by many powers "
    "of ten may need a start that is nearer to it"
)


def advice(scene: Scene, index: int) -> str:
    """What a user can try after the motion of a cloth diverged."""
    if scene.method in UNLIMITED:
        return "try a smaller delta"
    step = limit(build(scene, index)).step
    why = f" ({INTEGRATORS[scene.method]} steps: {known(step)})" if step < inf else ""
    return f"try a smaller delta{why} or integrationMethod 2 (implicit)"


def known(step: float) -> str:
    """A clause about the longest stable step, s."""
    return f"the limit is {step:.3g} s" if step > 0.0 else "without damping they gain energy however short they are"


def longest_step(method: int, omega: float, low: float, high: float) -> float:
    """The longest stable step, s, for an oscillation of frequency ω, 1/s, whose damping, 1/s, lies between two values;
    infinite without frequency and damping.
    """
    if max(low, high, omega) == inf:
        return 0.0
    if method == SYMPLECTIC:  # the positive root of h² ω² + 2 h d = 4
        return 4.0 / (high + hypot(high, 2.0 * omega)) if high or omega else inf
    gain = low / omega / omega if omega else inf
    if high < 2.0 * omega or not high:
        return gain
    # the smaller root of h² ω² − 2 h d + 4 = 0
    return min(gain, 4.0 / (high + sqrt(high - 2.0 * omega) * sqrt(high + 2.0 * omega)))


def growth(method: int, h: float, omega: float, damping: float) -> float:
    """The larger eigenvalue, in size, of a step of h, s: the factor by which an oscillation grows."""
    stiff, damped = h * omega * h * omega, h * damping
    trace = 2.0 - damped - (stiff if method == SYMPLECTIC else 0.0)
    determinant = 1.0 - damped + (stiff if method == EXPLICIT else 0.0)
    root = trace * trace / 4.0 - determinant
    return abs(trace) / 2.0 + sqrt(root) if root > 0.0 else sqrt(determinant)


def frequency(system: System, turned: bool = False) -> float:
    """ω of the fastest oscillation, 1/s, to half of `ACCURACY`, or infinite where doubles do not hold it; `turned`: a
    bound for any directions of the springs.
    """
    scale = np.where(system.vertex.free, 1.0 / np.sqrt(system.vertex.mass), 0.0)[:, None]
    multiply = stiffness(system, turned)
    return sqrt(largest_eigenvalue(lambda x: scale * multiply(scale * x), len(scale)))


def stiffness(system: System, turned: bool) -> Callable[[Array], Array]:
    """The function that multiplies (n, 3) by K."""
    x, springs, n = system.x0, system.springs, len(system.x0)
    a, b = springs.ends.T
    e = x[a] - x[b]
    length = np.sqrt(np.einsum("si,si->s", e, e))[:, None]
    d = e / np.where(length > 0.0, length, 1.0)
    k = springs.stiffness[:, None]
    stretched = 1.0 - springs.rest[:, None] / np.where(length > 0.0, length, inf)
    across = k if turned else k * np.maximum(stretched, 0.0) * (length > 0.0)
    i, normal, kappa = touched(system)

    def multiply(y: Array) -> Array:
        stretch = y[a] - y[b]
        pull = across * stretch + (k - across) * d * np.einsum("si,si->s", d, stretch)[:, None]
        push = kappa[:, None] * normal * np.einsum("ci,ci->c", normal, y[i])[:, None]
        rows, values = np.concatenate([a, b, i]), np.concatenate([pull, -pull, push])
        return np.stack([np.bincount(rows, column, n) for column in values.T], axis=1)

    return multiply


def touched(system: System) -> tuple[Array, Array, Array]:
    """The vertices (c,) in colliders at the start, the normals (c, 3) there, and the stiffnesses (c,), N/m."""
    found = [(np.zeros(0, int), np.zeros((0, 3)), np.zeros(0))]
    for centre, radius in zip(system.spheres.centre, system.spheres.radius, strict=True):
        away = system.x0 - centre
        distance = np.sqrt((away * away).sum(axis=1))
        i = np.flatnonzero(distance < radius)
        up = np.array([0.0, 1.0, 0.0])
        there = distance[i, None]
        normal = np.where(there > 0.0, away[i] / np.where(there > 0.0, there, 1.0), up)
        found.append((i, normal, np.full(len(i), STIFFNESS)))
    if system.colliders is not None:
        depth, normal = collider_rows.depths(system.colliders, system.x0)
        for c, kappa in enumerate(system.colliders.stiffness):
            i = np.flatnonzero(depth[c] > 0.0)
            found.append((i, normal[c, i], np.full(len(i), kappa)))
    vertices, normals, stiffnesses = zip(*found, strict=True)
    return np.concatenate(vertices), np.concatenate(normals), np.concatenate(stiffnesses)


def drag(system: System) -> float:
    """The largest rate at which the air slows a free vertex at the start, 1/s."""
    rate = np.nan_to_num(drags(system) / system.vertex.mass, nan=inf, posinf=inf)
    return float(rate[system.vertex.free].max(initial=0.0))


def drags(system: System) -> Array:
    """The air's drag on each vertex at the start, along the normals of its faces, Σ κ |n|² (n,), kg/s; in the law "air"
    as if all the wind that they feel then blew along these.
    """
    faces, x = system.faces, system.x0
    corners = faces.corners
    a, b, c = (x[corners[:, corner]] for corner in range(3))
    n = np.cross(b - a, c - a)
    size = (n * n).sum(axis=1)
    drag = faces.drag[0 if faces.object is None else faces.object]
    own = drag / 6.0 * size**1.5
    if faces.quadratic:
        flow = np.linalg.norm(faces.wind - system.v0[corners].mean(axis=1), axis=1)
        own = 2.0 * SHARE * drag * np.sqrt(size) * flow
    each = np.repeat(own, 3)
    return np.asarray(np.bincount(corners.reshape(-1), each, len(x)), float)


def largest_eigenvalue(multiply: Callable[[Array], Array], n: int) -> float:
    """The largest eigenvalue of a symmetric positive semi-definite matrix, given as its product with (n, 3); infinite
    where doubles do not hold the product.

    By Lanczos' method, which keeps two vectors: that they lose their orthogonality repeats eigenvalues that are found,
    and does not change the largest (Golub & Van Loan, Matrix Computations, 10.3). SciPy's takes longer to import.
    """
    q, before = np.random.default_rng(0).normal(size=(n, 3)), np.zeros((n, 3))
    q /= np.linalg.norm(q)
    scale = np.abs(multiply(q)).max(initial=0.0)  # so that squares neither overflow nor vanish
    if not 0.0 < scale < inf:
        return 0.0 if scale == 0.0 else inf
    diagonal: list[float] = []
    beside: list[float] = [0.0]
    found = 0.0
    for step in range(1, LANCZOS_STEPS + 1):
        product = multiply(q) / scale
        diagonal.append(float(np.vdot(q, product)))
        rest = product - diagonal[-1] * q - beside[-1] * before
        beside.append(float(np.linalg.norm(rest)))
        if not isfinite(beside[-1]):
            return inf
        ended = beside[-1] <= 1e-12 * max(diagonal)
        if ended or step % 10 == 0:
            values, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(beside[1:-1], 1) + np.diag(beside[1:-1], -1))
            found = max(float(values[-1]), 0.0)
            if ended or beside[-1] * abs(vectors[-1, -1]) <= 0.5 * ACCURACY * found:
                break
        before, q = q, rest / beside[-1]
    return float(found * scale)
