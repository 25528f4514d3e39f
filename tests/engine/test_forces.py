"""Every force against its formula written down with NumPy, its energy, and its own derivatives, in every state; then
what is special to weight, springs, air and spheres: closed forms, conservation laws, and what has no size.
"""

from functools import cache

import numpy as np
import pytest
from helpers import physics
from helpers.matrices import dense_matrix
from helpers.obstacles import SHAPES, box, ring, touching
from helpers.physics import (
    STATES,
    ball,
    dense_forces,
    full,
    of_air,
    parts,
    relative,
    state,
    step_terms,
    thing,
    times,
    xyz,
)

from clothfit.engine.forces import collider_rows, spheres, springs
from clothfit.engine.system import clamped

whole = cache(lambda: full(colliders=[ball((1.0, -0.3, 1.0), 0.8), ball((0.5, 0.4, 1.5), 0.9)]))
"""A system with all forces; not before a test wants it, as it compiles."""


def alone(system, name):
    """The system without all forces but one."""
    system, name = of_air(system) if name == "air" else system, KIND[name]
    kept = {each: float(each == name) for each in ("vertex", "springs", "wind", "spheres")}
    return system._replace(
        vertex=system.vertex._replace(mass=kept["vertex"] * system.vertex.mass),
        springs=system.springs._replace(stiffness=kept["springs"] * system.springs.stiffness),
        faces=system.faces._replace(drag=kept["wind"] * system.faces.drag),
        spheres=system.spheres._replace(radius=kept["spheres"] * system.spheres.radius),
    )


# --- all forces


@pytest.mark.parametrize("at", STATES)
@pytest.mark.parametrize("name", ["vertex", "springs", "clamped springs", "wind", "air", "spheres"])
def test_forces_matrices_and_right_hand_sides_are_those_of_the_formulas(name, at):
    system = alone(clamped(whole()) if name.startswith("clamped") else whole(), name)
    point, h = state(whole(), at), system.h
    (f, K, D), (module, force) = dense_forces(system, point.y, point.u), parts(system)[KIND[name]]
    (A, b), later = (step_terms(system, module, force, point.y, point.u, ahead) for ahead in (False, True))
    f, u, d = f.ravel(), point.u.ravel(), point.dy.ravel()
    assert max(np.abs(f).max(), np.abs(K).max()) > 0
    for found, expected in (
        (physics.total_force(module, force, point.y, point.u), f),
        (physics.damping(module, force, point.y, point.u, point.dy), D @ d),
        (times(A, point.dy), -(h * h * K + h * D) @ d),
        (b, h * (f - D @ u)),
        (later[1], h * (f - D @ u) - h * h * K @ u),
    ):
        # the same products in another order
        np.testing.assert_allclose(found.ravel(), expected, atol=1e-13 * max(np.abs(expected).max(), 1.0))


@pytest.mark.parametrize("at", STATES)
@pytest.mark.parametrize("name", ["springs", "spheres", *SHAPES, "mesh"])
def test_what_is_stored_has_the_force_as_its_slope(name, at, wobble):
    system = of(name, wobble)
    module, force = parts(system)[KIND.get(name, "colliders")]
    if module is physics.contact:
        force = force._replace(rows=force.rows.copy())
        force.rows[:, collider_rows.LAW, collider_rows.FRICTION] = 0.0
    point, t = state(system, at), 1e-6
    slope = (module.energy(force, point.y + t * point.dy) - module.energy(force, point.y - t * point.dy)) / (2 * t)
    f = physics.total_force(module, force, point.y, 0 * point.u)
    # rounding of some 100 J at 1e-6
    assert -np.vdot(f, point.dy) == pytest.approx(slope, abs=1e-6 * max(np.abs(f).sum(), 1.0))


KIND = {"vertex": "vertex", "springs": "springs", "clamped springs": "springs", "wind": "wind", "spheres": "spheres"}
KIND |= {"air": "wind"}
TOLERANCE = {"vertex": 1e-9, **dict.fromkeys(("springs", "clamped springs", "wind", "air", "spheres"), 1e-7)}
"""Of central differences at 1e-5, where they round and what they leave out of forces that bend over some 0.3 m; those
of colliders bend over 0.1 m and 0.1 m/s.
"""


def of(name, wobble):
    """A system with that force."""
    if name in KIND:
        return clamped(whole()) if name.startswith("clamped") else of_air(whole()) if name == "air" else whole()
    return touching(ring(wobble) if name == "mesh" else SHAPES[name])


CASES = [
    (name, at)
    for name in (*KIND, *SHAPES, "mesh")
    for at in STATES
    # at rest each spring is where its clamping begins, and a cloth is flat on an edge of a collider: kinks
    if at != "rest" or (name in TOLERANCE and not name.startswith("clamped"))
]


