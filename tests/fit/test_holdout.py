"""What is kept out of a fit: it does not touch the fit, its error is that of an evaluation, and it judges models."""

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.scenes import even, trial
from helpers.strangers import small

from clothfit import Diverged, InvalidInput, degrade, load, parameters, simulate, with_parameters
from clothfit.fit import hierarchy, holdout
from clothfit.fit.estimate import record_target
from clothfit.fit.holdout import (
    BEATS,
    KEPT_OUT,
    Judged,
    chosen,
    error_of,
    judged,
    nearer,
    parted,
    seen,
    smallest,
    split,
)
from clothfit.motion.motion import as_motion, at_frames
from clothfit.objective.experiment import experiments
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.optimise.status import ModelFit

pytestmark = pytest.mark.slow  # compiles a fit



SCENE = load(trial("Ln", 20))


@pytest.fixture(scope="module")
def noisy():
    return degrade(record_target(SCENE), 1e-3, seed=4)


def rmse_over(found, motion, part):
    """Root mean square distance over the positions (frames, vertices) of `part`, by a simulation of its own."""
    own = simulate(found.scene, len(motion.times), tolerance=1e-10)
    return np.sqrt(((own.positions - motion.positions) ** 2).sum(axis=2)[part].mean())


def test_a_fit_without_the_last_frames_is_that_of_a_shorter_target_and_they_are_judged_as_an_evaluation_does(noisy):
    found, short = estimate(SCENE, noisy, holdout=0.25), estimate(SCENE, as_motion(SCENE, noisy.positions[:15]))
    assert parameters(found.scene).tolist() == parameters(short.scene).tolist()
    late = np.zeros((20, 16), bool)
    late[15:] = True
    assert (found.holdout.of, found.holdout.fraction, found.holdout.observations) == ("frames", 0.25, 80)
    # two simulations that are solved to 1e-10 each
    assert found.holdout.rmse == pytest.approx(rmse_over(found, noisy, late), rel=1e-6)
    assert found.frames == 15
    mean = noisy.positions[:15].mean(axis=0)
    squares = ((noisy.positions[15:] - mean) ** 2).sum(axis=2)
    # 1 mm of noise on what is held, by which a picture may be carried, of some 30 cm
    assert found.holdout.still == pytest.approx(np.sqrt(squares.mean()), rel=2e-3)
    assert not any("kept out" in each for each in found.warnings)


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
    both = [as_motion(SCENE, np.zeros((count, 16, 3))) for count in (20, 12)]
    one, two = (seen(part.motion).any(axis=0) for part in split(SCENE, experiments(SCENE, both), 0.4, "vertices")[1])
    assert one.tolist() == two.tolist()


@pytest.mark.parametrize(
    ("frames", "shown", "of", "message"),
    [(2, None, "frames", "shows 2 frames, too few"), (5, np.arange(16) == 5, "vertices", "too few vertices")],
)
def test_too_little_to_split_is_refused(frames, shown, of, message):
    observed = None if shown is None else np.tile(shown, (frames, 1))
    with pytest.raises(InvalidInput, match=message):
        split(SCENE, experiments(SCENE, as_motion(SCENE, np.zeros((frames, 16, 3)), observed=observed)), 0.2, of)


# --- the choice of a model


ENOUGH, BUDGET = 1e-8, 1000  # as in a fit


# --- of errors that are known


def models(*errors, fitted=None):
    """Models F, R, M and L with these errors on what is kept out, and others on what is fitted."""
    own = errors if fitted is None else fitted
    return [Judged(letter, 1, *pair, 0.0) for letter, *pair in zip("FRML", own, errors, strict=False)]


@pytest.mark.parametrize(
    ("errors", "model"),
    [
        ((1.0,), "F"),
        ((1.0, 1.0, 1.0, 1.0), "F"),
        ((1.0, 1.0 - 0.9 * BEATS, 1.0 - 0.9 * BEATS), "F"),  # not enough better
        ((1.0, 1.0 - 1.1 * BEATS, 1.0 - 1.2 * BEATS), "R"),
        ((1.0, 1.5, 0.5), "M"),  # one between them may be worse
        ((1.0, 0.97, 0.94, 0.925), "R"),  # the first is beaten, though not by the next
        ((4.0, 3.0, 2.0, 1.0), "L"),
        ((1.0, np.inf), "F"),
        ((np.inf, 1.0), "R"),
        ((np.inf, np.inf), "F"),
    ],
)
def test_the_smallest_model_that_no_finer_one_beats(errors, model):
    assert smallest(models(*errors)) == smallest(models(*[None] * len(errors), fitted=errors)) == model
    assert smallest(models(*errors, fitted=np.geomspace(1.0, 0.1, len(errors)))) == model  # what is kept out judges


def test_a_model_that_came_nearer_to_what_was_fitted_is_named():
    hint = nearer(models(0.06, 0.27, fitted=(0.037, 0.025)), "F")
    assert hint.code == "model"
    assert "model R comes to 25 mm on what was fitted, F to 37 mm" in hint.text
    assert "it is no better, 270 mm against 60 mm, so F was chosen; --model R fits it" in hint.text
    assert nearer(models(0.06, 0.02, fitted=(0.037, 0.025)), "R") is None
    assert nearer(models(0.06, 0.06, fitted=(0.037, 0.036)), "F") is None


