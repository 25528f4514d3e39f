"""The choice of a model: the smallest that no finer one beats on what it has not seen."""

import numpy as np
import pytest
from helpers.interrupting import interrupt_after
from helpers.marks import fits
from helpers.strangers import small

from clothfit.base import interrupts
from clothfit.fit import holdout
from clothfit.fit.holdout import BEATS, KEPT_OUT, Judged, chosen, error_of, judged, nearer, parted, smallest
from clothfit.motion.degrade import degrade
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import at_frames
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.optimise.status import Rung
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.strategy import ladder

ENOUGH, BUDGET = 1e-8, 1000  # as in a fit


# --- of errors that are known


def models(*errors, fitted=None):
    """Models F, R, M and L with these errors on what is kept out, and others on what is fitted."""
    own = fitted or errors
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
    assert smallest(models(*errors)) == model


def test_what_is_kept_out_judges_where_anything_is():
    assert smallest(models(1.0, 1.0, fitted=(1.0, 0.1))) == "F"
    assert smallest(models(None, None, fitted=(1.0, 0.1))) == "R"


def test_a_model_that_came_nearer_to_what_was_fitted_is_named():
    hint = nearer(models(0.06, 0.27, fitted=(0.037, 0.025)), "F")
    assert hint.code == "model"
    assert "model R comes to 25 mm on what was fitted, F to 37 mm" in hint.text
    assert "it is no better, 270 mm against 60 mm, so F was chosen; --model R fits it" in hint.text
    assert nearer(models(0.06, 0.02, fitted=(0.037, 0.025)), "R") is None
    assert nearer(models(0.06, 0.06, fitted=(0.037, 0.036)), "F") is None


# --- of a cloth




def target_of(scene, model, values):
    """The motion of a scene with factors of a model, with noise of 1 mm."""
    truth = ladder.as_model(scene, model)
    return degrade(simulate(with_parameters(truth, values(truth)), tolerance=1e-12), noise=1e-3, seed=1)


TRUTHS = {  # a model and its factors
    "F": ("F", lambda scene: np.array([2.0])),
    "R": ("R", lambda scene: np.geomspace(0.4, 3.0, len(parameters(scene)))),
}


def choice(truth, of="frames", budget=BUDGET, letters="nL"):
    """What is chosen for a target of a truth, and the objective."""
    scene = small(letters, 30)
    whole = Objective(scene, target_of(small("nL", 30), *TRUTHS[truth]), 1e-10, scene.frames)
    return chosen(whole, None, parameters(scene), ENOUGH, of, budget), whole


@fits
@pytest.mark.parametrize("of", ["frames", "vertices"])
@pytest.mark.parametrize("truth", TRUTHS)
def test_a_truth_of_few_values_has_a_model_of_few_values(truth, of):
    found, whole = choice(truth, of)
    scene = ladder.as_model(whole.scene, found.model)
    assert found.model == found.judged[-1].model == truth  # what is left is noise, so no finer one is tried
    assert len(found.p) == found.judged[-1].values == len(parameters(scene))
    assert found.evaluations > 0
    rmse = np.sqrt(whole.flagging(scene).cost(found.p) / whole.observations)
    assert rmse == pytest.approx(np.sqrt(3) * 1e-3, rel=0.1)  # noise in three directions, of some 360 positions
    for each in found.judged:
        assert each.holdout_rmse > 1e-3
        assert each.seconds >= 0


@fits
def test_flags_of_one_value_are_free_in_the_choice():
    found, _ = choice("R", letters="nG")
    assert found.model == "R"


@fits
def test_a_budget_that_is_used_up_ends_the_choice_with_what_it_has():
    found, whole = choice("R", budget=5)
    assert [each.model for each in found.judged] in ([], ["F"])
    assert found.model == "F"
    assert found.evaluations <= 5
    start = parameters(ladder.as_model(whole.scene, "F"))
    flagged = whole.flagging(ladder.as_model(whole.scene, "F", exactly=True))
    assert flagged.cost(found.p) <= flagged.cost(start)


