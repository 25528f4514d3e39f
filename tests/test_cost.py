"""The cost and its derivative by position, and which frames of a target are compared with which steps."""

import numpy as np
import pytest

from clothfit.cost import cost, cost_and_derivative, frame_steps, target
from clothfit.errors import InvalidMotion
from clothfit.motion import Motion

RNG = np.random.default_rng(8)
DELTA = 0.02


def motion(times, observed=None):
    positions = RNG.normal(size=(len(times), 5, 3))
    return Motion(positions, np.asarray(times, float), (2, 3), observed, "walk.npz")


def every_step(count=4, observed=None):
    return motion(DELTA * np.arange(count), observed)


def test_the_cost_is_the_sum_of_squared_distances():
    made = every_step()
    x = RNG.normal(size=(4, 3, 3))
    gap = x - made.positions[:, 2:]
    value, derivative = cost_and_derivative(x, target(made, 1, DELTA))
    assert abs(value - (gap**2).sum()) < 1e-14 * value * 36  # a rounding per term
    np.testing.assert_array_equal(derivative, 2 * gap)
    assert cost(x, target(made, 1, DELTA)) == value


def test_a_motion_costs_nothing_against_itself():
    made = every_step()
    value, derivative = cost_and_derivative(made.of(0).copy(), target(made, 0, DELTA))
    assert value == 0.0
    assert np.abs(derivative).max() == 0.0


def test_skipped_frames_are_compared_with_their_steps():
    made = motion(DELTA * np.array([1, 4]))
    goal = target(made, 0, DELTA)
    x = RNG.normal(size=(6, 2, 3))
    _, derivative = cost_and_derivative(x, goal)
    assert goal.step.tolist() == [1, 4]
    np.testing.assert_array_equal(derivative[[1, 4]], 2 * (x[[1, 4]] - made.of(0)))
    assert np.abs(derivative[[0, 2, 3, 5]]).max() == 0.0


def test_what_was_not_observed_does_not_count():
    seen = RNG.random((4, 5)) < 0.5
    made = every_step(4, seen)
    made.positions[~seen] = np.nan
    x = RNG.normal(size=(4, 3, 3))
    value, derivative = cost_and_derivative(x, target(made, 1, DELTA))
    gap = np.where(seen[:, 2:, None], x - made.positions[:, 2:], 0)
    np.testing.assert_array_equal(derivative, 2 * gap)
    assert abs(value - (gap**2).sum()) < 1e-14 * value * 36  # a rounding per term


@pytest.mark.parametrize(("last", "steps"), [(None, [0, 2, 5]), (5, [0, 2, 5]), (4, [0, 2]), (2, [0, 2]), (0, [0])])
def test_a_target_ends_at_the_last_step_asked_for(last, steps):
    goal = target(motion(DELTA * np.array([0, 2, 5])), 0, DELTA, last)
    assert goal.step.tolist() == steps
    assert (goal.positions.shape, goal.observed.shape) == ((len(steps), 2, 3), (len(steps), 2))


def test_times_in_single_precision_are_multiples_of_the_step():
    times = (np.float32(DELTA) * np.arange(100, dtype=np.float32)).astype(float)
    assert frame_steps(motion(times), DELTA).tolist() == list(range(100))


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0, 0.03], "walk.npz: times[1]: 0.03 s is not 0 or a multiple of the scene's delta, 0.02 s"),
        ([-0.02, 0], "walk.npz: times[0]: -0.02 s is not 0 or a multiple of the scene's delta, 0.02 s"),
        ([0.02, 0.020001], "walk.npz: times: several frames fall on one step of 0.02 s"),
    ],
)
def test_times_that_fit_no_step_are_refused(times, message):
    with pytest.raises(InvalidMotion) as caught:
        frame_steps(motion(times), DELTA)
    assert str(caught.value) == message