@pytest.mark.parametrize(("name", "at"), CASES)
def test_the_pushforward_is_the_derivative_of_the_model(name, at, wobble):
    system = of(name, wobble)
    point = state(system, at)
    if name == "mesh":  # where the step begins, at y, it also knows contacts ahead
        point = point._replace(s=system.h * point.w)
    assert physics.pushforward_error(system, KIND.get(name, "colliders"), point) < TOLERANCE.get(name, 1e-6)
    # rounding of sums of some hundred products
    assert physics.transpose_error(system, KIND.get(name, "colliders"), point) < 1e-12


@pytest.mark.parametrize("name", ["clamped springs", *SHAPES])
def test_the_pullback_is_the_transpose_of_the_pushforward_at_a_kink(name, wobble):
    system = of(name, wobble)
    assert physics.transpose_error(system, KIND.get(name, "colliders"), state(system, "rest")) < 1e-12


SPRING = physics.system(thing([(0, 0, 0), (1, 0, 0)], [(0, 1)], stiffness=20.0, damping=0.5))
LINE = np.array([[0.0, 0, 0], [1, 1, 0], [2, 2, 0]])
THIN = physics.system(thing(LINE, [(0, 1)], [(0, 1, 2)], dragCoefficient=0.5), windVel=xyz((3, 1, -2)))
EMPTY = {
    "a spring of zero length": ("springs", SPRING, np.zeros((2, 3))),
    "a face without area": ("wind", THIN, LINE),
    "a face without area in the air": ("wind", of_air(THIN), LINE),
    "the centre of a sphere": ("spheres", ball((0, 0, 0), 1.0), np.zeros((9, 3))),
    **{f"the centre of a {name}": ("colliders", shape, None) for name, shape in SHAPES.items()},
}


@pytest.mark.parametrize("name", EMPTY)
def test_where_a_direction_is_missing_the_derivatives_stay_finite(name):
    kind, system, y = EMPTY[name]
    system = touching(system) if isinstance(system, dict) else system
    y = np.tile(system.colliders.state[0, collider_rows.PLACE], (9, 1)) if y is None else y
    (module, force), at = parts(system)[kind], state(system, "random")._replace(y=y)
    out = physics.pushforward(system, module, force, at, physics.direction(system))
    A, b = step_terms(system, module, force, at.y, at.u)
    assert all(np.isfinite(array).all() for array in (out, b, A.diagonal))
    assert physics.transpose_error(system, kind, at) < 1e-12
    if kind in ("springs", "wind"):  # which exert nothing there
        f = physics.total_force(module, force, at.y, at.u)
        assert not any(array.any() for array in (f, out, A.diagonal, A.upper, b))


@pytest.mark.parametrize("name", ["vertex", "springs"])
def test_what_damping_takes_is_its_force_along_the_way(name):
    (module, force), at = parts(whole())[name], state(whole(), "random")
    power = np.vdot(physics.damping(module, force, at.y, at.u, at.u), at.w)
    assert module.damping_power(force, at.y, at.u, at.w) == pytest.approx(power, rel=1e-12)


def test_all_forces_of_the_system_are_covered():
    fields = {
        field
        for field, value in full(colliders=[box((0, -9, 0))])._asdict().items()
        if type(value).__module__.startswith("clothfit.engine.forces")
    }
    # those of steps and pairs are in test_applied and test_self_contact
    assert fields - {"applied", "surface", "contact"} == {"vertex", "springs", "faces", "spheres", "colliders"}
    assert len(parts(whole())) == 5


# --- springs


def test_rest_lengths_are_the_lengths_at_the_start():
    expected = [np.linalg.norm(whole().x0[a] - whole().x0[b]) for a, b in whole().springs.ends]
    np.testing.assert_allclose(whole().springs.rest, expected, rtol=1e-15)  # one rounding each
    f = physics.total_force(springs, whole().springs, whole().x0, np.zeros_like(whole().x0))
    assert np.abs(f).max() == 0.0  # the length is computed in the same way as the rest length


@pytest.mark.parametrize("name", STATES)
def test_the_matrix_is_the_true_jacobian_of_the_undamped_force(name):
    at, undamped, t = state(whole(), name), whole().springs._replace(damping=np.zeros(1)), 1e-6
    above, below = (physics.total_force(springs, undamped, at.y + side * t * at.dy, at.u) for side in (1, -1))
    A, _ = step_terms(whole(), springs, undamped, at.y, at.u)
    # differences of some 100 N at 1e-6, truncation 1e-11
    assert relative(times(A, at.dy), -(whole().h**2) * (above - below) / (2 * t)) < 1e-8


