"""What a fit settles before it begins, its model and its time step, and what is left of that whatever ends it."""

from itertools import count as counter

import numpy as np
import pytest
from helpers.marks import fits
from helpers.strangers import small, with_finer_steps

from clothfit.base import checkpoint as module
from clothfit.base import interrupts
from clothfit.base.errors import InvalidInput
from clothfit.engine.system import BDF2, IMPLICIT
from clothfit.fit.estimate import estimate
from clothfit.fit.options import FitOptions
from clothfit.fit.preparation import Prepared, chosen_before, counts_of, flagged, prepared, with_model, with_steps
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import at_frames
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise.checkpoint import State
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.strategy import ladder
from clothfit.strategy.step_choice import COUNTS

FRAMES = 24


def objective(scene, motion):
    """The objective of a fit."""
    return Objective(scene, motion, 1e-10, scene.frames)


def one_factor(letters="nL", noise=1e-3, **fields):
    """A scene, and a noisy motion of twice its stiffness."""
    scene = small(letters, FRAMES, **fields)
    truth = with_parameters(ladder.as_model(small("nL", FRAMES, method=scene.method), "F"), np.array([2.0]))
    return scene, degrade(simulate(truth, tolerance=1e-12), noise=noise, seed=1)


def finer(letters="nL", **fields):
    """A scene, and its motion by eight times finer steps."""
    scene = small(letters, FRAMES, **fields)
    return scene, with_finer_steps(scene, 8)


# --- options


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"model": "Q"}, "model: there is no 'Q'; use auto, F, G, R, M, L"),
        ({"substeps": 0}, "substeps must be auto or a whole number from 1 on; 0 was given"),
        ({"substeps": 1.5}, "substeps must be auto"),
        ({"substeps": "many"}, "substeps must be auto"),
        ({"substeps": 2, "keep_step": True}, "substeps: the step is to be kept; use either substeps or keep_step"),
        ({"substeps": "auto", "keep_step": True}, "substeps: the step is to be kept"),
    ],
)
def test_options_that_cannot_be_are_refused(options, said):
    with pytest.raises(InvalidInput) as caught:
        FitOptions(**options).check()
    assert str(caught.value).startswith(said)
    with pytest.raises(InvalidInput):
        estimate(small("nF", 5), np.zeros((5, 16, 3)), **options)


@pytest.mark.parametrize(
    ("method", "options", "counts"),
    [
        (IMPLICIT, {}, []),
        (IMPLICIT, {"substeps": "auto"}, COUNTS),
        (IMPLICIT, {"substeps": 3}, [3]),
        (IMPLICIT, {"substeps": "auto", "method": "l-bfgs-b"}, COUNTS),
        (BDF2, {}, COUNTS),
        (BDF2, {"keep_step": True}, []),
        (BDF2, {"method": "l-bfgs-b"}, []),
        (BDF2, {"substeps": 1}, [1]),
    ],
)
def test_the_steps_that_are_to_be_tried(method, options, counts):
    assert counts_of(FitOptions(**options), small("nF", 5, method=method)) == counts


@pytest.mark.parametrize(("model", "letters"), [(None, "RL"), ("F", "FF"), ("G", "GG"), ("L", "LL"), ("auto", "LL")])
def test_a_model_takes_the_place_of_the_flags(model, letters):
    assert flagged(small("RL", 5), model).cloths[0].settings == letters


# --- plans


STATE = State(
    start=np.ones(1), best=np.ones(1), cost=1.0, gradient=np.zeros(1), centre=np.zeros(0), tau=(), y=np.zeros(0),
    radius=0.0, window=0, before=np.zeros(0), before_cost=0.0, history=(), beside=0, seconds=1.0, warnings=(),
)  # fmt: skip


@fits
def test_a_plan_with_other_steps_and_another_model_has_them_for_what_is_kept_out_too():
    scene, motion = finer("nL")
    plan = Prepared(objective(scene, motion), objective(scene, motion))
    plan = with_model(with_steps(plan, 4, BDF2), "R")
    for each in (plan.objective, plan.kept_out):
        assert (each.scene.method, each.scene.delta, each.scene.cloths[0].settings) == (BDF2, scene.delta / 4, "nR")
        assert each.frames == FRAMES
    assert plan.model == "R"


@fits
def test_a_fit_that_goes_on_has_the_step_and_the_model_that_were_chosen():
    scene, motion = finer("nL")
    plan = chosen_before(Prepared(objective(scene, motion), None), STATE._replace(model="F", substeps=4))
    assert (plan.model, plan.substeps, plan.p) == ("F", 4, None)
    assert (plan.objective.scene.delta, plan.objective.scene.cloths[0].settings) == (scene.delta / 4, "nF")


