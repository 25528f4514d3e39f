"""The comparison of a motion with a target: values against their definition, derivatives against differences."""

import numpy as np
import pytest
from helpers.costs import cost, cost_and_derivative, jacobian, residual
from helpers.physics import scene
from helpers.scenes import cloth
from scipy.optimize import least_squares

from clothfit import InvalidInput, Motion
from clothfit.engine.system import build
from clothfit.objective.comparison import OBJECTIVES, Comparison, Loss, objective_weights
from clothfit.objective.target import target

RNG = np.random.default_rng(8)
DELTA = 0.02
SYSTEM = build(scene(cloth(3, 2)), 0)
N = len(SYSTEM.x0)
STEPS = 8
OFF_GRID = DELTA * np.arange(10) * 0.77  # uniform, so that a spectrum takes it as well
RANDOM = RNG.bit_generator.state
LOSSES = [Loss(), Loss("soft_l1", 0.05), Loss("huber", 0.05)]
MIXED = {"position": 2.0, "velocity": 0.01, "edge-length": 0.5, "spectrum": 1.5}
EACH = [*({name: 1.0} for name in OBJECTIVES), {"position": 2.0}, MIXED]


@pytest.fixture(autouse=True)
def _the_same_numbers_in_every_test():
    """An amplitude near 0 by chance would spoil a difference quotient."""
    RNG.bit_generator.state = RANDOM


def states(count=STEPS + 1, size=0.1):
    return SYSTEM.x0 + size * RNG.normal(size=(count, N, 3))


def goal(times=None, seen=None, weights=None):
    """A random target; `seen` and `weights` (F, n)."""
    times = DELTA * np.arange(STEPS + 1) if times is None else np.asarray(times)
    return target(Motion(states(len(times)), times, (N,), seen, weights=weights), 0, DELTA)


def compared(*given, objective=None, loss=None, **fields):
    return Comparison(goal(*given, **fields), SYSTEM, objective, loss)


def partly(frames=STEPS + 1):
    return RNG.random((frames, N)) < 0.7


def throughout(frames):
    """Some vertices seen always, as a spectrum needs, some sometimes."""
    return partly(frames) | (np.arange(N) < 4)


def captured(objective, loss=None):
    """Everything a capture can have: times off the steps, gaps, weights."""
    seen = throughout(len(OFF_GRID))
    return compared(OFF_GRID, seen, RNG.uniform(0.5, 2, seen.shape), objective=objective, loss=loss)


# --- positions


def test_the_cost_is_the_sum_of_squared_distances():
    made, x = compared(), states()
    value, derivative = cost_and_derivative(made, x)
    gap = x - made.goal.positions
    assert abs(value - (gap**2).sum()) < 1e-14 * value * gap.size  # a rounding per term
    np.testing.assert_array_equal(derivative, 2 * gap)
    assert cost(made, x) == value
    assert made.plain
    assert made.total_weight == len(x) * N


def test_skipped_frames_are_compared_with_their_steps():
    made, x = compared(DELTA * np.array([1, 4])), states()
    derivative = cost_and_derivative(made, x)[1]
    assert made.last_step == 4
    np.testing.assert_array_equal(derivative[[1, 4]], 2 * (x[[1, 4]] - made.goal.positions))
    assert np.abs(np.delete(derivative, [1, 4], axis=0)).max() == 0.0


def test_between_two_steps_the_state_is_on_the_line_between_theirs():
    made, x = compared(DELTA * np.array([1.25, 3.0])), states()
    gap = 0.75 * x[1] + 0.25 * x[2] - made.goal.positions[0]
    value, derivative = cost_and_derivative(made, x)
    assert value == pytest.approx((gap**2).sum() + ((x[3] - made.goal.positions[1]) ** 2).sum(), rel=1e-14)  # rounding
    np.testing.assert_allclose(derivative[1], 1.5 * gap, rtol=1e-10)  # the time is rounded, the gap cancels
    np.testing.assert_allclose(derivative[2], 0.5 * gap, rtol=1e-10)
    assert np.abs(derivative[[0, 4, 5]]).max() == 0.0


def total(comparisons, x):
    values, derivatives = zip(*(cost_and_derivative(made, x) for made in comparisons), strict=True)
    return sum(values), sum(derivatives)


def test_what_was_not_observed_does_not_count():
    seen = partly()
    made, x = compared(seen=seen), states()
    value, derivative = cost_and_derivative(made, x)
    gap = np.where(seen[:, :, None], x - made.goal.positions, 0)
    np.testing.assert_array_equal(derivative, 2 * gap)
    assert abs(value - (gap**2).sum()) < 1e-14 * value * gap.size  # a rounding per term


def test_a_weight_is_that_many_frames():
    one = goal()
    counts = RNG.integers(0, 4, one.observed.shape).astype(float)
    weighted = one._replace(observed=counts > 0, weights=counts)
    repeated = [one._replace(observed=counts > k) for k in range(3)]
    x = states()
    found = cost_and_derivative(Comparison(weighted, SYSTEM), x)
    expected = total([Comparison(each, SYSTEM) for each in repeated], x)
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13)  # another order of summation
    assert Comparison(weighted, SYSTEM).total_weight == counts.sum()