@pytest.mark.parametrize("name", STATES[1:])
def test_the_clamped_matrix_has_no_push_sideways_and_the_same_force(name):
    at = state(whole(), name)
    both = [step_terms(whole(), springs, each.springs, at.y, at.u) for each in (clamped(whole()), whole())]
    A, plain = (dense_matrix(each) for each, _ in both)
    np.testing.assert_array_equal(both[0][1], both[1][1])
    safe, least = np.linalg.eigvalsh(A), np.linalg.eigvalsh(plain).min()
    assert safe.min() > -1e-13 * safe.max()  # rounding
    assert (least < safe.min() - 1e-3 * safe.max()) == (name != "stretched")
    assert np.array_equal(A, plain) == (name == "stretched")  # nothing to clamp


@pytest.mark.parametrize("rho", [0.5, 0.949, 0.951, 0.97, 0.999, 1.001, 1.5])
def test_the_derivative_of_the_rounded_clamp(rho):
    rounded, t = whole().springs._replace(cap=1.0, bend=0.05), 1e-6
    low, high = (springs.capped(rounded, rho + sign * t)[0] for sign in (-1, 1))
    hat, bent = springs.capped(rounded, rho)
    assert 0.0 <= hat <= 1.0
    assert bent / rho == pytest.approx((high - low) / (2 * t), abs=1e-8)  # t² times a third derivative of 6/0.05²
    for kink in (0.95, 1.0):  # of which there is none
        before, after = (springs.capped(rounded, kink + side)[1] / (kink + side) for side in (-1e-9, 1e-9))
        assert after == pytest.approx(before, abs=1e-6)  # a second derivative of 4/0.05, over 2e-9


# --- the law "air"

CORNERS = np.array([(0.1, 0, 0), (0.9, 0.2, 0.1), (0.3, 0.7, -0.2)])
AREA = 0.5 * np.linalg.norm(np.cross(CORNERS[1] - CORNERS[0], CORNERS[2] - CORNERS[0]))
AIR = 0.6 * 1.2  # ϱ/2 · c, kg/m³, of a plate


def pushed(points, faces, flow, v=(0, 0, 0)):
    """The forces (n, 3) on such faces where they feel this flow."""
    own = thing(points, [], faces, dragCoefficient=1.2, dragLaw="air")
    plate = physics.system(own, windVel=xyz(np.add(flow, v)))
    moved = np.tile(np.array(v, float), (len(points), 1))
    return physics.total_force(physics.wind, plate.faces, plate.x0, moved)


def test_a_plate_feels_pressure_across_the_flow_and_friction_along_it():
    n = np.cross(CORNERS[1] - CORNERS[0], CORNERS[2] - CORNERS[0]) / (2 * AREA)
    along = (CORNERS[1] - CORNERS[0]) / np.linalg.norm(CORNERS[1] - CORNERS[0])
    for flow, expected in ((3 * n, AIR * AREA * 9 * n), (-3 * n, -AIR * AREA * 9 * n),
                           (3 * along, 0.02 * AIR * AREA * 9 * along)):  # fmt: skip
        found = pushed(CORNERS, [(0, 1, 2)], flow, (1, -2, 0.5))  # only the difference of wind and velocity counts
        np.testing.assert_allclose(found, np.tile(expected / 3, (3, 1)), atol=1e-14)  # sums of some ten terms of 1 N


def test_the_matrix_damps_whatever_the_state_and_is_nearly_the_jacobian_where_all_corners_move_alike():
    system, rng = of_air(whole()), np.random.default_rng(3)
    at = state(system, "random")
    A, _ = step_terms(system, physics.wind, system.faces, at.y, at.u)
    assert np.linalg.eigvalsh(dense_matrix(A)).min() > -1e-14
    # in a flow that is across a plane cloth nothing but the rounding of |·| by 1 mm/s is left out
    plane = system._replace(faces=system.faces._replace(wind=np.array([0.0, 3.0, 0.0])))
    shift, t = np.tile(rng.normal(size=3), (9, 1)), 1e-6
    ends = [physics.total_force(physics.wind, plane.faces, system.x0, sign * t * shift) for sign in (1, -1)]
    found = physics.damping(physics.wind, plane.faces, system.x0, 0 * shift, shift)
    assert relative(found, (ends[0] - ends[1]) / (2 * t)) < 1e-6  # (1 mm/s / 3 m/s)² / 2, and rounding at 1e-6


# --- spheres


def test_which_contacts_begin():
    made = spheres.build([[0.0, 0.0, 0.0]], [1.0])
    y = np.array([[2.0, 0, 0], [2.0, 0, 0], [2.0, 0, 0], [2.0, 0.0, 0], [2.0, 0.9, 0], [2.0, 1.1, 0]])
    u = np.array([[-1.1, 0, 0], [-0.9, 0, 0], [1.1, 0, 0], [-9.0, 0, 0], [-9.0, 0, 0], [-9.0, 0, 0]])
    # also where the way leads through the sphere and out again
    assert [spheres.enters(made, y, u, 1.0, i, 0) for i in range(6)] == [True, False, False, True, True, False]