# --- of a cloth




def target_of(scene, model, values, noise=1e-3):
    """The motion of a scene with factors of a model, with noise, m."""
    truth = hierarchy.as_model(scene, model)
    return degrade(simulate(with_parameters(truth, values(truth)), tolerance=1e-12), noise=noise, seed=1)


TRUTHS = {  # a model and its factors
    "F": ("F", lambda scene: np.array([2.0])),
    "R": ("R", lambda scene: np.geomspace(0.4, 3.0, len(parameters(scene)))),
}


def choice(truth, of="frames", budget=BUDGET, letters="nL"):
    """What is chosen for a target of a truth, and the objective."""
    scene = small(letters, 30)
    whole = Objective(scene, target_of(small("nL", 30), *TRUTHS[truth]), 1e-10, scene.frames)
    return chosen(whole, None, parameters(scene), ENOUGH, of, budget), whole


@pytest.mark.parametrize(
    ("truth", "of", "letters"),
    [("F", "frames", "nL"), ("F", "vertices", "nL"), ("R", "frames", "nG"), ("R", "vertices", "nL")],
)
def test_a_truth_of_few_values_has_a_model_of_few_values_whatever_is_flagged(truth, of, letters):
    found, whole = choice(truth, of, letters=letters)
    scene = hierarchy.as_model(whole.scene, found.model, exactly=True)
    assert found.model == found.judged[-1].model == truth  # what is left is noise, so no finer one is tried
    assert len(found.p) == found.judged[-1].values == len(parameters(scene))
    assert found.evaluations > 0
    rmse = np.sqrt(whole.flagging(scene).cost(found.p) / whole.observations)
    assert rmse == pytest.approx(np.sqrt(3) * 1e-3, rel=0.1)  # noise in three directions, of some 360 positions
    for each in found.judged:
        assert each.holdout_rmse > 1e-3
        assert each.seconds >= 0


def test_a_budget_that_is_used_up_ends_the_choice_with_what_it_has():
    found, whole = choice("R", budget=5)
    assert [each.model for each in found.judged] in ([], ["F"])
    assert found.model == "F"
    assert found.evaluations <= 5
    start = parameters(hierarchy.as_model(whole.scene, "F"))
    flagged = whole.flagging(hierarchy.as_model(whole.scene, "F", exactly=True))
    assert flagged.cost(found.p) <= flagged.cost(start)


@pytest.mark.parametrize("fault", [Diverged("far", 1), MemoryError(), np.linalg.LinAlgError("singular")], ids=repr)
def test_a_fault_ends_the_choice_with_what_it_has(monkeypatch, fault):
    original = hierarchy.fit_level

    def rung(search, model, starts):
        if model == "R":
            raise fault
        original(search, model, starts)

    monkeypatch.setattr(hierarchy, "fit_level", rung)
    found, _ = choice("R")
    assert [each.model for each in found.judged] == ["F"]
    assert found.model == "F"


# --- its parts


def own(frames=20, **fields):
    """The objective of a small sheet against its own motion."""
    scene = small("nF", frames, **fields)
    return Objective(scene, simulate(scene, tolerance=1e-12), 1e-10, scene.frames)


def test_a_part_of_the_frames_judges_where_there_are_enough():
    whole = own(20)
    fitted, kept = parted(whole, "frames")
    assert (fitted.frames, kept.observations) == (15, 5 * 16)
    assert kept.observations == KEPT_OUT * 20 * 16
    assert fitted.observations + kept.observations == 20 * 16
    short = Objective(whole.scene, at_frames(simulate(whole.scene), slice(0, 2)), 1e-10, 20)
    assert parted(short, "frames") == (short, None)


def test_the_error_of_values_is_that_of_their_motion_and_those_that_diverge_are_the_worst():
    goal, explicit = own(), own(10, integrationMethod=0, delta=0.001)
    p = parameters(goal.scene)
    assert error_of(goal, p) < 1e-9  # m; its own motion, systems solved to 1e-10
    assert error_of(goal, 1.5 * p) == pytest.approx(goal.rmse(goal.cost(1.5 * p)))
    assert judged([ModelFit("F", 1, 0.1, np.array([1e12]), 2.0)], explicit) == [Judged("F", 1, 0.1, np.inf, 2.0)]


@pytest.mark.parametrize(("factor", "noise", "enough"), [(2.0, 1e-3, ENOUGH), (1.3, 0.0, 1e-6)])
def test_finer_models_are_left_out_where_noise_is_left_or_nothing(factor, noise, enough):
    scene = small("nL", 30)
    motion = target_of(scene, "F", lambda _: np.array([factor]), noise)
    search = Search(Objective(scene, motion, 1e-10, scene.frames), parameters(scene), enough, BUDGET)
    holdout.fit_models(search, [search.start])
    assert [each.model for each in search.levels] == ["F"]
    assert noise or search.levels[0].rmse < enough