# --- all objectives and losses


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("objective", EACH)
def test_the_target_itself_costs_nothing(objective, loss):
    made = compared(objective=objective, loss=loss)
    value, derivative = cost_and_derivative(made, made.goal.positions.copy())
    assert value == 0.0
    assert np.abs(derivative).max() == 0.0


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("objective", EACH)
def test_the_derivative_is_that_of_the_cost(objective, loss):
    made, x = captured(objective, loss), states()
    value, derivative = cost_and_derivative(made, x)
    assert cost(made, x) == value
    along, t = RNG.normal(size=x.shape), 1e-7
    measured = (cost(made, x + t * along) - cost(made, x - t * along)) / (2 * t)
    # rounding 1e-15 over 1e-7; the derivative is of the size of the cost, but its terms may cancel
    assert measured == pytest.approx(np.vdot(derivative, along), rel=1e-6, abs=1e-7 * value)


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("objective", EACH)
def test_the_derivative_is_twice_the_pulled_back_residual(objective, loss):
    made, x = captured(objective, loss), states()
    value, derivative = cost_and_derivative(made, x)
    r = residual(made, x)
    back = 2 * jacobian(made, x).T @ r
    np.testing.assert_allclose(back, derivative.ravel(), atol=1e-13 * np.abs(derivative).max())  # rounding
    assert not made.loss.is_linear or value == pytest.approx(r @ r, rel=1e-13)  # rounding


@pytest.mark.parametrize("objective", EACH)
def test_the_jacobian_is_that_of_the_residual(objective):
    made, x = captured(objective), states()
    J = jacobian(made, x).toarray()
    assert J.shape == (len(residual(made, x)), x.size)
    t = 1e-6

    def column(i):
        step = np.zeros(x.size)
        step[i] = t
        ends = [residual(made, x + s * step.reshape(x.shape)) for s in (1, -1)]
        return (ends[0] - ends[1]) / (2 * t)

    measured = np.stack([column(i) for i in range(x.size)], axis=1)
    np.testing.assert_allclose(J, measured, atol=1e-7 * np.abs(J).max())  # t² over squares of lengths of 1e-3 m


def test_a_longer_motion_has_columns_that_are_zero():
    made, x = captured(MIXED), states(STEPS + 4)
    J = jacobian(made, x)
    assert J.shape[1] == x.size
    np.testing.assert_array_equal(J.toarray()[:, : (made.last_step + 1) * 3 * N], jacobian(made, x[:STEPS]).toarray())


def test_a_sum_of_objectives_is_the_sum_of_their_costs():
    wanted, x = goal(), states()
    parts = [cost(Comparison(wanted, SYSTEM, {name: 1.0}), x) for name in MIXED]
    whole = cost(Comparison(wanted, SYSTEM, MIXED), x)
    assert whole == pytest.approx(np.dot(parts, list(MIXED.values())), rel=1e-13)  # rounding


@pytest.mark.parametrize("objective", EACH)
def test_what_is_seen_is_what_the_cost_depends_on(objective):
    seen = np.zeros((STEPS + 1, N), bool)
    seen[0], seen[:, 1], seen[3, 2], seen[3:5, 4] = True, True, True, True
    made, x = compared(seen=seen, objective=objective), states()
    derivative = cost_and_derivative(made, x)[1]
    np.testing.assert_array_equal(made.seen, np.abs(derivative[1:]).max(axis=(0, 2)) > 0)


# --- robust losses


@pytest.mark.parametrize("name", ["linear", "soft_l1", "huber"])
def test_the_losses_are_those_of_scipy(name):
    # residuals that nothing changes, so that SciPy gives the cost of the start; it halves the sum
    r = np.array([0.01, 0.3, -2.0, 50.0])
    same = least_squares(lambda y: r, np.zeros(1), jac=lambda y: np.zeros((4, 1)), loss=name, f_scale=0.2)
    assert Loss(name, 0.2).value(r**2).sum() == pytest.approx(2 * same.cost, rel=1e-12)  # its 1 + z − 1


# --- arguments


@pytest.mark.parametrize(
    ("objective", "message"),
    [
        ("speed", "objective: there is no 'speed'; use position, velocity, edge-length, spectrum"),
        ({}, "objective: none is given; use one or more of position"),
        ({"position": 0.0}, "objective: position: the weight must be above 0 and finite; 0 was given"),
        ({"position": 1.0, "velocity": np.nan}, "objective: velocity: the weight must be above 0 and finite; nan"),
        ({"velocity": np.inf}, "objective: velocity: the weight must be above 0 and finite; inf was given"),
    ],
)
def test_objectives_that_cannot_be_are_refused(objective, message):
    with pytest.raises(InvalidInput) as caught:
        objective_weights(objective)
    assert str(caught.value).startswith(message)
