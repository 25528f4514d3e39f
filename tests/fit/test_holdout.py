"""What is kept out of a fit: it does not touch the fit, and the error over it is that of an evaluation."""


import numpy as np
import pytest
from helpers.marks import compiled
from helpers.scenes import even, trial

from clothfit.base.errors import InvalidInput
from clothfit.fit.estimate import estimate, record_target
from clothfit.fit.holdout import seen, split
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import as_motion
from clothfit.motion.simulate import simulate
from clothfit.objective.experiment import experiments
from clothfit.scene.fit_vector import parameters
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow  # compiles a fit



SCENE = load(trial("Ln", 20))


@pytest.fixture(scope="module")
def noisy():
    return degrade(record_target(SCENE), 1e-3, seed=4)


def rmse_over(found, motion, part):
    """Root mean square distance over the positions (frames, vertices) of `part`, by a simulation of its own."""
    own = simulate(found.scene, len(motion.times), tolerance=1e-10)
    return np.sqrt(((own.positions - motion.positions) ** 2).sum(axis=2)[part].mean())


@compiled
def test_the_last_frames_are_judged_as_an_evaluation_does(noisy):
    found = estimate(SCENE, noisy, holdout=0.25)
    late = np.zeros((20, 16), bool)
    late[15:] = True
    assert (found.holdout.of, found.holdout.fraction, found.holdout.observations) == ("frames", 0.25, 80)
    # two simulations that are solved to 1e-10 each
    assert found.holdout.rmse == pytest.approx(rmse_over(found, noisy, late), rel=1e-6)
    assert found.frames == 15


@compiled
def test_a_fit_without_the_last_frames_is_that_of_a_shorter_target(noisy):
    short = as_motion(SCENE, noisy.positions[:15])
    pair = [estimate(SCENE, noisy, holdout=0.25), estimate(SCENE, short)]
    assert parameters(pair[0].scene).tolist() == parameters(pair[1].scene).tolist()


@compiled
def test_vertices_that_are_kept_out_do_not_touch_the_fit(noisy):
    ((_, kept),) = zip(*split(SCENE, experiments(SCENE, noisy), 0.3, "vertices"), strict=True)
    chosen = seen(kept.motion).any(axis=0)
    spoiled = noisy.positions.copy()
    spoiled[:, chosen] += 1.0
    targets = (noisy, as_motion(SCENE, spoiled))
    pair = [estimate(SCENE, motion, holdout=0.3, holdout_of="vertices") for motion in targets]
    assert parameters(pair[0].scene).tolist() == parameters(pair[1].scene).tolist()
    assert chosen.sum() == 4  # of 14 that are free
    assert not chosen[[0, 3]].any()
    everywhere = np.broadcast_to(chosen, (20, 16))
    assert pair[0].holdout.rmse == pytest.approx(rmse_over(pair[0], noisy, everywhere), rel=1e-6)
    assert pair[0].holdout.observations == 80
    assert pair[1].holdout.rmse > 1.0


@compiled
def test_without_a_target_it_is_the_scenes_own_motion_that_is_split():
    found = estimate(load(even("nG", 10, 3, 3)), holdout=0.5)
    assert found.frames == 5
    assert found.holdout.rmse < 1e-6  # the fit reached 1e-8 over the first half


@pytest.mark.parametrize("of", ["frames", "vertices"])
@pytest.mark.parametrize("fraction", [1e-9, 0.2, 0.5, 1 - 1e-9])
def test_a_split_is_complete_and_leaves_something_on_both_sides(of, fraction):
    positions = np.zeros((20, 16, 3))
    observed = np.random.default_rng(0).random((20, 16)) < 0.7
    motion = as_motion(SCENE, positions, observed=observed, weights=np.arange(16.0))
    given = experiments(SCENE, motion)
    (fitted,), (kept,) = split(SCENE, given, fraction, of)
    own = np.zeros((20, 16), bool)
    own[: len(fitted.motion.times)] = seen(fitted.motion)
    assert not (own & seen(kept.motion)).any()
    np.testing.assert_array_equal(own | seen(kept.motion), seen(motion))
    assert own.any()
    assert seen(kept.motion).any()


def test_frames_beyond_those_that_are_compared_do_not_count():
    given = experiments(SCENE, as_motion(SCENE, np.zeros((50, 16, 3))))
    (fitted,), (kept,) = split(SCENE, given, 0.5, "frames")
    assert len(fitted.motion.times) == 10
    np.testing.assert_array_equal(np.flatnonzero(seen(kept.motion).any(axis=1)), np.arange(10, 20))


def test_the_same_vertices_are_kept_out_of_all_targets():
    one, two = (as_motion(SCENE, np.zeros((count, 16, 3))) for count in (20, 12))
    _, kept = split(SCENE, experiments(SCENE, [one, two]), 0.4, "vertices")
    chosen = [seen(part.motion).any(axis=0).tolist() for part in kept]
    assert chosen[0] == chosen[1]


@pytest.mark.parametrize(
    ("fraction", "of", "message"),
    [
        (0.0, "frames", "holdout must be a fraction above 0 and below 1; 0 was given"),
        (1.0, "frames", "holdout must be a fraction above 0 and below 1; 1 was given"),
        (float("nan"), "vertices", "holdout must be a fraction above 0 and below 1; nan was given"),
        (0.2, "springs", "holdout: there is nothing called 'springs'"),
    ],
)
def test_what_cannot_be_is_refused(fraction, of, message):
    with pytest.raises(InvalidInput, match=message):
        estimate(SCENE, holdout=fraction, holdout_of=of)


def test_too_little_to_split_is_refused():
    two = as_motion(SCENE, np.zeros((2, 16, 3)))
    with pytest.raises(InvalidInput, match="shows 2 frames, too few"):
        split(SCENE, experiments(SCENE, two), 0.2, "frames")
    one = as_motion(SCENE, np.zeros((5, 16, 3)), observed=np.broadcast_to(np.arange(16) == 5, (5, 16)))
    with pytest.raises(InvalidInput, match="too few vertices"):
        split(SCENE, experiments(SCENE, one), 0.2, "vertices")
