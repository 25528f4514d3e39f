"""Small objects, states and systems for tests of the physics, and the step's model F(w) put together from its parts.

A state is what the functions of a force are given: the point of linearisation (y, u), the new velocity w, the offset
s, the weights lam and the changes dy, du; all (n, 3).
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

import clothfit.scene.scene
from clothfit.base.arrays import Array, Elements
from clothfit.engine.forces import contact, spheres, springs, vertex, wind
from clothfit.engine.solve import sparse
from clothfit.engine.system import (
    BDF2,
    EXPLICIT,
    IMPLICIT,
    SYMPLECTIC,
    System,
    all_elements,
    build,
    with_elements,
    zeros,
)
from clothfit.scene.scene import Scene
from helpers.scenes import cloth, document

TIGHT = 1e-14  # tolerance of linear systems: their error is then rounding
GRAVITY = 9.81
KINDS = tuple(name for name in Elements._fields[2:] if name != "force")  # fitted besides masses and stiffnesses
STATES = ("rest", "random", "stretched", "compressed")
METHODS = {"explicit": EXPLICIT, "symplectic": SYMPLECTIC, "implicit": IMPLICIT, "bdf2": BDF2}
VARIANTS = [("explicit", 1), ("symplectic", 1), ("implicit", 1), ("implicit", 3), ("bdf2", 1), ("bdf2", 3)]
"""Methods and linear solves per step."""


class State(NamedTuple):
    """Arguments of the functions of a force."""

    y: Array
    u: Array
    w: Array
    s: Array
    lam: Array
    dy: Array
    du: Array


def xyz(vector: Any) -> dict[str, float]:
    """A vector as the file writes it."""
    return dict(zip("xyz", map(float, vector), strict=True))


def keys(times: Any, values: Any, **fields: Any) -> dict[str, Any]:
    """Keys of vectors over time as the file writes them."""
    return {"times": list(map(float, times)), "values": [xyz(value) for value in values], **fields}


def thing(
    points: Any,
    springs: Any = (),
    triangles: Any = (),
    mass: Any = 0.1,
    stiffness: Any = 10.0,
    fixed: Any = (),
    **fields: Any,
) -> dict[str, Any]:
    """An object from its points, vertex pairs and triples; `fixed` lists the fixed vertices; no drag, no damping."""
    n, count = len(points), len(springs)
    made = {
        "vertPos": [xyz(point) for point in points],
        "vertIsFixed": [i in fixed for i in range(n)],
        "vertMass": np.broadcast_to(mass, n).tolist(),
        "springs": [int(end) for pair in springs for end in pair],
        "springStiffness": np.broadcast_to(stiffness, count).tolist(),
        "triangles": [int(corner) for triple in triangles for corner in triple],
        "dragCoefficient": 0.0,
        "damping": 0.0,
        "optimizationSettings": "nn",
    }
    return {**made, **fields}


def chain(n, settings, **fields):
    """n vertices in a row, masses 1 … n, stiffnesses 10, 20 …"""
    return thing(
        [(i, 0, 0) for i in range(n)],
        [(i, i + 1) for i in range(n - 1)],
        mass=1.0 + np.arange(n),
        stiffness=10.0 * (1 + np.arange(n - 1)),
        optimizationSettings=settings,
        **fields,
    )


def ball(centre: Any, radius: float) -> dict[str, Any]:
    """A sphere collider."""
    return {"type": 1, "pos": xyz(centre), "rot": xyz((0, 0, 0)), "scale": xyz([2 * radius] * 3)}


def scene(*objects: dict[str, Any], **fields: Any) -> Scene:
    """A loaded scene of the given objects; `windVel` and `colliders` among the fields."""
    return clothfit.scene.scene.load(document(*objects, **fields))


def system(*objects: dict[str, Any], **fields: Any) -> System:
    """The System of the first object of such a scene."""
    return build(scene(*objects, **fields), 0)


def full(nx: int = 3, ny: int = 3, fixed: Any = (), **fields: Any) -> System:
    """A cloth with every force on it: springs, damping, drag, wind, and a sphere with some vertices well inside it."""
    made = {"windVel": xyz((3, 1, -2)), "colliders": [ball((1.0, -0.3, 1.0), 0.8)], **fields}
    held = [i in fixed for i in range(nx * ny)]
    return system(cloth(nx, ny, vertIsFixed=held, dragCoefficient=0.4, damping=0.7), **made)


def gentle(
    method: str = "implicit", newton: int = 1, nx: int = 3, ny: int = 3, own: Mapping[str, Any] | None = None,
    **fields: Any,
) -> System:  # fmt: skip
    """A cloth with every force on it, heavy enough for all three schemes, two corners fixed, resting on a sphere; `own`
    are fields of the object.
    """
    mass = [0.1 + 0.01 * i for i in range(nx * ny)]
    one = cloth(nx, ny, vertMass=mass, dragCoefficient=0.4, damping=0.7, **(own or {}))
    made = {"windVel": xyz((3, 1, -2)), "colliders": [ball((1.0, -0.75, 1.0), 0.8)], "delta": 0.005, **fields}
    return system(one, integrationMethod=METHODS[method], forwardSubSteps=newton, **made)


def pendulum(method: str, h: float, alpha: float = 0.8, k: float = 30.0, m: float = 0.5) -> System:
    """A mass on a vertical spring below a fixed vertex, at rest length 1 m at the start."""
    one = thing([(0, 0, 0), (0, -1, 0)], [(0, 1)], mass=m, stiffness=k, fixed=[0], damping=alpha)
    return system(one, integrationMethod=METHODS[method], delta=h)


def of_air(system: System) -> System:
    """The system with the other law of the air, and the drag of a plate."""
    return system._replace(faces=system.faces._replace(quadratic=True, drag=np.array([1.2])))


def unbound(system: System, **changes: Any) -> System:
    """The system without weight, and with other `changes` in its vertices."""
    return system._replace(vertex=system.vertex._replace(gravity=np.zeros(3), **changes))


def state(system: System, name: str, seed: int = 1) -> State:
    """A state at rest, stretched, compressed or random; all of them but the first out of plane and moving."""
    rng = np.random.default_rng(seed)
    x0 = system.x0
    y, u, w, s, lam, dy, du = rng.normal(size=(7, *x0.shape))
    middle = x0.mean(axis=0)
    noise = 0.05 * y
    points = {
        "rest": x0.copy(),
        "random": x0 + 4 * noise,
        "stretched": middle + 1.6 * (x0 - middle) + noise,
        "compressed": middle + 0.5 * (x0 - middle) + noise,
    }
    still = 0.0 if name == "rest" else 1.0
    return State(points[name], still * u, w, 0.02 * s, lam, dy, du)


def parts(system: System) -> dict[str, tuple[Any, Any]]:
    """Each force's module and constants by name."""
    return {
        "vertex": (vertex, system.vertex),
        "springs": (springs, system.springs),
        "wind": (wind, system.faces),
        "spheres": (spheres, system.spheres),
        "colliders": (contact, system.colliders),
    }


