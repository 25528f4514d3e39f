"""Motions on few shapes: their number, their error."""

import numpy as np
import pytest
from helpers.scene_files import wave

from clothfit.formats.morphs import reduced


# Displacements from the first frame of a motion of rank 3 have rank 3 at most; the rest is rounding to float32, whose
# relative error is 6e-8, of numbers up to about 5 that are added.
def test_a_motion_of_few_shapes_takes_few_targets():
    motion = wave(rank=3)
    morphs = reduced(motion.positions, 1e-5)
    assert len(morphs.targets) == 3
    assert morphs.error < 2e-6
    assert np.abs(morphs.weights).max() <= 1


# Frames of more and more different sizes, or coordinates; of frames there are fewer than coordinates, or more.
@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-5])
@pytest.mark.parametrize("shape", [(20, 9, 3), (60, 9, 3)])
def test_the_largest_error_is_below_the_tolerance_and_one_target_less_is_not_enough(shape, tolerance):
    positions = np.random.default_rng(0).normal(size=shape) * np.geomspace(1, 1e-6, shape[0])[:, None, None]
    morphs = reduced(positions, tolerance)
    assert morphs.error <= tolerance
    fewer = np.einsum("fk,knc->fnc", morphs.weights[:, :-1].astype(float), morphs.targets[:-1].astype(float))
    assert np.linalg.norm(fewer + morphs.base - positions, axis=2).max() > tolerance