@fits
@pytest.mark.parametrize("simulations", [1, 2, 5, 10, 20, 30])
def test_an_interrupt_ends_the_choice_with_what_it_has(monkeypatch, simulations):
    interrupt_after(monkeypatch, simulations)
    with interrupts.deferred():
        found, whole = choice("R")
        requested = interrupts.requested()
    monkeypatch.undo()
    assert requested
    assert [each.model for each in found.judged] == list("FR"[: len(found.judged)])
    assert all(each.holdout_rmse is None for each in found.judged)  # there is no time to judge
    part = parted(whole, "frames")[0].flagging(ladder.as_model(whole.scene, found.model, exactly=True))
    assert part.cost(found.p) <= part.cost(parameters(part.scene)) * (1 + 1e-5)  # a stage solves systems to 1e-7


@fits
@pytest.mark.parametrize("fault", [Diverged("far", 1), MemoryError(), np.linalg.LinAlgError("singular")], ids=repr)
def test_a_fault_ends_the_choice_with_what_it_has(monkeypatch, fault):
    original = ladder.rung

    def rung(search, model, starts):
        if model == "R":
            raise fault
        original(search, model, starts)

    monkeypatch.setattr(ladder, "rung", rung)
    found, _ = choice("R")
    assert [each.model for each in found.judged] == ["F"]
    assert found.model == "F"


# --- its parts


def own(frames=20, **fields):
    """The objective of a small sheet against its own motion."""
    scene = small("nF", frames, **fields)
    return Objective(scene, simulate(scene, tolerance=1e-12), 1e-10, scene.frames)


@fits
def test_a_part_of_the_frames_judges():
    fitted, kept = parted(own(20), "frames")
    assert (fitted.frames, kept.observations) == (15, 5 * 16)
    assert kept.observations == KEPT_OUT * 20 * 16
    assert fitted.observations + kept.observations == 20 * 16


@fits
def test_too_few_frames_are_not_parted():
    scene = small("nF", 20)
    short = Objective(scene, at_frames(simulate(scene), slice(0, 2)), 1e-10, scene.frames)
    assert parted(short, "frames") == (short, None)


@fits
def test_the_error_of_values_is_that_of_their_motion():
    goal = own()
    p = parameters(goal.scene)
    assert error_of(goal, p) < 1e-9  # m; its own motion, systems solved to 1e-10
    assert error_of(goal, 1.5 * p) == pytest.approx(goal.rmse(goal.cost(1.5 * p)))


@fits
def test_values_that_diverge_are_the_worst():
    goal = own(10, integrationMethod=0, delta=0.001)
    assert error_of(goal, np.array([1e12])) == np.inf
    assert judged([Rung("F", 1, 0.1, np.array([1e12]), 2.0)], goal) == [Judged("F", 1, 0.1, np.inf, 2.0)]


@fits
def test_finer_models_are_left_out_where_noise_is_left():
    scene = small("nL", 30)
    goal = Objective(scene, target_of(scene, *TRUTHS["F"]), 1e-10, scene.frames)
    search = Search(goal, parameters(scene), ENOUGH, BUDGET)
    holdout.climb(search, [search.start])
    assert [each.model for each in search.rungs] == ["F"]


@fits
def test_the_model_that_meets_an_exact_target_is_the_last():
    scene = small("nL", 20)
    truth = ladder.as_model(scene, "F")
    motion = simulate(with_parameters(truth, np.array([1.3])), tolerance=1e-12)
    search = Search(Objective(scene, motion, 1e-10, scene.frames), parameters(scene), 1e-6, BUDGET)
    holdout.climb(search, [search.start])
    assert [each.model for each in search.rungs] == ["F"]
    assert search.rungs[0].rmse < 1e-6
