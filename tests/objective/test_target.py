"""Which states the frames of a target are compared with."""

import numba
import numpy as np
import pytest
from helpers.physics import METHODS, scene
from helpers.scenes import cloth

from clothfit import InvalidMotion, Motion
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.motion.times import frame_places, interpolation, snapped
from clothfit.objective.target import sample, target

RNG = np.random.default_rng(21)
DELTA = 0.02


def motion(times, observed=None, weights=None):
    times = np.asarray(times, float)
    return Motion(RNG.normal(size=(len(times), 5, 3)), times, (2, 3), observed, "walk.npz", weights=weights)


ENDS = {
    (0, 2, 5): [(None, 3, 5), (5, 3, 5), (4, 2, 2), (2, 2, 2), (0, 1, 0)],
    (0.5, 1.25, 1.75, 2.5): [(None, 4, 3), (3, 4, 3), (2, 3, 2), (1, 1, 1), (0, 0, 0)],  # which need the step after
}
"""Of frames at these steps the last step asked for, how many frames there are, and the last step needed."""


@pytest.mark.parametrize("places", ENDS, ids=str)
def test_a_target_ends_at_the_last_step_asked_for(places):
    for last, frames, needed in ENDS[places]:
        goal = target(motion(DELTA * np.array(places)), 0, DELTA, last)
        assert (goal.step.tolist(), goal.last_step) == ([int(place) for place in places[:frames]], needed)
        assert (goal.positions.shape, goal.observed.shape) == ((frames, 2, 3), (frames, 2))


def test_times_in_single_precision_are_multiples_of_the_step():
    times = (np.float32(DELTA) * np.arange(100, dtype=np.float32)).astype(float)
    step, fraction = frame_places(motion(times), DELTA)
    assert step.tolist() == list(range(100))
    assert not fraction.any()


def test_places_split_into_steps_and_fractions():
    step, fraction = snapped(np.array([-0.0005, 0.0, 0.9995, 1.0005, 1.25, 2.998, 7.75]))
    assert step.tolist() == [0, 0, 1, 1, 1, 2, 7]
    np.testing.assert_allclose(fraction, [0, 0, 0, 0, 0.25, 0.998, 0.75], atol=1e-15)  # rounding


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([-0.02, 0], "walk.npz: times[0]: -0.02 s is before the start, which is at 0 s"),
        ([0, 1e9], "walk.npz: times[1]: 1e+09 s is too many steps away"),
    ],
)
def test_times_that_no_simulation_reaches_are_refused(times, message):
    with pytest.raises(InvalidMotion) as caught:
        frame_places(motion(times), DELTA)
    assert str(caught.value) == message


def test_what_has_no_weight_is_not_observed():
    weights = np.ones((3, 5))
    weights[1, 3] = 0.0
    goal = target(motion(DELTA * np.arange(3), None, weights), 1, DELTA)
    assert np.argwhere(~goal.observed).tolist() == [[1, 1]]
    assert goal.weights[1].tolist() == [1, 0, 1]


def test_seen_is_what_is_observed_after_the_start():
    seen = np.zeros((3, 5), bool)
    seen[0, 2] = seen[1, 3] = seen[2, 0] = True
    goal = target(motion([0.0, 0.001, 0.02], seen), 1, DELTA)
    assert goal.seen.tolist() == [False, True, False]


def test_the_matrix_and_the_sample_agree():
    goal = target(motion([0.001, 0.004, 0.02, 0.031, 0.0599999]), 1, DELTA)
    x = RNG.normal(size=(6, 3, 3))
    expected = [np.interp(goal.places, np.arange(6), column) for column in x.reshape(6, 9).T]
    found = sample(goal, x)
    np.testing.assert_allclose(found.reshape(5, 9), np.transpose(expected), atol=1e-15)  # rounding
    matrix = interpolation(goal.step, goal.fraction, 6).toarray()
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, rtol=1e-15)  # rounding
    np.testing.assert_allclose((matrix @ x.reshape(6, 9)).reshape(5, 3, 3), found, atol=1e-15)


@pytest.mark.parametrize("method", ["symplectic", "implicit"])
def test_within_a_step_the_velocity_is_the_one_after_it(method):
    made = scene(cloth(3, 3), integrationMethod=METHODS[method], delta=0.005)
    memory, _ = rollout(build(made, 0), 4, 1e-12)
    seen = Motion(np.zeros((3, 9, 3)), 0.005 * np.array([0.3, 2.6, 3.1]), (9,))
    found = sample(target(seen, 0, 0.005), memory.x)
    for s, step, fraction in zip(found, (0, 2, 3), (0.3, 0.6, 0.1), strict=True):
        np.testing.assert_allclose(s, memory.x[step] + fraction * 0.005 * memory.w[step, 0], atol=1e-15)  # rounding


def test_the_order_in_memory_of_a_motion_makes_no_difference_to_the_types():
    """Else code would be compiled for each order."""
    plain = motion(DELTA * np.arange(4), np.ones((4, 5), bool), np.full((4, 5), 2.0))
    turned = [np.asfortranarray(array) for array in (plain.positions, plain.observed, plain.weights)]
    other = Motion(turned[0], plain.times, plain.vertex_counts, turned[1], "walk.npz", weights=turned[2])
    types = [[str(numba.typeof(array)) for array in target(m, 0, DELTA)] for m in (plain, other)]
    assert types[0] == types[1]
