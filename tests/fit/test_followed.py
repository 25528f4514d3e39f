"""Held vertices that move in a target: which do, and that the fitted scene plays as the fit has it, from its file."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.scenes import even
from helpers.strangers import small

from clothfit import degrade, simulate
from clothfit.fit.preparation import followed, moves, with_start_velocity
from clothfit.motion.motion import as_motion, load_motion, save_motion
from clothfit.scene.scene import dumps, load, save

WAVE = {"times": [0.0, 0.1, 0.3], "values": [{"x": 0, "y": 0, "z": 0}, {"x": 0, "y": 0.2, "z": 0},
                                            {"x": 0.1, "y": -0.1, "z": 0}]}  # fmt: skip


@cache
def waved(frames=20):
    """A scene whose two corners are held, and its motion where the first of them is waved."""
    made = even("nG", frames)
    scene = load(made)
    made["objects"][0]["pins"] = [{"vertices": [0], "posKeys": WAVE}]
    return scene, simulate(load(made), frames)


def pins_in(scene):
    """The pins in the text of a scene."""
    return json.loads(dumps(scene))["objects"][0].get("pins", [])


def test_noise_moves_nothing_and_a_path_below_it_still_does():
    rng = np.random.default_rng(1)
    still = sum(moves(rng.normal(0, 0.02, (100, 3)), 1e-3) for _ in range(1000))
    assert still <= 2  # 4 standard deviations: expected below 0.1 of 1000
    path = np.linspace(0, 0.03, 100)[:, None] * [1, 0, 0]
    assert moves(path + rng.normal(0, 0.005, (100, 3)), 1e-3)
    assert moves(path[::20], 1e-3)  # five frames without noise
    assert not moves(path[::25], 1e-3)  # four say nothing
    assert not moves(path, 0.01)  # it scatters by 0.03 / √12 m


def test_a_target_of_an_array_leaves_keys_in_the_scene_and_its_text_as_it_was():
    scene, motion = waved()
    found = followed(scene, motion.positions)
    (pin,) = pins_in(found.scene)
    assert (found.vertices, pin["vertices"], sorted(pin["posKeys"])) == (1, [0], ["times", "values"])
    before, after = dumps(scene).decode(), dumps(found.scene).decode()
    begin = after.index(', "pins"')
    assert after.replace(after[begin : begin + len(after) - len(before)], "") == before
    played = simulate(found.scene, 20)
    assert np.abs(played.positions - motion.positions).max() < 1e-12  # m: the same path, rounded twice


def test_a_target_of_a_file_is_named_and_the_scene_plays_the_same_from_another_folder(tmp_path):
    scene, motion = waved()
    for name in ("scenes", "out"):
        (tmp_path / name).mkdir()
    save(scene, tmp_path / "scenes" / "scene.json")
    save_motion(motion, tmp_path / "target.npz")
    own = load(tmp_path / "scenes" / "scene.json")
    found = followed(own, load_motion(tmp_path / "target.npz", own)).scene
    save(found, tmp_path / "out" / "fitted.json")
    assert pins_in(found) == [{"vertices": [0], "posKeys": {"file": "../target.npz", "points": [0]}}]
    played = simulate(load(tmp_path / "out" / "fitted.json"), 20)
    assert np.abs(played.positions - motion.positions).max() < 1e-12


def test_pins_that_are_there_stay_and_gaps_lie_between_the_frames_that_show_a_vertex():
    _, motion = waved()
    made = even("nG", 20)
    made["objects"][0]["pins"] = [{"vertices": [3], "posKeys": WAVE}]
    scene = load(made)
    seen = np.ones(motion.positions.shape[:2], bool)
    seen[:3, 0] = False
    found = followed(scene, as_motion(scene, np.where(seen[..., None], motion.positions, np.nan), None, seen))
    first, second = pins_in(found.scene)
    assert (first, second["vertices"]) == (made["objects"][0]["pins"][0], [0])
    assert second["posKeys"]["times"][:2] == pytest.approx([0.0, 0.06])
    place = scene.cloths[0].positions[0] + list(second["posKeys"]["values"][1].values())
    assert place == pytest.approx(motion.positions[3, 0], abs=1e-15)


def test_held_vertices_without_a_marker_move_with_their_part():
    """A rail with six vertices, of which three are seen, moves and turns; another part, which nothing shows, stays."""
    scene = small("nG", 20, side=6, vertIsFixed=[i < 6 or i == 35 for i in range(36)])
    x = np.repeat(scene.cloths[0].positions[None], 20, axis=0)
    angle = 0.6 * np.sin(0.3 * np.arange(20))
    away = x[0, :6] - x[0, 0]
    turn = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    assert np.allclose(away[:, 1:], 0.0)  # along x
    x[:, :6] = x[0, 0] + away[:, :1] * turn[:, None] + 0.2 * np.sin(0.2 * np.arange(20))[:, None, None]
    seen = np.ones(x.shape[:2], bool)
    seen[:, [1, 3, 4, 35]] = False
    found = followed(scene, as_motion(scene, np.where(seen[..., None], x, np.nan), None, seen))
    assert found.vertices == 6
    played = simulate(found.scene, 20).positions
    np.testing.assert_allclose(played[:, :6], x[:, :6], atol=1e-12)  # m, rounding: places on a line stay affine
    np.testing.assert_array_equal(played[:, 35], x[:, 35])


def test_each_of_several_targets_has_its_own_path():
    scene, motion = waved()
    found = followed(scene, [motion, simulate(scene, 20), motion])
    assert found.vertices == 2
    assert [len(pair[1].cloths[0].pins) for pair in found.target[1:]] == [0, 1]


@pytest.mark.slow
def test_a_fit_finds_the_stiffness_where_the_edge_follows_and_is_far_off_where_it_is_held():
    scene, motion = waved()
    found = estimate(scene, motion, start=20.0)
    assert found.followed == 1
    assert found.scene.cloths[0].stiffness == pytest.approx(np.full(33, 30.0), rel=1e-4)  # the target is solved to 1e-5
    held = estimate(scene, motion, start=20.0, hold=True)
    assert (held.followed, held.scene.cloths[0].pins) == (0, ())
    assert held.rmse > 100 * found.rmse


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_target_that_moves_at_its_start_gives_its_velocities(noise):
    """A cloth that flies at 3 m/s is seen through noise of 0.1 m/s in them; one that falls from rest is not."""
    scene = load(even("nG", 12, vertIsFixed=[False] * 16))
    (cloth,) = scene.cloths
    v = np.broadcast_to([3.0, 0.0, -1.0], cloth.velocity.shape)
    moving = simulate(replace(scene, cloths=(replace(cloth, velocity=v),)), 12)
    rest = simulate(scene, 12)
    found, speed = with_start_velocity(scene, degrade(moving, noise=noise, seed=1) if noise else moving)
    h = scene.delta
    near = 4.0 * 2.55 * noise / h + 9.81 * h  # four standard deviations, and the first step's error of order h
    assert np.abs(found.cloths[0].velocity - v).max() < near
    assert speed == pytest.approx(np.sqrt(10.0), rel=0.1)
    assert with_start_velocity(scene, degrade(rest, noise=noise, seed=1) if noise else rest) == (scene, 0.0)
    given = replace(scene, cloths=(replace(cloth, velocity=v),))
    assert with_start_velocity(given, moving) == (given, 0.0)
