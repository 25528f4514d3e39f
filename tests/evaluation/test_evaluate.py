"""Distances between motions and between parameters, against numbers known in advance."""

import numpy as np
import pytest
from helpers.scenes import cloth, document, even, trial

from clothfit.base.errors import InvalidInput
from clothfit.base.limits import FIT_TOLERANCE
from clothfit.evaluation.evaluate import evaluate
from clothfit.motion.degrade import degrade
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow  # compiles a fit

TRUTH = load(even("LG"))


def own_motion(frames=20):
    """The motion of TRUTH as an evaluation solves it."""
    return simulate(TRUTH, frames, FIT_TOLERANCE)


def moved(shift, frames=20, **fields):
    """That motion with a shift of every vertex."""
    motion = own_motion(frames)
    return Motion(motion.positions + np.asarray(shift), motion.times, motion.vertex_counts, **fields)


def test_a_scene_is_at_no_distance_from_itself():
    report = evaluate(TRUTH, TRUTH, horizon=50)
    assert (report.fitted.frames, report.fitted.rmse, report.fitted.max_error) == (20, 0.0, 0.0)
    assert (report.horizon.frames, report.horizon.rmse, report.horizon.max_error) == (50, 0.0, 0.0)
    assert [(d.median_relative_deviation, d.max_relative_deviation) for d in report.parameters] == [(0.0, 0.0)] * 2


def test_the_horizon_is_500_frames_and_the_fitted_frames_are_the_scenes():
    report = evaluate(TRUTH, TRUTH)
    assert (report.fitted.frames, report.horizon.frames) == (20, 500)
    assert evaluate(TRUTH, TRUTH, frames=7, horizon=9).fitted.frames == 7


def test_a_shift_is_the_distance():
    report = evaluate(TRUTH, TRUTH, target=moved((0.3, 0.0, -0.4)))
    # 0.3² + 0.4² = 0.5²; rounding of coordinates of a few metres.
    assert (report.fitted.rmse, report.fitted.max_error) == pytest.approx((0.5, 0.5), rel=1e-12)


def test_the_largest_error_is_that_of_one_vertex_and_the_rmse_that_of_all():
    shift = np.zeros((20, 16, 3))
    shift[4, 9] = (0.0, 2.0, 0.0)
    report = evaluate(TRUTH, TRUTH, target=moved(shift))
    assert report.fitted.max_error == pytest.approx(2.0, rel=1e-12)  # rounding
    assert report.fitted.rmse == pytest.approx(2.0 / np.sqrt(20 * 16), rel=1e-12)


def test_only_what_was_observed_counts():
    seen = np.ones((20, 16), bool)
    seen[:, 3] = False
    shift = np.zeros((20, 16, 3))
    shift[:, 3] = np.nan
    shift[:, 5] = (1.0, 0.0, 0.0)
    report = evaluate(TRUTH, TRUTH, target=moved(shift, observed=seen))
    assert report.fitted.rmse == pytest.approx(np.sqrt(1 / 15), rel=1e-12)  # rounding


def test_skipped_frames_are_compared_at_their_times():
    motion = own_motion(40)
    target = Motion(motion.positions[::3], motion.times[::3], motion.vertex_counts)
    report = evaluate(TRUTH, TRUTH, target=target)
    assert (report.fitted.frames, report.fitted.rmse) == (7, 0.0)  # 0, 3 … 18 are within the first 20
    assert (report.horizon.frames, report.horizon.rmse) == (14, 0.0)


def test_frames_between_steps_are_compared_at_their_times():
    target = degrade(own_motion(40), fps=30)
    report = evaluate(TRUTH, TRUTH, target=target)
    assert (report.fitted.frames, report.horizon.frames) == (12, 24)  # up to 0.38 s and to 0.78 s
    assert report.horizon.max_error < 1e-14  # rounding
    late = Motion(target.positions, target.times + 0.01, target.vertex_counts)
    assert evaluate(TRUTH, TRUTH, target=late).fitted.rmse > 1e-3


def test_a_short_target_ends_the_comparison():
    report = evaluate(TRUTH, TRUTH, target=moved((0.0, 0.1, 0.0), 12))
    assert (report.fitted.frames, report.horizon.frames) == (12, 12)


def test_objects_that_are_not_fitted_do_not_count_unless_none_is():
    fields = {"optimizationIterations": 10}
    first, second, heavy = cloth(3, 3, optimizationSettings="nG"), cloth(3, 3), cloth(3, 3, vertMass=[0.5] * 9)
    truth, other = (load(document(first, made, **fields)) for made in (second, heavy))
    assert evaluate(truth, other, horizon=10).fitted.rmse == 0.0
    plain = [load(document({**first, "optimizationSettings": "nn"}, made, **fields)) for made in (second, heavy)]
    report = evaluate(*plain, horizon=10)
    assert report.fitted.rmse > 1e-3
    assert report.parameters == []


