"""Windows that begin in the target's own states: what they compare, what a fit finds with them, what they refuse."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.strangers import DRAG, WIND, sheet, small, windy, with_finer_steps

import clothfit
from clothfit.base.errors import InvalidInput
from clothfit.cli.program import main
from clothfit.derivative.verify import central_difference_error
from clothfit.fit.target_windows import in_windows, windows_of
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
    # as for motions from their start: the difference's own error of 1e-6
    assert central_difference_error(windows, parameters(scene), seed=1) < 1e-6


@pytest.mark.slow
def test_the_wind_of_a_model_that_differs_is_that_of_the_frames(motion):
    # the fitted cloth is as stiff as it is, twice too stiff: a whole motion makes up for that by another wind
    start = windy(wind=(0, 0, 0), stiffness=10.0)
    start = replace(start, cloths=(replace(start.cloths[0], settings="nn"),))
    whole = clothfit.estimate(start, motion, intervals=False)
    found = clothfit.estimate(start, motion, intervals=False, windows=8)
    off = [np.linalg.norm(fit.scene.wind - WIND) for fit in (whole, found)]
    assert off[1] < 0.1 * np.linalg.norm(WIND)
    assert off[1] < 0.5 * off[0]
    assert (found.windows, whole.windows, whole.whole) == (8, None, None)
    own = at_frames(simulate(found.scene, tolerance=1e-10), slice(None, None, found.substeps or 1)).positions
    far = np.sqrt(((own - motion.positions[: len(own)]) ** 2).sum(axis=2).mean())
    assert found.whole == pytest.approx(far, rel=1e-5)  # of systems solved to 1e-10 each


@pytest.mark.slow
def test_the_right_model_finds_its_values_in_windows_and_says_so(tmp_path, capsys):
    scene = windy(frames=60)
    clothfit.save(windy(wind=(0.3, 0.0, 0.5), drag=500.0, frames=60), tmp_path / "scene.json")
    clothfit.save_motion(with_finer_steps(scene, 4), tmp_path / "target.npz")
    with pytest.raises(SystemExit) as end:
        main(["estimate", str(tmp_path / "scene.json"), "--target", str(tmp_path / "target.npz"), "--windows", "6",
              "--no-intervals", "--json"])  # fmt: skip
    out, err = capsys.readouterr()
    said = json.loads(out)
    assert end.value.code in (0, 5)
    assert said["windows"]["frames"] == 6
    assert "that is over windows of 6 frames; the whole motion: RMSE" in err
    # central differences are of second order in the frames' distance: a percent here
    found = clothfit.load(tmp_path / "scene.fitted.json")
    np.testing.assert_allclose(found.wind, WIND, rtol=0.05)
    assert found.cloths[0].drag == pytest.approx(DRAG, rel=0.05)
