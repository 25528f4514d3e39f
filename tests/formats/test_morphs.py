"""Motions on few shapes: their number, their error."""

import numpy as np
import pytest
from helpers.scene_files import wave

from clothfit.formats.glb import reduced


# Displacements from the first frame of a motion of rank 3 have rank 3 at most; the rest is rounding to float32, whose
# relative error is 6e-8, of numbers up to about 5 that are added.
def test_a_motion_of_few_shapes_takes_few_targets():
    motion = wave(rank=3)
    morphs = reduced(motion.positions, 1e-5)
    assert len(morphs.targets) == 3
    assert morphs.error < 2e-6


# Frames of more and more different sizes, or coordinates; of frames there are fewer than coordinates, or more.
@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-5])
@pytest.mark.parametrize("shape", [(20, 9, 3), (60, 9, 3)])
def test_the_largest_error_is_below_the_tolerance_and_one_target_less_is_not_enough(shape, tolerance):
    positions = np.random.default_rng(0).normal(size=shape) * np.geomspace(1, 1e-6, shape[0])[:, None, None]
    morphs = reduced(positions, tolerance)
    assert morphs.error <= tolerance
    weights, targets = morphs.weights.astype(float), morphs.targets.astype(float)
    without = weights - np.append(np.zeros(weights.shape[1] - 1), 1) * (weights - weights[0])  # the last one at rest
    fewer = np.einsum("fk,knc->fnc", without, targets)
    assert np.linalg.norm(fewer + morphs.base - positions, axis=2).max() > tolerance


# Viewers clamp weights to 0 … 1. The sum is one of float32 numbers up to about 10, with a relative error of 6e-8 each.
@pytest.mark.parametrize("shape", [(1, 5, 3), (2, 5, 3), (30, 9, 3), (60, 9, 3)])
def test_weights_within_0_and_1_give_the_motion_and_use_all_of_it(shape):
    positions = np.random.default_rng(1).normal(size=shape)
    morphs = reduced(positions, 1e-5)
    assert morphs.weights.min() >= 0
    assert morphs.weights.max() <= 1
    whole = morphs.base + np.einsum("fk,knc->fnc", morphs.weights.astype(float), morphs.targets.astype(float))
    assert np.linalg.norm(whole - positions, axis=2).max() == pytest.approx(morphs.error, abs=1e-12)
    assert morphs.error < 1e-5
    if shape[0] > 1:
        np.testing.assert_array_equal(morphs.weights.min(axis=0), 0)
        np.testing.assert_array_equal(morphs.weights.max(axis=0), 1)


def test_a_cloth_that_moves_one_way_keeps_its_first_frame_as_the_base():
    first, way = np.random.default_rng(2).normal(size=(2, 9, 3))
    for sign in (1, -1):
        morphs = reduced(first + sign * np.linspace(0, 1, 12)[:, None, None] * way, 1e-5)
        assert len(morphs.targets) == 1
        np.testing.assert_allclose(morphs.base, first, atol=1e-6)  # float32 of numbers up to 3
        np.testing.assert_allclose(morphs.targets[0], sign * way, atol=1e-6)
