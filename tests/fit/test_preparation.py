"""What a fit settles before it begins, its model, its time step and its windows, and what is left of that whatever ends
it.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.interrupting import interrupt_after
from helpers.scenes import load_text
from helpers.strangers import DRAG, WIND, sheet, small, windy, with_finer_steps

from clothfit import InvalidInput, Motion, degrade, parameters, save, save_motion, simulate, with_parameters
from clothfit.base import checkpoint as module
from clothfit.cli.program import run
from clothfit.engine.system import BDF2, IMPLICIT
from clothfit.fit import hierarchy, routes
from clothfit.fit.options import Request
from clothfit.fit.preparation import counts_of, in_windows, windows_of
from clothfit.fit.routes import Fitting, as_before
from clothfit.fit.step_choice import COUNTS
from clothfit.motion.motion import at_frames
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.optimise.checkpoint import State
from clothfit.scene.scene import dumps

FRAMES = 24


def objective(scene, motion):
    """The objective of a fit."""
    return Objective(scene, motion, 1e-10, scene.frames)


def one_factor(letters="nL", noise=1e-3, **fields):
    """A scene, and a noisy motion of twice its stiffness."""
    scene = small(letters, FRAMES, **fields)
    truth = with_parameters(hierarchy.as_model(small("nL", FRAMES, method=scene.method), "F"), np.array([2.0]))
    return scene, degrade(simulate(truth, tolerance=1e-12), noise=noise, seed=1)


def finer(letters="nL", **fields):
    """A scene, and its motion by eight times finer steps."""
    scene = small(letters, FRAMES, **fields)
    return scene, with_finer_steps(scene, 8)


# --- options


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
    assert counts_of(Request(**options), small("nF", 5, method=method)) == counts


# --- plans


STATE = State(
    start=np.ones(1), best=np.ones(1), cost=1.0, gradient=np.zeros(1), centre=np.zeros(0), tau=(), y=np.zeros(0),
    radius=0.0, window=0, before=np.zeros(0), before_cost=0.0, history=(), beside=0, seconds=1.0, warnings=(),
)  # fmt: skip


@pytest.fixture(scope="module")
def coarse():
    """The objective of a scene with single stiffnesses, and of its motion by finer steps."""
    return objective(*finer("nL"))


def settled(goal, start=None, state=None, **options):
    """A fit that has settled what is fitted."""
    fit = Fitting.of(goal, start, Request(**options).checked(), False, goal, None, state)
    for choice in routes.CHOICES:
        if choice.applies(fit):
            choice.run(fit)
    return fit


@pytest.mark.slow
def test_a_fit_that_goes_on_has_the_step_and_the_model_that_were_chosen(coarse):
    fit = settled(coarse, state=STATE._replace(model="F", substeps=4, integrator=BDF2))
    assert (fit.model, fit.step, fit.known) == ("F", (4, BDF2), False)
    for each in (fit.search.objective, fit.like(coarse)):  # what is kept out as well
        assert (each.scene.method, each.scene.delta) == (BDF2, coarse.scene.delta / 4)
        assert (each.scene.cloths[0].settings, each.frames) == ("nF", FRAMES)
    for model in ("", "R", "L"):  # of another number of values
        fit = Fitting.of(coarse, None, Request().checked(), False, state=STATE._replace(model=model))
        with pytest.raises(InvalidInput, match="the checkpoint is not what a fit has written"):
            as_before(fit)


@pytest.mark.slow
def test_shorter_steps_fit_what_was_chosen_and_nothing_else():
    goal = objective(*finer("nL", fit={"windVel": "G", "gravity": "G"}))
    fit = settled(goal, state=STATE._replace(best=np.ones(4), left_out=("wind",), model="F"))
    by = fit.by((8, IMPLICIT), goal)
    assert [(block.name, block.mode) for block in by.blocks] == [("stiffness", "F"), ("gravity", "G")]
    assert by.scene.delta == goal.scene.delta / 8


# --- fits


@pytest.mark.slow
@pytest.mark.parametrize(("method", "more"), [(IMPLICIT, {}), (BDF2, {}), (IMPLICIT, {"vertVel": "G"})])
def test_a_truth_by_one_factor_is_fitted_by_one_factor_and_one_velocity_stays_one(method, more):
    scene, motion = one_factor(method=method, of_cloth=more)
    fit = estimate(scene, motion, model="auto", intervals=False)
    fitted = [(block.name, block.mode) for block in fit.parameters]
    assert fitted == [("stiffness", "F"), *[("velocity", "G")] * len(more)]
    assert [each.model for each in fit.ladder] == ["F"]
    assert load_text(dumps(fit.scene)).cloths[0].settings == "nL"  # the flags of the file are not what was fitted
    assert fit.scene.delta == scene.delta
    # 360 positions with noise of 1 mm, of a motion of decimetres that follows the stiffness
    np.testing.assert_allclose(fit.scene.cloths[0].stiffness, 40.0, rtol=0.02)


@pytest.mark.slow
def test_the_step_is_chosen_unless_it_is_to_be_kept():
    scene, motion = finer("nF", method=BDF2)
    free, kept = estimate(scene, motion, intervals=False), estimate(scene, motion, intervals=False, keep_step=True)
    assert free.substeps > 1
    assert free.scene.delta == pytest.approx(scene.delta / free.substeps)
    assert (kept.substeps, kept.steps, kept.scene.delta, kept.scene.frames) == (None, [], scene.delta, FRAMES)
    assert free.rmse < 0.1 * kept.rmse  # second order
    assert free.rmse <= min(each.rmse for each in free.steps) * (1 + 1e-6)


@pytest.mark.slow
def test_the_editors_step_is_kept_with_a_hint_unless_a_number_is_asked_for_by_the_integrator_that_is_nearer():
    scene, motion = finer("nF", method=IMPLICIT)
    fit = estimate(scene, motion, intervals=False)
    assert (fit.substeps, fit.scene.delta, fit.scene.method) == (None, scene.delta, IMPLICIT)
    assert "time_step" in [hint.code for hint in fit.hints]
    own = at_frames(simulate(scene.with_step(scene.delta / 2, 2 * FRAMES - 1), tolerance=1e-12), slice(None, None, 2))
    for target, method in ((motion, BDF2), (own, IMPLICIT)):
        fit = estimate(scene, target, intervals=False, substeps=2)
        tried = [(each.substeps, each.integrator) for each in fit.steps]
        assert target is own or tried == [(2, "implicit"), (2, "bdf2")]
        assert (fit.scene.method, fit.scene.delta) == (method, scene.delta / 2)
    assert fit.rmse < 1e-8  # its own model


# --- whatever ends them


CHOICES = {
    "step": ({"substeps": "auto"}, "nF"),
    "step, model and holdout": ({"substeps": "auto", "model": "auto", "holdout": 0.25}, "nL"),
}


@pytest.fixture(scope="module", params=CHOICES)
def chosen_by(request):
    """The options of a choice, the scene and the target, and the error at the start."""
    options, letters = CHOICES[request.param]
    scene, motion = finer(letters)
    goal = objective(scene, motion if "holdout" not in options else at_frames(motion, slice(18)))
    return options, scene, motion, goal.rmse(goal.cost(parameters(scene)))


@pytest.mark.slow
def test_an_interrupt_at_any_simulation_leaves_a_result_no_worse_than_the_start(chosen_by):
    options, scene, motion, first = chosen_by
    seen, original = [], Objective.simulate
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Objective, "simulate", lambda *given, **more: seen.append(1) or original(*given, **more))
        assert estimate(scene, motion, intervals=False, **options).rmse < first
    most = len(seen)
    for last in (0, 2, 2 * most // 3):
        with pytest.MonkeyPatch.context() as patch:
            interrupt_after(patch, last)
            try:
                found = estimate(scene, motion, intervals=False, **options)
            except KeyboardInterrupt:
                found = None
        assert (found is None) <= (last == 0), last  # only before the first cost there is nothing to give
        assert found is None or last or "substeps" not in options
        # a stage solves systems to 1e-7
        assert found is None or found.rmse <= first * (1 + 1e-5), last


@pytest.mark.slow
def test_the_time_ends_a_choice_with_a_result_no_worse_than_the_start(chosen_by):
    options, scene, motion, _ = chosen_by
    fit = estimate(scene, motion, intervals=False, **options, time_limit=1e-9)  # not enough for one evaluation
    assert fit.status == "limit"
    np.testing.assert_allclose(fit.scene.cloths[0].stiffness, scene.cloths[0].stiffness, rtol=1e-12)
    fit = estimate(scene, motion, intervals=False, **options, time_limit=0.03)
    goal, reached = objective(scene, motion), objective(fit.scene, motion)
    assert reached.rmse(reached.cost(parameters(fit.scene))) <= goal.rmse(goal.cost(parameters(scene))) * (1 + 1e-5)


# --- and is resumed


@pytest.mark.slow
def test_a_fit_that_is_resumed_climbs_no_model_again_that_it_had_finished(tmp_path, monkeypatch):
    scene, motion = finer("nL")
    fitted, rung, done = [], hierarchy.fit_level, 2

    def noted(search, model, *others, **more):
        if len(fitted) == done:
            raise KeyboardInterrupt
        rung(search, model, *others, **more)
        fitted.append(model)

    monkeypatch.setattr(hierarchy, "fit_level", noted)
    first = estimate(scene, motion, intervals=False, checkpoint=tmp_path / "c", keep_step=True)
    assert (first.status, [each.model for each in first.ladder]) == ("interrupted", fitted)
    done = -1
    found = estimate(scene, motion, intervals=False, checkpoint=tmp_path / "c", keep_step=True, resume=True)
    assert fitted == hierarchy.models(scene)  # each once
    assert [each.model for each in found.ladder] == fitted
    assert [each.rmse for each in found.ladder][: len(first.ladder)] == [each.rmse for each in first.ladder]
    assert found.cost <= first.cost


@pytest.mark.slow
def test_a_fit_that_is_resumed_keeps_what_was_chosen(tmp_path, monkeypatch):
    options = {"substeps": "auto", "model": "auto"}
    scene, motion = finer("nL")
    kept = []
    with monkeypatch.context() as patch:
        patch.setattr(module, "write_atomically", lambda _, data: kept.append(data))
        patch.setattr(module, "EVERY", 0.0)
        patch.setattr(module, "WRITING_SHARE", 0.0)
        whole = estimate(scene, motion, intervals=False, checkpoint=tmp_path / "c", **options)
    assert whole.substeps
    for data in (kept[len(kept) // 2], kept[-1]):
        (tmp_path / "c").write_bytes(data)
        found = estimate(scene, motion, intervals=False, checkpoint=tmp_path / "c", resume=True, **options)
        assert (found.substeps, found.scene.delta) == (whole.substeps, whole.scene.delta)
        assert [block.mode for block in found.parameters] == [block.mode for block in whole.parameters]
        assert found.cost <= whole.cost * (1 + 1e-3)  # the same minimum
    with pytest.raises(InvalidInput, match="belongs to another fit"):
        estimate(scene, motion, checkpoint=tmp_path / "c", resume=True, **{**options, "substeps": 2})


# --- windows that begin in the target's own states


KEYS = {"times": [0, 1], "values": [{"x": 0, "y": 0, "z": 0}, {"x": 1, "y": 0, "z": 0}]}


def quadratic(scene, frames):
    """A motion whose velocities central differences give exactly: x₀ + t v + t² a, v and a of each vertex."""
    start = scene.cloths[0].positions
    t = scene.delta * np.arange(frames)[:, None, None]
    v, a = np.random.default_rng(1).normal(size=(2, *start.shape)) * ~scene.cloths[0].fixed[:, None]
    positions = start + t * v + t**2 * a
    return Motion(positions, t[:, 0, 0], [len(start)]), v, a


def test_windows_begin_where_the_target_is():
    scene = sheet(frames=20)
    motion, v, a = quadratic(scene, 24)  # of which the scene compares 20
    found = windows_of(Experiment(motion, scene), 8)
    assert [len(each.motion.times) for each in found] == [9, 9, 4]
    assert [each.scene.frames for each in found] == [9, 9, 4]
    np.testing.assert_array_equal(found[0].scene.cloths[0].positions, scene.cloths[0].positions)
    for each, start in zip(found[1:], (8, 16), strict=True):
        np.testing.assert_array_equal(each.motion.positions, motion.positions[start : start + len(each.motion.times)])
        np.testing.assert_allclose(each.motion.times, scene.delta * np.arange(len(each.motion.times)), atol=1e-15)
        np.testing.assert_array_equal(each.scene.cloths[0].positions, motion.positions[start])
        # rounding of positions of 1 m over 0.04 s
        np.testing.assert_allclose(each.scene.cloths[0].velocity, v + 2 * a * scene.delta * start, atol=1e-13)


def test_a_window_begins_in_a_frame_that_is_seen_whole():
    scene = sheet(frames=20)
    motion, *_ = quadratic(scene, 20)
    seen = np.ones(motion.positions.shape[:2], bool)
    seen[9, 20] = False  # neither this frame nor those beside it show a state
    found = windows_of(Experiment(replace(motion, observed=seen), scene), 8)
    assert [len(each.motion.times) for each in found] == [12, 9]
    seen[::2, 20] = False
    with pytest.raises(InvalidInput, match="windows: no three frames one after the other show all vertices"):
        windows_of(Experiment(replace(motion, observed=seen), scene), 8)


def test_a_cloth_that_is_not_fitted_need_not_be_seen():
    one = sheet(frames=20)
    other = replace(one.cloths[0], settings="nn")
    scene = replace(one, cloths=(*one.cloths, other))
    alone, *_ = quadratic(one, 20)
    positions = np.concatenate([alone.positions, np.full_like(alone.positions, np.nan)], axis=1)
    seen = np.isfinite(positions[..., 0])
    motion = Motion(positions, alone.times, [36, 36], seen)
    found = windows_of(Experiment(motion, scene), 8)
    assert [len(each.motion.times) for each in found] == [9, 9, 4]
    np.testing.assert_array_equal(found[1].scene.cloths[0].positions, alone.positions[8])
    np.testing.assert_array_equal(found[1].scene.cloths[1].positions, other.positions)
    np.testing.assert_array_equal(found[1].scene.cloths[1].velocity, other.velocity)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"windVelKeys": KEYS}, "nothing of the scene may change over time"),
        ({"gravityKeys": KEYS}, "nothing of the scene may change over time"),
        ({"of_cloth": {"vertVel": "L"}}, "the velocities at the start are fitted"),
        ({"of_cloth": {"springRestLength": "G"}}, "mode G of rest lengths"),
    ],
)
def test_a_scene_that_cannot_begin_in_another_state_is_refused(fields, text):
    scene = small("nF", **fields)
    motion, *_ = quadratic(scene, 24)
    with pytest.raises(InvalidInput, match=text):
        windows_of(Experiment(motion, scene), 8)


@pytest.fixture(scope="module")
def blown():
    return with_finer_steps(windy(), 4)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["implicit", "bdf2"])
def test_the_gradient_over_windows_is_exact(method, blown):
    scene = windy(wind=(0.5, 0.2, 1.0), letters="LL")
    scene = scene.with_step(scene.delta, 40, method)
    windows = in_windows(Objective(scene, blown, 1e-14, 40), 9)
    assert len(windows.runs) == 5
    p = parameters(scene)
    cost, gradient = windows.cost_and_gradient(p)
    step = 1e-5 * p * np.random.default_rng(1).normal(size=len(p))
    # the difference's own error is 2e-9 here, of the third order of the step
    assert windows.cost(p + step) - windows.cost(p - step) == pytest.approx(2.0 * gradient @ step, rel=1e-7)
    assert cost > 1e-6  # m²: there is something to explain


@pytest.mark.slow
def test_windows_find_the_values_and_say_how_far_the_whole_motion_is(blown):
    start = windy(wind=(0.3, 0.0, 0.5), drag=500.0)
    found = estimate(start, blown, intervals=False, windows=16)
    # central differences, and the first step of each window, are off by the third order of 2.5 ms
    np.testing.assert_allclose(found.scene.wind, WIND, atol=0.05 * np.linalg.norm(WIND))
    assert found.scene.cloths[0].drag == pytest.approx(DRAG, rel=0.02)
    assert found.windows == 16
    assert found.rmse < found.whole
    own = at_frames(simulate(found.scene, tolerance=1e-10), slice(None, None, found.substeps or 1)).positions
    far = np.sqrt(((own - blown.positions[: len(own)]) ** 2).sum(axis=2).mean())
    assert found.whole == pytest.approx(far, rel=1e-4)  # 0.2 mm, of systems solved to 1e-10 each


@pytest.mark.slow
def test_the_command_says_what_was_compared(tmp_path, capsys, blown):
    scene, target = tmp_path / "scene.json", tmp_path / "target.npz"
    save(windy(), scene)
    save_motion(blown, target)
    code = run(["estimate", str(scene), "--target", str(target), "--windows", "40", "--no-intervals", "--json"])
    out, err = capsys.readouterr()
    said = json.loads(out)
    assert code in (0, 5)
    assert said["windows"]["frames"] == 40
    assert said["windows"]["whole_rmse"] > 0
    assert "that is over windows of 40 frames; the whole motion: RMSE" in err


def test_the_last_frames_may_be_kept_out_of_the_windows():
    scene = sheet(frames=20, letters="nF")
    motion = simulate(sheet(40.0, frames=20), tolerance=1e-10)
    found = estimate(scene, motion, intervals=False, windows=4, holdout=0.25)
    assert (found.frames, found.holdout.observations) == (15 + 3, 5 * 36)  # windows share three frames of the 15
    assert 0 < found.holdout.rmse < np.inf
