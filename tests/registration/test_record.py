"""The record of a registration: rotations, angles, and a motion that is brought back."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import document, load_text

from clothfit.meshes.mesh import turned
from clothfit.motion.markers import rigid
from clothfit.motion.motion import as_motion
from clothfit.registration.record import Registration, rotation, rotation_derivative


def random_rotation(seed):
    return rotation(np.random.default_rng(seed).normal(size=3))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, np.pi, 6.0])
def test_rotation_is_the_exponential_of_the_cross_product(angle):
    from scipy.linalg import expm

    w = angle * np.array([2.0, -1.0, 2.0]) / 3.0
    W = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    assert rotation(w) == pytest.approx(expm(W), abs=1e-13)  # some roundings of numbers up to 6


@pytest.mark.parametrize("angle", [1e-6, 1e-3, 1.0, 3.0])
def test_the_derivative_of_a_rotation(angle):
    w, dw = angle * np.array([2.0, -1.0, 2.0]) / 3.0, np.array([0.3, 0.5, -0.2])
    e = 1e-5
    difference = (rotation(w + e * dw) - rotation(w - e * dw)) / (2 * e) @ rotation(w).T
    J = rotation_derivative(w) @ dw
    expected = np.array([[0, -J[2], J[1]], [J[2], 0, -J[0]], [-J[1], J[0], 0]])
    assert difference == pytest.approx(expected, abs=1e-9)  # e² of truncation, 1e-16 / e of rounding


def test_angles_are_those_that_turn_a_mesh():
    points = np.random.default_rng(0).normal(size=(5, 3))
    for R in [*map(random_rotation, range(8)), rotation(np.array([np.pi / 2, 0.0, 0.0]))]:
        found = Registration(rotation=R)
        assert turned(points, found.angles) == pytest.approx(points @ R.T, abs=1e-7)  # sqrt(ε) of arcsin at 90°


def test_rigid_finds_the_way_back():
    points, R, d = np.random.default_rng(1).normal(size=(9, 3)), random_rotation(5), np.array([1.0, -2.0, 0.5])
    found, moved = rigid(points, points @ R.T + d)
    assert found == pytest.approx(R, abs=1e-12)
    assert moved == pytest.approx(d, abs=1e-12)


def test_a_motion_is_brought_into_the_scene():
    scene = load_text(json.dumps(document()))
    n = sum(scene.vertex_counts)
    times = np.arange(12) * scene.delta
    motion = as_motion(scene, np.random.default_rng(2).normal(size=(12, n, 3)), times)
    R, d = random_rotation(3), np.array([0.3, -0.2, 0.1])
    seen = replace(motion, times=1.1 * times + 0.03, positions=(motion.positions - d) @ R)
    back = Registration(1.1, 0.03, R, d).applied(seen, scene.delta)
    assert back.times == pytest.approx(times, abs=1e-12)
    assert back.times[0] == 0.0
    assert back.positions == pytest.approx(motion.positions, abs=1e-12)


def test_frames_before_the_scene_begins_are_left_out():
    scene = load_text(json.dumps(document()))
    n = sum(scene.vertex_counts)
    motion = as_motion(scene, np.zeros((12, n, 3)))
    late = Registration(offset=3.5 * scene.delta).applied(motion, scene.delta)
    assert late.times == pytest.approx((np.arange(4, 12) - 3.5) * scene.delta)
    assert len(late.positions) == 8


def test_what_is_taken_back_lies_where_it_was():
    turn, move = rotation(np.array([0.3, -1.1, 0.4])), np.array([0.2, 3.0, -1.0])
    known = Registration(rotation=turn, translation=move, scale=1.7)
    x = np.random.default_rng(0).normal(size=(4, 5, 3))
    np.testing.assert_allclose(known.taken_back(known.placed(x)), x, atol=1e-14)  # rounding