def direction(system: System, seed: int = 2) -> Elements:
    """A random change of every kind, relative to its values; of velocities at rest, and of 0, of size 1."""
    rng = np.random.default_rng(seed)
    values = all_elements(system)
    return Elements(*(np.where(value == 0, 1.0, value) * rng.normal(size=value.shape) for value in values))


def shifted(system: System, change: Elements, t: float) -> System:
    """The system with all its values changed by t · change."""
    pairs = zip(all_elements(system), change, strict=True)
    return with_elements(system, Elements(*(value + t * d if len(d) else value[:0] for value, d in pairs)))


def nothing(system: System) -> Elements:
    """Zeros of every kind, to add a gradient to."""
    return zeros(system, KINDS)


def product(gradient: Elements, change: Elements) -> float:
    """Σ gradient · change over all kinds that both have."""
    pairs = zip(gradient, change, strict=True)
    return float(sum(np.vdot(g, d) for g, d in pairs if len(g) and len(d)))


def total_force(module: Any, force: Any, y: Array, u: Array) -> Array:
    """f(y, u), (n, 3), N."""
    f = np.zeros_like(y)
    module.add_force(force, y, u, f)
    return f


def damping(module: Any, force: Any, y: Array, u: Array, d: Array) -> Array:
    """D(y, u) d, (n, 3); zero for a force that has no D."""
    out = np.zeros_like(y)
    getattr(module, "add_damping", lambda *_: None)(force, y, u, 1.0, d, out)
    return out


