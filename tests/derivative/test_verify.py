"""The derivative checks on functions whose derivatives are known: they pass the right ones and find small faults."""

import numpy as np
import pytest
from helpers.physics import ball, scene, xyz
from helpers.scenes import cloth

from clothfit.base.errors import InvalidInput
from clothfit.derivative import verify
from clothfit.derivative.verify import central_difference_error, check, scaled, taylor_order
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import parameters, with_parameters

pytestmark = pytest.mark.slow  # compiles a fit

P = np.array([0.3, -20.0, 1.5])
DIRECTION = P * np.array([0.7, -0.5, 1.0])


def smooth(p):
    return float(np.exp(p[0]) + np.sin(p[1] / 20) * p[2] ** 2 + p[0] * p[2])


def gradient(p):
    return np.array([np.exp(p[0]) + p[2], np.cos(p[1] / 20) / 20 * p[2] ** 2, 2 * np.sin(p[1] / 20) * p[2] + p[0]])


def test_a_right_gradient_has_order_two():
    order = taylor_order(smooth, gradient(P), P, DIRECTION)
    assert 1.9 < order < 2.1


@pytest.mark.parametrize("fault", [1.0, 1e-1, 1e-3, 1e-5])
def test_a_wrong_gradient_has_order_one_somewhere_however_small_the_fault(fault):
    # a ladder of a few halvings from 1e-1 would show an order near 2 for the smaller ones
    assert taylor_order(smooth, (1 + fault) * gradient(P), P, DIRECTION) < 1.5


@pytest.mark.parametrize("entry", [0, 1, 2])
def test_a_fault_in_one_entry_is_found(entry):
    wrong = gradient(P)
    wrong[entry] *= 1.001
    assert taylor_order(smooth, wrong, P, DIRECTION) < 1.9
    assert central_difference_error(smooth, wrong, P, DIRECTION) > 1e-5


def test_the_length_of_the_direction_does_not_matter():
    orders = [taylor_order(smooth, gradient(P), P, scale * DIRECTION) for scale in (1e-8, 1.0, 1e8)]
    np.testing.assert_allclose(orders, orders[0], atol=0.02)  # the same steps but for rounding


def test_noise_hides_the_lower_rungs_and_not_the_verdict():
    noise = np.random.default_rng(11)

    def noisy(p):
        return smooth(p) + 1e-9 * noise.normal()

    assert taylor_order(noisy, gradient(P), P, DIRECTION) > 1.9
    assert taylor_order(noisy, 1.01 * gradient(P), P, DIRECTION) < 1.9


@pytest.mark.parametrize("cost", [lambda p: float(p @ [1, 2, 3]), lambda p: 5.0])
def test_a_cost_that_does_not_curve_cannot_be_checked(cost):
    gradient = np.array([cost(row) - cost(np.zeros(3)) for row in np.eye(3)])
    with pytest.raises(InvalidInput, match=r"only \d of 7 steps stand above rounding, 3 are needed"):
        taylor_order(cost, gradient, P, DIRECTION)


def test_a_cost_that_is_not_finite_cannot_be_checked():
    with pytest.raises(InvalidInput, match="the cost is nan near p"):
        taylor_order(lambda p: float("nan"), gradient(P), P, DIRECTION)
    with pytest.raises(InvalidInput, match="the cost is inf near p"):
        central_difference_error(lambda p: float("inf"), gradient(P), P, DIRECTION)


def test_central_difference():
    # truncation 1e-12, rounding 1e-16 / 1e-6
    assert central_difference_error(smooth, gradient(P), P, DIRECTION) < 1e-9
    wrong = central_difference_error(smooth, 1.001 * gradient(P), P, DIRECTION)
    assert abs(wrong - 1e-3 / 1.001) < 1e-8
    rough = central_difference_error(smooth, gradient(P), P, DIRECTION, step=1e-2)
    assert 1e-7 < rough < 1e-3  # the square of the step
    assert central_difference_error(lambda p: 5.0, np.zeros(3), P, DIRECTION) == 0.0  # of two zeros


def test_a_direction_is_scaled_to_the_parameters():
    assert scaled(np.array([2.0, -10.0, 0.0]), np.array([4.0, 5.0, 1.0])).tolist() == [2.0, 2.5, 0.5]


@pytest.mark.parametrize("direction", [[0, 0, 0], [1, np.nan, 0], [1, np.inf, 0], [1, 1]])
def test_a_direction_that_leads_nowhere_or_has_another_shape_is_refused(direction):
    said = r"direction of shape \(2,\) given, p has \(3,\)" if len(direction) == 2 else "is zero or not finite"
    with pytest.raises(InvalidInput, match=said):
        scaled(P, np.array(direction))


def objective():
    """A small scene against the motion of other parameters."""
    made = scene(
        cloth(3, 2, optimizationSettings="LG"),
        cloth(2, 2, optimizationSettings="nL"),
        optimizationIterations=8,
        windVel=xyz((2, 1, 0)),
        colliders=[ball((1, -0.72, 1), 0.75)],
    )
    truth = with_parameters(made, 1.2 * parameters(made))
    return Objective(made, simulate(truth, tolerance=1e-12)), parameters(made)


def test_all_checks_pass_on_an_objective():
    goal, p = objective()
    before = goal.runs
    report = check(goal, p)
    assert report.passed
    assert 1.9 < report.order < 2.2
    assert report == check(goal, p)
    assert check(goal, p, seed=3).passed
    assert goal.runs is before


class Faulty(Objective):
    """An objective with a gradient that is wrong by one part in a thousand in one entry."""

    def add_pullback(self, run, p, system, memory, by_position, gradient):
        super().add_pullback(run, p, system, memory, by_position, gradient)
        gradient[5] *= 1.001


def test_a_faulty_objective_fails_all_checks():
    goal, p = objective()
    goal.__class__ = Faulty
    report = check(goal, p)
    assert not report.passed
    assert report.order < verify.ORDER
    assert report.difference > verify.DIFFERENCE
    assert report.product > verify.PRODUCT