@fits
@pytest.mark.parametrize("model", ["", "R", "L"])
def test_a_state_of_another_number_of_values_is_refused(model):
    plan = Prepared(objective(*finer("nL")), None)
    with pytest.raises(InvalidInput, match="the checkpoint is not what a fit has written"):
        chosen_before(plan, STATE._replace(model=model))


@fits
def test_nothing_is_chosen_where_nobody_asks():
    scene, motion = finer("nL")
    goal = objective(scene, motion)
    plan = prepared(Prepared(goal, None), None, FitOptions().checked())
    assert plan.objective is goal
    assert (plan.p, plan.wanted, plan.judged, plan.model, plan.substeps, plan.tried) == (None, None, None, "", 0, ())


@fits
@pytest.mark.parametrize("options", [{"substeps": "auto"}, {"model": "auto"}, {"substeps": "auto", "model": "auto"}])
def test_the_values_of_a_plan_cost_what_it_says(options):
    scene, motion = finer("LL" if "model" in options else "nL")
    goal = objective(scene, motion)
    plan = prepared(Prepared(goal, None), 30.0 if "model" not in options else None, FitOptions(**options).checked())
    assert plan.objective.cost(plan.p) == pytest.approx(plan.cost, rel=1e-6)
    assert plan.objective.rmse(plan.cost) <= goal.rmse(goal.cost(parameters(scene)))
    assert bool(plan.tried) == bool(plan.substeps) == ("substeps" in options)
    assert bool(plan.judged) == bool(plan.model) == ("model" in options)
    assert plan.evaluations > 0
    assert plan.seconds > 0


# --- fits


@fits
@pytest.mark.parametrize("method", [IMPLICIT, BDF2])
def test_a_truth_by_one_factor_is_fitted_by_one_factor(method):
    scene, motion = one_factor(method=method)
    fit = estimate(scene, motion, model="auto", intervals=False)
    assert [block.mode for block in fit.parameters] == ["F"]
    assert [each.model for each in fit.ladder] == ["F"]
    assert fit.scene.delta == scene.delta
    # 360 positions with noise of 1 mm, of a motion of decimetres that follows the stiffness
    np.testing.assert_allclose(fit.scene.cloths[0].stiffness, 40.0, rtol=0.02)


@fits
def test_one_velocity_stays_one_with_any_model():
    scene, motion = one_factor(of_cloth={"vertVel": "G"})
    fit = estimate(scene, motion, model="auto", intervals=False)
    assert [(block.name, block.mode) for block in fit.parameters] == [("stiffness", "F"), ("velocity", "G")]


@fits
def test_the_step_is_chosen_unless_it_is_to_be_kept():
    scene, motion = finer("nF", method=BDF2)
    free, kept = estimate(scene, motion, intervals=False), estimate(scene, motion, intervals=False, keep_step=True)
    assert free.substeps > 1
    assert free.scene.delta == pytest.approx(scene.delta / free.substeps)
    assert (kept.substeps, kept.steps, kept.scene.delta, kept.scene.frames) == (None, [], scene.delta, FRAMES)
    assert free.rmse < 0.1 * kept.rmse  # second order
    assert free.rmse <= min(each.rmse for each in free.steps) * (1 + 1e-6)


@fits
def test_the_editors_step_is_kept_with_a_hint():
    scene, motion = finer("nF", method=IMPLICIT)
    fit = estimate(scene, motion, intervals=False)
    assert (fit.substeps, fit.scene.delta, fit.scene.method) == (None, scene.delta, IMPLICIT)
    assert "time_step" in [hint.code for hint in fit.hints]


@fits
def test_a_number_of_steps_is_taken_by_the_integrator_that_is_nearer():
    scene, motion = finer("nF", method=IMPLICIT)
    fit = estimate(scene, motion, intervals=False, substeps=2)
    assert [(each.substeps, each.integrator) for each in fit.steps] == [(2, "implicit"), (2, "bdf2")]
    assert (fit.scene.method, fit.scene.delta) == (BDF2, scene.delta / 2)
    fine = scene.with_step(scene.delta / 2, 2 * FRAMES - 1)
    motion = at_frames(simulate(fine, tolerance=1e-12), slice(None, None, 2))
    fit = estimate(scene, motion, intervals=False, substeps=2)
    assert (fit.scene.method, fit.scene.delta) == (IMPLICIT, scene.delta / 2)
    assert fit.rmse < 1e-8  # its own model


# --- whatever ends them


CHOICES = {
    "step": ({"substeps": "auto"}, "nF"),
    "model": ({"model": "auto"}, "nL"),
    "step and model": ({"substeps": "auto", "model": "auto"}, "nL"),
    "step, model and holdout": ({"substeps": "auto", "model": "auto", "holdout": 0.25}, "nL"),
}