def step_terms(
    system: System, module: Any, force: Any, y: Array, u: Array, ahead: bool = False
) -> tuple[sparse.BlockMatrix, Array]:
    """What the force adds to the step: −h² K − h D as a matrix, and h (f − D u), − h² K u with `ahead`."""
    A, b = sparse.zeros(system.pattern, len(y)), np.zeros_like(y)
    module.add_step(force, y, u, system.h, ahead, A, b)
    return A, b


def times(A: sparse.BlockMatrix, x: Array) -> Array:
    """A x, (n, 3)."""
    out = np.zeros_like(x)
    sparse.multiply(A, x, out)
    return out


def model(system: System, module: Any, force: Any, at: State) -> Array:
    """h F(w) of one force from the terms of the step: −A s / h = h K s + D s, hence the D (h w − s).

    For a system without fixed vertices: their columns are not in A.
    """
    A, b = step_terms(system, module, force, at.y, at.u)
    return b - times(A, at.s) / system.h + damping(module, force, at.y, at.u, system.h * at.w - at.s)


def pushforward(system: System, module: Any, force: Any, at: State, change: Elements) -> Array:
    """h dF(w) of one force, (n, 3)."""
    out = np.zeros_like(at.y)
    module.add_pushforward(force, at.y, at.u, at.w, at.s, at.dy, at.du, change, system.h, out)
    return out


def pushforward_error(system: System, name: str, at: State) -> float:
    """Relative difference between a force's add_pushforward and central differences of its step model."""
    module, force = parts(system)[name]
    change = direction(system)
    if name == "colliders":  # which a step knows by where it leads from its beginning
        at = at._replace(s=system.h * at.w)
    t = 1e-5

    def moved(t: float) -> Array:
        point = at._replace(y=at.y + t * at.dy, u=at.u + t * at.du)
        return model(system, module, parts(shifted(system, change, t))[name][1], point)

    measured = (moved(t) - moved(-t)) / (2 * t)
    return relative(pushforward(system, module, force, at, change), measured)


def transpose_error(system: System, name: str, at: State) -> float:
    """Dot-product test between a force's add_pullback and add_pushforward, relative to the sum of absolute products."""
    module, force = parts(system)[name]
    change = direction(system)
    grad = nothing(system)
    gy, gu = np.zeros_like(at.y), np.zeros_like(at.y)
    module.add_pullback(force, at.y, at.u, at.w, at.s, at.lam, system.h, grad, gy, gu)
    out = pushforward(system, module, force, at, change)
    back = np.vdot(gy, at.dy) + np.vdot(gu, at.du) + product(grad, change)
    size = np.abs(at.lam * out).sum()
    return float(abs(np.vdot(at.lam, out) - back) / (size or 1.0))


