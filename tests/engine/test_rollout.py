"""Whole motions of small systems against closed forms, symmetries and the order of the schemes."""


import numpy as np
import pytest
from helpers import physics
from helpers.physics import GRAVITY, METHODS, TIGHT, VARIANTS, cloth, gentle, placed, rotation, thing

from clothfit.base.limits import FARTHEST
from clothfit.engine.march import finite
from clothfit.engine.rollout import rollout

ALL = ["explicit", "symplectic", "implicit"]  # with one state before a step; test_bdf2 has more of that with two
ORDERS = pytest.mark.parametrize(("method", "order"), [(name, 1 + (name == "bdf2")) for name in METHODS])


def slope(h, errors):
    """The power of h with which errors fall."""
    return np.polyfit(np.log(h), np.log(errors), 1)[0]


def run(system, steps, tolerance=TIGHT):
    """Positions (steps + 1, n, 3) of a motion that stays finite."""
    memory, good = rollout(system, steps, tolerance)
    assert good == steps
    return memory.x


def at_method(method, *objects, **fields):
    return physics.system(*objects, integrationMethod=METHODS[method], **fields)


# Closed forms ---------------------------------------------------------------------------------------------------------


@ORDERS
def test_a_spring_converges_to_the_continuous_damped_oscillator(method, order):
    m, k, alpha, end = 0.5, 30.0, 0.8, 0.4
    decay = (alpha * m + alpha / 2 * k) / (2 * m)
    omega = np.emath.sqrt(k / m - decay**2)
    start = 0.5 * GRAVITY / k
    exact = (start * np.exp(-decay * end) * (np.cos(omega * end) + decay / omega * np.sin(omega * end))).real
    h = end / np.array([160, 320, 640])
    errors = [abs(run(physics.pendulum(method, step), round(end / step))[-1, 1, 1] + 1 + start - exact) for step in h]
    assert abs(slope(h, errors) - order) < 0.1


@pytest.mark.parametrize("method", ALL)
def test_terminal_velocity_of_a_plate_in_the_air(method):
    one = cloth(3, 3, size=0.5, dragCoefficient=1.2, dragLaw="air", damping=0.0, vertIsFixed=[False] * 9)
    one["vertMass"] = (0.002 * np.bincount(one["triangles"])).tolist()
    x = run(at_method(method, one, delta=0.01), 70)
    # of a face of 1/8 m²: m g = ϱ/2 A c v², reached like tanh(t g / v), of which 2 e^−17 is left; the explicit steps
    # begin to flutter
    speed = np.sqrt(3 * 0.002 * GRAVITY / (0.6 * 0.125 * 1.2))
    np.testing.assert_allclose((x[-2] - x[-1])[:, 1] / 0.01, speed, rtol=1e-6)


def test_a_hanging_chain_comes_to_rest_with_each_tension_the_weight_below():
    n, k = 5, 40.0
    mass = 0.1 + 0.05 * np.arange(n)
    rest = [1.5, 1.0, 0.8, 0.5]
    one = thing([(0, -i, 0) for i in range(n)], [(i, i + 1) for i in range(n - 1)], mass=mass, stiffness=k, fixed=[0])
    x = run(physics.system({**one, "damping": 1.0, "springRestLength": rest}, delta=0.1), 300)
    tension = k * (-np.diff(x[-1, :, 1]) - rest)
    weight = GRAVITY * mass[::-1].cumsum()[::-1][1:]
    np.testing.assert_allclose(tension, weight, rtol=1e-10)  # 40 N/m on lengths of 1 m known to 1e-15; settled to less
    assert np.abs(x[-1] - x[-2]).max() < 1e-13


# Symmetry -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
@pytest.mark.parametrize("weight", [True, False])
def test_a_scene_turned_and_shifted_moves_in_the_same_way(weight, method, newton):
    system = gentle(method, newton) if weight else physics.unbound(gentle(method, newton))
    turn = rotation((0, 1, 0), 0.7) if weight else rotation((1, -2, 0.5), 2.1)  # any will do without weight
    shift = np.array([3.0, -2.0, 5.0])
    x, turned = run(system, 12), run(placed(system, turn, shift), 12)
    assert np.abs(x[-1] - x[0]).max() > 0.01
    np.testing.assert_allclose(turned, x @ turn.T + shift, atol=1e-11)  # roundings of 1e-15, pushed by 1000 N/m


# Bookkeeping ----------------------------------------------------------------------------------------------------------


def test_the_tolerance_bounds_the_error_and_the_log_counts_the_work():
    system = gentle("implicit", 1)
    rough, fine = rollout(system, 5, 1e-3)[0], rollout(system, 5, TIGHT)[0]
    assert 0 < rough.solves[:, 0].sum() < fine.solves[:, 0].sum()
    assert 0 < np.abs(rough.x - fine.x).max() < 1e-2
    assert fine.solves[:, 1].tolist() == [0] * 5


# Divergence -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, FARTHEST, -2 * FARTHEST])
def test_far_and_undefined_positions_count_as_diverged(value):
    x = np.ones((4, 3))
    assert finite(x)
    x[2, 1] = value
    assert not finite(x)
    assert finite(np.full((2, 3), FARTHEST / 4))
    assert not finite(np.full((2, 3), FARTHEST / 2))  # the sum of the coordinates counts
