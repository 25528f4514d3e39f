"""Motions that come to rest go on where the recorded ones end."""

import numpy as np
import pytest
from helpers.scenes import cloth, document
from helpers.subspaces import scene_of, whole

from clothfit.engine.system import build
from clothfit.subspace.inputs import Ranges, episodes
from clothfit.subspace.network.learn import lesson
from clothfit.subspace.recording import Data, record

pytestmark = pytest.mark.slow  # compiles motions with inputs


STEPS = 60


def lesson_of(tmp_path, **fields):
    """What recorded motions of a cloth in gusts teach a network on a basis of all motions."""
    scene, ranges = scene_of(document(cloth(4, 3, **fields), optimizationIterations=STEPS)), Ranges(3.0)
    record(scene, episodes(scene, ranges, 4, 1.2, 0), ranges, STEPS, tmp_path / "data.npz")
    return lesson(Data(tmp_path / "data.npz"), 0, range(4), whole(build(scene, 0, steps=1)))


def test_pieces_follow_the_recorded_frames_and_each_other(tmp_path):
    given = lesson_of(tmp_path, damping=2.0)
    count = len(given.rest.z) // 2  # of episodes 1 and 3
    for number, episode in enumerate((1, 3)):
        first = given.rest.z[number * count]
        # a basis of all motions: the same steps, but for the tolerance 1e-6 of their linear systems
        np.testing.assert_allclose(first[:2], given.motions.z[episode, -2:], atol=1e-4)
        for k in range(count - 1):
            piece, after = given.rest.z[number * count + k : number * count + k + 2]
            np.testing.assert_array_equal(piece[-2:], after[:2])
        speed = np.abs(np.diff(given.rest.z[number * count : (number + 1) * count], axis=1)).max(axis=(1, 2))
        assert speed[-1] < 1e-3 * speed[0]  # damping of 2/s for 10 s
    assert np.abs(given.rest.w[-1]).max() < 1e-12  # the wind is over


def test_a_cloth_that_falls_for_ever_has_none(tmp_path):
    """Nothing holds it: ten times as long, it would fall a hundred times as far as in the recorded frames."""
    assert lesson_of(tmp_path, vertIsFixed=[False] * 12).rest is None
