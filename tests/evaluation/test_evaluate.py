"""Distances between motions and between parameters, against numbers known in advance."""

import numpy as np
import pytest
from helpers.scenes import cloth, document, even, trial

from clothfit import Diverged, InvalidInput, Motion, degrade, evaluate, load, parameters, simulate, with_parameters
from clothfit.base.limits import FIT_TOLERANCE

pytestmark = pytest.mark.slow  # compiles a fit

TRUTH = load(even("LG"))
ALL = np.s_[:, :]


@pytest.fixture(scope="module")
def motion():
    """The motion of TRUTH as an evaluation solves it."""
    return simulate(TRUTH, 40, FIT_TOLERANCE)


def moved(motion, shift, frames=20, **fields):
    """Its first frames, with a shift of every vertex."""
    return Motion(motion.positions[:frames] + np.asarray(shift), motion.times[:frames], motion.vertex_counts, **fields)


def test_a_scene_is_at_no_distance_from_itself():
    report = evaluate(TRUTH, TRUTH, horizon=50)
    assert (report.fitted.frames, report.fitted.rmse, report.fitted.max_error) == (20, 0.0, 0.0)
    assert (report.horizon.frames, report.horizon.rmse, report.horizon.max_error) == (50, 0.0, 0.0)
    assert [(d.median_relative_deviation, d.max_relative_deviation) for d in report.parameters] == [(0.0, 0.0)] * 2
    report = evaluate(TRUTH, TRUTH)
    assert (report.fitted.frames, report.horizon.frames) == (20, 500)
    assert evaluate(TRUTH, TRUTH, 7, 9).fitted.frames == 7  # the third argument


@pytest.mark.parametrize(
    ("where", "shift", "rmse", "largest"),
    [
        (ALL, (0.3, 0.0, -0.4), 0.5, 0.5),  # 0.3² + 0.4² = 0.5²
        ((4, 9), (0.0, 2.0, 0.0), 2.0 / np.sqrt(20 * 16), 2.0),
        (np.s_[:, 5], (1.0, 0.0, 0.0), np.sqrt(1 / 15), 1.0),
    ],
)
def test_a_shift_is_the_distance_and_only_what_was_observed_counts(motion, where, shift, rmse, largest):
    moves, seen = np.zeros((20, 16, 3)), np.ones((20, 16), bool)
    moves[where] = shift
    if rmse == np.sqrt(1 / 15):
        seen[:, 3], moves[:, 3] = False, np.nan
    report = evaluate(TRUTH, TRUTH, target=moved(motion, moves, observed=seen))
    # rounding of coordinates of a few metres
    assert (report.fitted.rmse, report.fitted.max_error) == pytest.approx((rmse, largest), rel=1e-12)


def test_frames_are_compared_at_their_times_as_far_as_a_target_reaches(motion):
    skipped = Motion(motion.positions[::3], motion.times[::3], motion.vertex_counts)
    report = evaluate(TRUTH, TRUTH, target=skipped)
    assert (report.fitted.frames, report.fitted.rmse) == (7, 0.0)  # 0, 3 … 18 are within the first 20
    assert (report.horizon.frames, report.horizon.rmse) == (14, 0.0)
    between = degrade(motion, fps=30)
    report = evaluate(TRUTH, TRUTH, target=between)
    assert (report.fitted.frames, report.horizon.frames) == (12, 24)  # up to 0.38 s and to 0.78 s
    assert report.horizon.max_error < 1e-14  # rounding
    late = Motion(between.positions, between.times + 0.01, between.vertex_counts)
    assert evaluate(TRUTH, TRUTH, target=late).fitted.rmse > 1e-3
    report = evaluate(TRUTH, TRUTH, target=moved(motion, (0.0, 0.1, 0.0), 12))
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
    factors = np.ones(16)
    factors[[0, 3]] = 9.0  # fixed vertices
    factors[[5, 6]] = 1.1, 0.7
    fitted = with_parameters(truth, parameters(truth) * [*factors, 1.5])
    mass, stiffness = evaluate(truth, fitted, horizon=20).parameters
    assert (mass.object, mass.name, mass.mode, mass.count, stiffness.mode) == (0, "mass", "L", 16, "G")
    assert mass.median_relative_deviation == 0.0
    assert mass.max_relative_deviation == pytest.approx(0.3, rel=1e-12)  # rounding
    # 1e-12 · 25 … 57 N/m: the mean of equal numbers rounds.
    assert stiffness.max_relative_deviation == pytest.approx(0.5, rel=1e-12)
    zero = load(even("nL", springStiffness=[0.0] + [30.0] * 32))  # which has no relative deviation
    (found,) = evaluate(zero, with_parameters(zero, [5.0] + [33.0] * 32), horizon=20).parameters
    assert found.max_relative_deviation == pytest.approx(0.1, rel=1e-12)  # rounding
    held = load(even("LG", vertIsFixed=[True] * 16))  # nothing reveals its values
    report = evaluate(held, held, horizon=20)
    assert [(d.median_relative_deviation, d.max_relative_deviation) for d in report.parameters] == [(None, None)] * 2


