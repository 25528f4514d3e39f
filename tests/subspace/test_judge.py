"""How a model is judged against the full simulation."""

import numpy as np
import pytest
from helpers.subspaces import model_of, moving, scene_of, whole

from clothfit.engine.system import build
from clothfit.subspace.judge import bands, compare
from clothfit.subspace.model import Model, Part

pytestmark = pytest.mark.slow  # compiles motions with inputs

SCENE = scene_of(moving())
FRAMES = 30


def exact(normals=None):
    """The model of all motions of the cloth, in double precision."""
    some = model_of(SCENE)
    basis = whole(build(SCENE, 0, steps=1))
    part = Part(basis, some.parts[0].chosen, np.zeros((2, basis.shape[2])), normals)
    return Model(some.text, "", (part,), some.limits)


def test_a_basis_of_all_motions_leaves_nothing_out():
    over = compare(exact(), SCENE, FRAMES)
    found = over.found
    assert found.relative_rmse < 1e-5  # its steps sum up in single precision
    assert found.drift < 1e-5
    assert found.energy < 1e-5
    assert found.normals["faces"] < 0.01
    assert set(found.normals) == {"faces"}
    assert not found.forgets
    assert found.floor == 0.0  # not sought
    np.testing.assert_allclose(over.projected(0), over.coordinates[0], atol=1e-4)


def test_a_few_vectors_miss_a_part_and_say_so():
    model = model_of(SCENE, 3, normals=True)
    found = compare(model, SCENE, FRAMES).found
    assert found.forgets
    assert 0 < found.floor < found.relative_rmse
    assert 0 < found.drift < found.max_error
    assert found.energy > 0.01
    assert found.normals["regression"] > 10.0  # they are random
    assert set(found.us_per_frame) == {"state", "decode", "normals", "regression"}
    assert found.us_whole < sum(found.us_per_frame.values())
    assert [end for end, _ in found.over_time] == [6, 12, 18, 24, 30]


def test_spectra_do_not_see_a_shift_in_time():
    t = np.arange(512) / 512
    wave = np.sin(2 * np.pi * 8 * t)[:, None, None] * np.ones((1, 2, 3))
    shifted, larger, own = (bands(each)[1] for each in (np.roll(wave, 77, axis=0), 1.5 * wave, wave))
    np.testing.assert_allclose(shifted, own, atol=1e-9)
    assert np.linalg.norm(larger) == pytest.approx(1.5 * np.linalg.norm(own))
