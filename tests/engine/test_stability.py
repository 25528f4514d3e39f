"""How long explicit and symplectic steps may be: frequencies with closed forms, limits, growth, warnings."""

from itertools import product
from math import inf, pi, sin, sqrt

import numpy as np
import pytest
from helpers import physics
from helpers.physics import scene, thing, xyz

from clothfit.engine.stability import ACCURACY, drag, frequency, growth, limit, longest_step, warning
from clothfit.engine.system import EXPLICIT, IMPLICIT, SYMPLECTIC, build, clamped

pytestmark = pytest.mark.slow  # compiles a fit

K, M = 800.0, 0.5  # ω = 40 rad/s
SPRING = {"mass": M, "stiffness": K, "fixed": [0]}


def one_spring(**fields):
    made = dict(SPRING, **{name: fields.pop(name) for name in ("damping", "fixed") if name in fields})
    return scene(thing([(0, 0, 0), (0, -1, 0)], [(0, 1)], **made), gravity=xyz((0, 0, 0)), **fields)


def near(found, exact):
    """Whether an estimate of ω, which comes from below, is as good as it should be."""
    return (1 - ACCURACY) * exact**2 <= found**2 <= (1 + 1e-12) * exact**2


# --- the largest frequency


def test_one_spring():
    assert frequency(build(one_spring(), 0)) == pytest.approx(sqrt(K / M), rel=1e-12)
    assert frequency(build(one_spring(fixed=[]), 0)) == pytest.approx(sqrt(2 * K / M), rel=1e-12)
    assert limit(build(one_spring(fixed=[0, 1], integrationMethod=0), 0)) == (0.0, inf, 1.0)  # what is held


@pytest.mark.parametrize("count", [2, 10, 200])
def test_a_chain_between_two_walls(count):
    points = [(i, 0, 0) for i in range(count + 2)]
    links = [(i, i + 1) for i in range(count + 1)]
    made = physics.system(thing(points, links, mass=M, stiffness=K, fixed=[0, count + 1]))
    exact = 2 * sqrt(K / M) * sin(count * pi / (2 * (count + 1)))
    assert near(frequency(made), exact)
    assert near(frequency(made, turned=True), exact)  # all springs have one direction


@pytest.mark.parametrize("name", physics.STATES)
@pytest.mark.parametrize("fixed", [(), (0, 4)])
def test_a_cloth_against_dense_eigenvalues(name, fixed):
    made = physics.full(4, 4, fixed)  # a sphere holds some of its vertices
    made = made._replace(x0=physics.state(made, name).y)
    _, stiff, _ = physics.dense_forces(clamped(made), made.x0, made.v0)
    kept = np.repeat(made.vertex.free, 3)
    root = np.sqrt(np.repeat(made.vertex.mass, 3)[kept])
    exact = np.linalg.eigvalsh(-stiff[np.ix_(kept, kept)] / np.outer(root, root))[-1]
    assert near(frequency(made), sqrt(exact))


def test_springs_of_any_direction_stay_below_the_other_estimate():
    made = physics.full(5, 5)._replace(spheres=physics.system().spheres)
    bound = frequency(made, turned=True)
    rng = np.random.default_rng(0)
    for size in (0.1, 1.0, 10.0):
        moved = made._replace(x0=made.x0 + size * rng.normal(size=made.x0.shape))
        assert frequency(moved) <= bound * sqrt(1 + ACCURACY)
    line = made._replace(x0=made.x0 * [1.0, 0.0, 0.0] + np.arange(25.0)[:, None] * [1e-3, 0, 0])  # folded together
    assert near(frequency(line), bound)


def test_the_air_of_a_single_face():
    face = thing([(0, 0, 0), (1, 0, 0), (0, 0, 2)], [(0, 1)], [(0, 1, 2)], mass=M, dragCoefficient=0.7)
    made = physics.system(face)
    _, _, damped = physics.dense_forces(made, made.x0, made.v0)
    assert drag(made) == pytest.approx(np.linalg.eigvalsh(-damped)[-1] / M, rel=1e-12)
    made = physics.of_air(physics.system(face, windVel=physics.xyz((0, 3, 0))))  # across the face
    _, _, damped = physics.dense_forces(made, made.x0, made.v0)
    # the matrix rounds |·| by 1 mm/s
    assert drag(made) == pytest.approx(np.linalg.eigvalsh(-damped)[-1] / M, rel=1e-6)