def test_deviations_are_relative_and_of_what_can_be_identified():
    truth = load(trial("LG"))
    p = parameters(truth)
    factors = np.ones(16)
    factors[[0, 3]] = 9.0  # fixed vertices
    factors[[5, 6]] = 1.1, 0.7
    fitted = with_parameters(truth, p * [*factors, 1.5])
    mass, stiffness = evaluate(truth, fitted, horizon=20).parameters
    assert (mass.object, mass.name, mass.mode, mass.count) == (0, "mass", "L", 16)
    assert mass.median_relative_deviation == 0.0
    assert mass.max_relative_deviation == pytest.approx(0.3, rel=1e-12)  # rounding
    assert stiffness.mode == "G"
    # 1e-12 · 25 … 57 N/m: the mean of equal numbers rounds.
    assert stiffness.max_relative_deviation == pytest.approx(0.5, rel=1e-12)


def test_what_nothing_reveals_has_no_deviation():
    truth = load(even("LG", vertIsFixed=[True] * 16))
    report = evaluate(truth, truth, horizon=20)
    assert [(d.median_relative_deviation, d.max_relative_deviation) for d in report.parameters] == [(None, None)] * 2


def test_a_zero_that_was_true_has_no_relative_deviation():
    truth = load(even("nL", springStiffness=[0.0] + [30.0] * 32))
    fitted = with_parameters(truth, [5.0] + [33.0] * 32)
    (found,) = evaluate(truth, fitted, horizon=20).parameters
    assert found.max_relative_deviation == pytest.approx(0.1, rel=1e-12)  # rounding


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (load(even("LG", nx=5)), "have 20 vertices and 43 springs, those of scene 16 vertices and 33 springs"),
        (load(document(*[even("LG")["objects"][0]] * 2)), "its objects have"),
    ],
)
def test_other_objects_are_refused(other, message):
    with pytest.raises(InvalidInput, match=message):
        evaluate(TRUTH, other)


@pytest.mark.parametrize("ratio", [4, 2.5])
def test_a_fitted_scene_with_another_step_is_compared_at_the_times_of_the_other(ratio):
    fitted = TRUTH.with_step(TRUTH.delta / ratio, 200, "bdf2")
    report = evaluate(TRUTH, fitted, frames=11, horizon=21)
    own, goal = simulate(fitted, int(20 * ratio) + 1, FIT_TOLERANCE).positions, own_motion(21).positions
    x = np.array([interpolate(own, ratio * i) for i in range(21)])
    distances = np.linalg.norm(x - goal, axis=2)
    assert (report.fitted.frames, report.horizon.frames) == (11, 21)
    assert report.fitted.rmse == pytest.approx(np.sqrt((distances[:11] ** 2).mean()), rel=1e-9)  # sums in another order
    assert report.horizon.max_error == pytest.approx(distances.max(), rel=1e-9)


def test_a_target_is_compared_between_the_steps_of_the_fitted_scene():
    fitted = TRUTH.with_step(TRUTH.delta / 4, 77)
    motion = simulate(fitted, 77, FIT_TOLERANCE)
    target = Motion(motion.positions[1:54:4], motion.times[1:54:4], motion.vertex_counts)
    # the same numbers; times are multiples of the step but for rounding
    assert evaluate(TRUTH, fitted, target=target).fitted.rmse < 1e-12


@pytest.mark.parametrize("delta", [1e300, 1e307])
def test_a_true_step_of_any_length_leaves_the_frames_of_a_target(delta):
    report = evaluate(TRUTH.with_step(delta, 3), TRUTH, frames=11, target=own_motion(5))
    assert report.fitted.frames == 5
    assert report.fitted.rmse < 1e-12  # the same numbers


def interpolate(x, place):
    """The state at a place between the steps of a motion x (T + 1, n, 3)."""
    below = int(place)
    return x[below] if below == place else (1 - place + below) * x[below] + (place - below) * x[below + 1]


@pytest.mark.parametrize("counts", [{"frames": 1}, {"horizon": 1}, {"frames": 0}, {"horizon": -3}])
def test_too_few_frames_are_refused(counts):
    with pytest.raises(InvalidInput, match="frames must be at least 2 to compare"):
        evaluate(TRUTH, TRUTH, **counts)


def test_a_target_that_shows_nothing_is_refused():
    with pytest.raises(InvalidInput, match="shows no observed vertex"):
        evaluate(TRUTH, TRUTH, target=moved((0, 0, 0), observed=np.zeros((20, 16), bool)))


def test_a_simulation_that_diverges_is_an_exception():
    scene = load(even("nG", integrationMethod=0, springStiffness=[1e5] * 33))
    with pytest.raises(Diverged):
        evaluate(scene, scene)


def test_frames_are_the_third_argument():
    assert evaluate(TRUTH, TRUTH, 7, 9).fitted.frames == 7


def test_a_target_of_other_vertices_is_refused():
    motion = own_motion()
    with pytest.raises(InvalidInput):
        evaluate(TRUTH, TRUTH, target=Motion(motion.positions[:, :12], motion.times, (12,)))
