"""Motions from files as recorded data: at the times of the steps, with their inputs."""

import json

import numpy as np
import pytest
from helpers.scenes import cloth, document
from helpers.subspaces import scene_of

from clothfit import InvalidInput, InvalidMotion, Motion
from clothfit.subspace.inputs import Episode
from clothfit.subspace.recording import Data, collect, episode

pytestmark = pytest.mark.quick

MADE = document(cloth(3, 2, vertIsFixed=[True] + [False] * 5), delta=0.02)
SCENE = scene_of(MADE)


def swing(times):
    """A smooth motion (frames, 6, 3): all vertices by sin(3 t) (1, 2, 0), also the one that is fixed."""
    return SCENE.cloths[0].positions + np.sin(3.0 * times)[:, None, None] * np.array([1.0, 2.0, 0.0])


def motion_at(times, observed=None):
    return Motion(swing(times), times, SCENE.vertex_counts, observed, "swing")


def collected(tmp_path, *motions):
    found = collect(SCENE, [(each, Episode(())) for each in motions], tmp_path / "data.npz")
    return found, Data(tmp_path / "data.npz")


@pytest.mark.parametrize("fps", [50.0, 24.0, 120.0])
def test_frames_are_read_at_the_steps_and_what_is_fixed_stays(tmp_path, fps):
    times = np.arange(int(fps) + 1) / fps
    found, data = collected(tmp_path, motion_at(times), motion_at(times))
    x, good = data.motion(1, 0)
    steps = 0.02 * np.arange(51)
    assert (len(x), good.all(), found.frames, found.left_out) == (51, True, 102, 0)
    np.testing.assert_array_equal(x[:, 0], 0.0)
    away = x[:, 1:] - (swing(steps) - SCENE.cloths[0].positions)[:, 1:]
    # single precision; a cubic spline of gap d misses 5/384 d⁴ x⁗ inside and a few times that at its ends: x⁗ = 81 · 2
    assert np.abs(away).max() < 3e-7 + (0.0 if fps == 50.0 else 0.1 * 162 / fps**4)


def test_frames_that_do_not_show_all_do_not_count(tmp_path):
    times = 0.02 * np.arange(30)
    observed = np.ones((30, 6), bool)
    observed[10:13, 4] = False
    found, data = collected(tmp_path, motion_at(times, observed), motion_at(times))
    np.testing.assert_array_equal(np.flatnonzero(~data.motion(0, 0)[1]), [10, 11, 12])
    assert found.left_out == 3
    observed[3:] = False
    with pytest.raises(InvalidInput, match="3 frames show all vertices; at least 4"):
        collected(tmp_path, motion_at(times, observed))


@pytest.mark.parametrize(
    ("times", "said"),
    [([-0.5, 0, 0.5, 1], "is before the start"), ([0, 1, 2, 1e9], "too many steps away"),
     ([0, 1, 2, 3e7], "of memory are free")],
)  # fmt: skip
def test_times_that_no_steps_reach_are_refused(tmp_path, times, said):
    with pytest.raises((InvalidInput, InvalidMotion), match=said):
        collected(tmp_path, motion_at(np.array(times, float)))


def test_inputs_come_with_the_motion_and_their_files_are_found_from_anywhere(tmp_path):
    listed = {"inputs": [{"acts": "wind", "file": "gusts.csv"}]}
    (tmp_path / "inputs.json").write_text(json.dumps(listed))
    (tmp_path / "gusts.csv").write_text("0 1 0 0\n1 2 0 0\n")
    own = episode(SCENE, str(tmp_path / "inputs.json"))
    assert own.items[0]["file"] == str(tmp_path / "gusts.csv")
    (tmp_path / "wrong.json").write_text(json.dumps({"inputs": [{"acts": "rain"}]}))
    with pytest.raises(InvalidInput, match="'rain' is none of"):
        episode(SCENE, str(tmp_path / "wrong.json"))
