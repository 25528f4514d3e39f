"""Windows that begin in the target's own states: what they compare, what a fit finds with them, what they refuse."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.strangers import DRAG, WIND, sheet, small, windy, with_finer_steps

import clothfit
from clothfit.base.errors import InvalidInput
from clothfit.cli.program import run
from clothfit.fit.preparation import in_windows, windows_of
from clothfit.motion.motion import at_frames
from clothfit.motion.simulate import simulate
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import parameters

KEYS = {"times": [0, 1], "values": [{"x": 0, "y": 0, "z": 0}, {"x": 1, "y": 0, "z": 0}]}


def quadratic(scene, frames):
    """A motion whose velocities central differences give exactly: x₀ + t v + t² a, v and a of each vertex."""
    start = scene.cloths[0].positions
    t = scene.delta * np.arange(frames)[:, None, None]
    v, a = np.random.default_rng(1).normal(size=(2, *start.shape)) * ~scene.cloths[0].fixed[:, None]
    positions = start + t * v + t**2 * a
    return clothfit.Motion(positions, t[:, 0, 0], [len(start)]), v, a


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
    motion = clothfit.Motion(positions, alone.times, [36, 36], seen)
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


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"windows": 1}, "windows must have 2 frames or more; 1 was given"),
        ({"windows": 5, "fit_time": True}, "windows: they begin in the target's own states"),
        ({"windows": 5, "target": None}, "windows: a target is needed"),
    ],
)
def test_options_that_windows_do_not_go_with(options, text):
    scene = sheet(frames=20)
    target = quadratic(scene, 20)[0]
    with pytest.raises(InvalidInput, match=text):
        clothfit.estimate(scene, **{"target": target, **options})


@pytest.fixture(scope="module")
def motion():
    return with_finer_steps(windy(), 4)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["implicit", "bdf2"])
def test_the_gradient_over_windows_is_exact(method, motion):
    scene = windy(wind=(0.5, 0.2, 1.0), letters="LL")
    scene = scene.with_step(scene.delta, 40, method)
    windows = in_windows(Objective(scene, motion, 1e-14, 40), 9)
    assert len(windows.runs) == 5
    p = parameters(scene)
    cost, gradient = windows.cost_and_gradient(p)
    step = 1e-5 * p * np.random.default_rng(1).normal(size=len(p))
    # the difference's own error is 2e-9 here, of the third order of the step
    assert windows.cost(p + step) - windows.cost(p - step) == pytest.approx(2.0 * gradient @ step, rel=1e-7)
    assert cost > 1e-6  # m²: there is something to explain


@pytest.mark.slow
def test_windows_find_the_values_and_say_how_far_the_whole_motion_is(motion):
    start = windy(wind=(0.3, 0.0, 0.5), drag=500.0)
    found = clothfit.estimate(start, motion, intervals=False, windows=16)
    # central differences, and the first step of each window, are off by the third order of 2.5 ms
    np.testing.assert_allclose(found.scene.wind, WIND, atol=0.05 * np.linalg.norm(WIND))
    assert found.scene.cloths[0].drag == pytest.approx(DRAG, rel=0.02)
    assert found.windows == 16
    assert found.rmse < found.whole
    own = at_frames(simulate(found.scene, tolerance=1e-10), slice(None, None, found.substeps or 1)).positions
    far = np.sqrt(((own - motion.positions[: len(own)]) ** 2).sum(axis=2).mean())
    assert found.whole == pytest.approx(far, rel=1e-4)  # 0.2 mm, of systems solved to 1e-10 each


@pytest.mark.slow
def test_the_command_says_what_was_compared(tmp_path, capsys, motion):
    scene, target = tmp_path / "scene.json", tmp_path / "target.npz"
    clothfit.save(windy(), scene)
    clothfit.save_motion(motion, target)
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
    found = clothfit.estimate(scene, motion, intervals=False, windows=4, holdout=0.25)
    assert (found.frames, found.holdout.observations) == (15 + 3, 5 * 36)  # windows share three frames of the 15
    assert 0 < found.holdout.rmse < np.inf