def until(monkeypatch, last, act):
    """Act at one simulation; returns what counts them."""
    number, original = counter(1), Objective.simulate

    def simulate_until(self, *given, **options):
        if next(number) == last:
            act()
        return original(self, *given, **options)

    monkeypatch.setattr(Objective, "simulate", simulate_until)
    return number


@fits
@pytest.mark.parametrize("kind", ["step", "model", "step, model and holdout"])
def test_an_interrupt_at_any_simulation_leaves_a_result_no_worse_than_the_start(kind):
    options, letters = CHOICES[kind]
    scene, motion = finer(letters)
    goal = objective(scene, motion)
    part = goal if "holdout" not in options else objective(scene, at_frames(motion, slice(18)))
    first = part.rmse(part.cost(parameters(scene)))
    with pytest.MonkeyPatch.context() as patch:
        number = until(patch, None, None)
        whole = estimate(scene, motion, intervals=False, **options)
        most = next(number)
    assert whole.rmse < first
    for last in (1, 2, 3, most // 2, 4 * most // 5):
        with pytest.MonkeyPatch.context() as patch:
            until(patch, last, interrupts.request)
            try:
                found = estimate(scene, motion, intervals=False, **options)
            except KeyboardInterrupt:
                found = None
        assert (found is None) <= (last <= 2), last  # only before the first cost there is nothing to give
        # a stage solves systems to 1e-7
        assert found is None or found.rmse <= first * (1 + 1e-5), last


@fits
@pytest.mark.parametrize("kind", CHOICES)
def test_without_time_for_one_evaluation_the_start_is_the_result(kind):
    options, letters = CHOICES[kind]
    scene, motion = finer(letters)
    fit = estimate(scene, motion, intervals=False, **options, budget=1e-9)
    assert fit.status == "limit"
    before, after = (each.cloths[0].stiffness for each in (scene, fit.scene))
    np.testing.assert_allclose(after, before, rtol=1e-12)


@fits
@pytest.mark.parametrize("kind", CHOICES)
def test_the_time_ends_a_choice_with_a_result_no_worse_than_the_start(kind):
    options, letters = CHOICES[kind]
    scene, motion = finer(letters)
    goal = objective(scene, motion)
    fit = estimate(scene, motion, intervals=False, **options, budget=0.03)
    p = parameters(fit.scene)
    reached = objective(fit.scene, motion)
    assert reached.rmse(reached.cost(p)) <= goal.rmse(goal.cost(parameters(scene))) * (1 + 1e-5)


# --- and is resumed


@fits
def test_a_fit_that_is_resumed_climbs_no_model_again_that_it_had_finished(tmp_path, monkeypatch):
    scene, motion = finer("nL")
    fitted, rung, done = [], ladder.rung, 2

    def noted(search, model, starts=()):
        if len(fitted) == done:
            raise KeyboardInterrupt
        rung(search, model, starts)
        fitted.append(model)

    monkeypatch.setattr(ladder, "rung", noted)
    first = estimate(scene, motion, intervals=False, checkpoint=tmp_path / "c", keep_step=True)
    assert (first.status, [each.model for each in first.ladder]) == ("interrupted", fitted)
    done = -1
    found = estimate(scene, motion, intervals=False, checkpoint=tmp_path / "c", keep_step=True, resume=True)
    assert fitted == ladder.models(scene)  # each once
    assert [each.model for each in found.ladder] == fitted
    assert [each.rmse for each in found.ladder][: len(first.ladder)] == [each.rmse for each in first.ladder]
    assert found.cost <= first.cost


@fits
@pytest.mark.parametrize("kind", ["step", "step and model"])
def test_a_fit_that_is_resumed_keeps_what_was_chosen(tmp_path, monkeypatch, kind):
    options, letters = CHOICES[kind]
    scene, motion = finer(letters)
    kept = []
    with monkeypatch.context() as patch:
        patch.setattr(module, "write_atomically", lambda _, data: kept.append(data))
        patch.setattr(module, "EVERY", 0.0)
        patch.setattr(module, "WRITING_SHARE", 0.0)
        whole = estimate(scene, motion, intervals=False, checkpoint=tmp_path / "c", **options)
    assert whole.substeps
    for data in (kept[0], kept[len(kept) // 2], kept[-1]):
        (tmp_path / "c").write_bytes(data)
        found = estimate(scene, motion, intervals=False, checkpoint=tmp_path / "c", resume=True, **options)
        assert (found.substeps, found.scene.delta) == (whole.substeps, whole.scene.delta)
        assert [block.mode for block in found.parameters] == [block.mode for block in whole.parameters]
        assert found.cost <= whole.cost * (1 + 1e-3)  # the same minimum
    with pytest.raises(InvalidInput, match="belongs to another fit"):
        estimate(scene, motion, checkpoint=tmp_path / "c", resume=True, **{**options, "substeps": 2})