# --- limits and growth of one oscillation


def matrix(method, h, omega, d):
    """What a step makes of (v, x)."""
    kick = np.array([[1 - h * d, -h * omega**2], [0, 1]])
    drift = np.array([[1, 0], [h, 1]])
    return drift @ kick if method == SYMPLECTIC else np.array([[1 - h * d, -h * omega**2], [h, 1]])


OSCILLATORS = list(product([EXPLICIT, SYMPLECTIC], [0.0, 0.3, 30.0, 80.0, 81.0, 500.0], [0.0, 40.0]))


@pytest.mark.parametrize(("method", "d", "omega"), OSCILLATORS)
def test_the_growth_is_the_largest_eigenvalue_and_passes_1_at_the_limit(method, d, omega):
    for h in (1e-3, 0.02, 0.3):
        exact = np.abs(np.linalg.eigvals(matrix(method, h, omega, d))).max()
        assert growth(method, h, omega, d) == pytest.approx(exact, rel=1e-7)  # a double eigenvalue has half the digits
    h = longest_step(method, omega, d, d)
    assert (h == inf) == (omega == d == 0)
    assert (h == 0) == (method == EXPLICIT and d == 0 < omega)  # no explicit step is stable without damping
    if 0 < h < inf:
        assert growth(method, 0.999 * h, omega, d) <= 1 + 1e-12 < growth(method, 1.001 * h, omega, d)


# --- warnings


def test_the_warning_names_limit_and_growth():
    made = one_spring(integrationMethod=SYMPLECTIC, delta=0.06)
    factor = growth(SYMPLECTIC, 0.06, 40.0, 0.0)
    assert warning(made, 99) == (
        "scene: objects[0]: symplectic steps of 0.06 s will not stay stable (the limit is 0.05 s): the fastest "
        f"oscillation, of 40 rad/s, grows {factor:.3g} times per step, 1e{99 * np.log10(factor):.0f} times over 99 "
        "steps; try a smaller delta or integrationMethod 2 (implicit)"
    )
    explicit = warning(one_spring(integrationMethod=EXPLICIT, delta=0.005), 100)
    assert "(without damping they gain energy however short they are)" in explicit
    assert f"grows 1.02 times per step, {1.04**50:.2g} times over 100 steps" in explicit


def test_no_warning_without_need():
    assert warning(one_spring(integrationMethod=IMPLICIT, delta=10.0), 10_000) is None
    assert warning(one_spring(integrationMethod=SYMPLECTIC, delta=0.049), 10_000) is None
    assert warning(one_spring(integrationMethod=EXPLICIT, delta=0.001), 100) is None  # grows by 8 % in all
    assert warning(one_spring(integrationMethod=EXPLICIT, delta=0.001), 10_000) is not None
    assert warning(one_spring(integrationMethod=EXPLICIT, delta=0.001, damping=1.0), 10_000) is None


def test_the_worst_cloth_is_named():
    calm = thing([(0, 0, 0), (0, -1, 0)], [(0, 1)], mass=M, stiffness=1.0, fixed=[0])
    wild = thing([(0, 0, 0), (0, -1, 0)], [(0, 1)], **SPRING)
    assert "objects[1]" in warning(scene(calm, wild, integrationMethod=SYMPLECTIC, delta=0.06), 99)


@pytest.mark.parametrize("method", [EXPLICIT, SYMPLECTIC])
@pytest.mark.parametrize(
    "values",
    [{"stiffness": 1e308}, {"mass": 1e-308}, {"mass": 1e-308, "stiffness": 1e308}, {"damping": 1e308}, {"mass": 1e308}],
)
def test_values_at_the_ends_of_the_numbers_are_no_fault(method, values):
    made = scene(thing([(0, 0, 0), (0, -1, 0)], [(0, 1)], **{**SPRING, **values}), integrationMethod=method)
    text = warning(made, 99)
    assert (text is None) == (values == {"mass": 1e308})
    assert "nan" not in str(text)


def test_air_that_stops_everything_at_once_leaves_no_step():
    wide = [(0, 0, 0), (1e150, 0, 0), (0, 0, 1e150)]
    face = thing(wide, [(0, 1)], [(0, 1, 2)], dragCoefficient=1.0)
    assert limit(physics.system(face, integrationMethod=SYMPLECTIC)).step == 0.0