@pytest.mark.parametrize("ratio", [4, 2.5])
def test_a_fitted_scene_with_another_step_is_compared_at_the_times_of_the_other(motion, ratio):
    fitted = TRUTH.with_step(TRUTH.delta / ratio, 200, "bdf2")
    report = evaluate(TRUTH, fitted, frames=11, horizon=21)
    own, places = simulate(fitted, int(20 * ratio) + 1, FIT_TOLERANCE).positions, ratio * np.arange(21)
    below = places.astype(int)
    share = (places - below)[:, None, None]
    x = (1 - share) * own[below] + share * own[np.minimum(below + 1, len(own) - 1)]
    distances = np.linalg.norm(x - motion.positions[:21], axis=2)
    assert (report.fitted.frames, report.horizon.frames) == (11, 21)
    assert report.fitted.rmse == pytest.approx(np.sqrt((distances[:11] ** 2).mean()), rel=1e-9)  # sums in another order
    assert report.horizon.max_error == pytest.approx(distances.max(), rel=1e-9)
    target = Motion(own[1:38:4], TRUTH.delta / ratio * np.arange(1, 38, 4), motion.vertex_counts)
    assert evaluate(TRUTH, fitted, target=target).fitted.rmse < 1e-12  # the same numbers, at its own steps


@pytest.mark.parametrize("delta", [1e300, 1e307])
def test_a_true_step_of_any_length_leaves_the_frames_of_a_target(motion, delta):
    report = evaluate(TRUTH.with_step(delta, 3), TRUTH, frames=11, target=moved(motion, 0.0, 5))
    assert report.fitted.frames == 5
    assert report.fitted.rmse < 1e-12  # the same numbers


def test_what_cannot_be_compared_is_refused(motion):
    for counts in ({"frames": 1}, {"horizon": 1}, {"frames": 0}, {"horizon": -3}):
        with pytest.raises(InvalidInput, match="frames must be at least 2 to compare"):
            evaluate(TRUTH, TRUTH, **counts)
    with pytest.raises(InvalidInput, match="have 20 vertices and 43 springs, those of scene 16 vertices and 33"):
        evaluate(TRUTH, load(even("LG", nx=5)))
    with pytest.raises(InvalidInput, match="its objects have"):
        evaluate(TRUTH, load(document(*[even("LG")["objects"][0]] * 2)))
    with pytest.raises(InvalidInput, match="shows no observed vertex"):
        evaluate(TRUTH, TRUTH, target=moved(motion, 0.0, observed=np.zeros((20, 16), bool)))
    with pytest.raises(InvalidInput):
        evaluate(TRUTH, TRUTH, target=Motion(motion.positions[:, :12], motion.times, (12,)))
    wild = load(even("nG", integrationMethod=0, springStiffness=[1e5] * 33))
    with pytest.raises(Diverged):
        evaluate(wild, wild)