def relative(a: Array, b: Array) -> float:
    """|a − b| / |b|."""
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def rotation(axis: Any, angle: float) -> Array:
    """Rotation matrix about `axis` by `angle` (Rodrigues)."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def placed(system: System, turn: Array, shift: Array) -> System:
    """The whole system turned, then shifted: cloth, wind and spheres, not the weight."""
    return system._replace(
        x0=np.ascontiguousarray(system.x0 @ turn.T + shift),
        faces=system.faces._replace(wind=turn @ system.faces.wind),
        spheres=system.spheres._replace(centre=np.ascontiguousarray(system.spheres.centre @ turn.T + shift)),
    )


def dense_forces(system: System, x: Array, v: Array) -> tuple[Array, Array, Array]:
    """f (n, 3), K and D (3n, 3n) of the scene format, written down again with NumPy for comparison; K of a clamped
    system has no push sideways.
    """
    n = len(x)
    alpha, m = system.vertex.damping[0], system.vertex.mass
    f = m[:, None] * (system.vertex.gravity - alpha * v)
    K, D = np.zeros((n, n, 3, 3)), np.zeros((n, n, 3, 3))
    D[range(n), range(n)] = -alpha * m[:, None, None] * np.eye(3)
    for (a, b), rest, k in zip(system.springs.ends, system.springs.rest, system.springs.stiffness, strict=True):
        e = x[a] - x[b]
        length = np.linalg.norm(e)
        d = e / length
        pull = -k * (length - rest) * d - alpha / 2 * k * (d @ (v[a] - v[b])) * d
        rho, cap, bend = rest / length, system.springs.cap, system.springs.bend
        left = cap - rho
        rho = rho if left >= bend else cap - max(left, 0.0) ** 2 * (2 * bend - left) / bend**2 if bend else cap
        block_k = -k * ((1 - rho) * np.eye(3) + rho * np.outer(d, d))
        block_d = -alpha / 2 * k * np.outer(d, d)
        for matrix, block in ((K, block_k), (D, block_d)):
            matrix[a, a] += block
            matrix[b, b] += block
            matrix[a, b] -= block
            matrix[b, a] -= block
        f[a] += pull
        f[b] -= pull
    for corners in system.faces.corners:
        a, b, c = x[corners]
        normal = np.cross(b - a, c - a)
        kappa = system.faces.drag[0] * np.linalg.norm(normal) / 2 / 3
        if system.faces.quadratic:
            N, w = normal / np.linalg.norm(normal), system.faces.wind - v[corners].mean(axis=0)
            along, across = np.outer(N, N), np.eye(3) - np.outer(N, N)
            own, rub = (np.sqrt(speed**2 + 1e-6) for speed in (N @ w, np.linalg.norm(w)))
            f[corners] += 0.6 * kappa * (abs(N @ w) * along + 0.02 * np.linalg.norm(w) * across) @ w
            D[corners, corners] -= 0.6 * kappa * (2 * own * along + 0.02 * rub * across)
            continue
        for i in corners:
            f[i] += kappa * normal * (normal @ (system.faces.wind - v[corners].mean(axis=0)))
            D[i, i] -= kappa * np.outer(normal, normal)
    for centre, radius in zip(system.spheres.centre, system.spheres.radius, strict=True):
        for i in range(n):
            distance = np.linalg.norm(x[i] - centre)
            outward = (x[i] - centre) / distance
            inside = float(distance < radius)
            f[i] += inside * 1000 * (radius - distance) * outward
            K[i, i] -= inside * 1000 * np.outer(outward, outward)
    flat = (0, 2, 1, 3)
    return f, K.transpose(flat).reshape(3 * n, 3 * n), D.transpose(flat).reshape(3 * n, 3 * n)


def dense_matrix(A: sparse.BlockMatrix) -> Array:
    """A as a dense (3n, 3n) array, block by block."""
    n = len(A.diagonal) - 1
    full = np.zeros((n, n, 3, 3))
    for r, i in enumerate(A.order):
        full[i, i] = square(A.diagonal[i])
        for slot in range(A.row[r], A.row[r + 1]):
            full[i, A.column[slot]] = full[A.column[slot], i] = square(A.upper[slot])
    return full.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n)


def square(block: Array) -> Array:
    """The symmetric 3×3 matrices of blocks (…, 8) as they are stored."""
    xx, xy, xz, yz, zz, _, yy, _ = np.moveaxis(block, -1, 0)
    return np.moveaxis(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), (0, 1), (-2, -1))


def stored(matrix: Array) -> Array:
    """Symmetric 3×3 matrices (…, 3, 3) as blocks (…, 8)."""
    return matrix[..., [0, 0, 0, 1, 2, 0, 1, 1], [0, 1, 2, 2, 2, 1, 1, 2]]


def sheet(settings="nn", nx=3, ny=3, **fields):
    """A moving cloth whose springs are a little too short, in the air."""
    n, springs = nx * ny, len(cloth(nx, ny)["springStiffness"])
    rng = np.random.default_rng(21)
    made = {
        "vertMass": [0.05 + 0.005 * i for i in range(n)],
        "dragCoefficient": 0.4,
        "damping": 0.3,
        "optimizationSettings": settings,
        "vertVel": [xyz(v) for v in rng.normal(size=(n, 3))],
        "springRestLength": rng.uniform(0.8, 0.95, springs).tolist(),
    }
    return cloth(nx, ny, **{**made, **fields})
