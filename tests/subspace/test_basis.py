"""The basis: orthonormal in the masses, best for what was recorded, and the lowest modes of vibration."""

import numpy as np
import pytest
from helpers.scenes import cloth, document
from helpers.subspaces import scene_of

from clothfit.engine.system import build
from clothfit.subspace import basis

SCENE = scene_of(document(cloth(5, 4)))
SYSTEM = build(SCENE, 0)
rng = np.random.default_rng(5)


class Recorded:
    """Motions in memory, in place of a file."""

    def __init__(self, frames):
        shapes = rng.standard_normal((6, 20, 3)) * 0.5 ** np.arange(6)[:, None, None]
        self.x = [np.einsum("tk,kic->tic", rng.standard_normal((frames, 6)), shapes) for _ in range(3)]
        for x in self.x:
            x[:, ~SYSTEM.vertex.free] = 0.0

    def motion(self, episode, cloth):
        return self.x[episode].copy(), np.ones(len(self.x[episode]), bool)


@pytest.mark.parametrize("changes", [0.0, 0.7])
@pytest.mark.parametrize("frames", [4, 60, 600], ids=["fewer frames than coordinates", "more", "many"])
def test_what_is_left_out_is_what_the_projection_misses(frames, changes):
    data = Recorded(frames)
    found = basis.decompose(data, 0, [SYSTEM] * 3, 40, [0, 1, 2], changes)
    mass = SYSTEM.vertex.mass
    flat = found.vectors.reshape(-1, found.vectors.shape[2])
    weights = np.repeat(mass, 3)
    assert found.vectors.shape[2] == 6  # the motions have no more
    np.testing.assert_allclose(flat.T @ (weights[:, None] * flat), np.eye(6), atol=1e-9)
    assert not found.vectors[~SYSTEM.vertex.free].any()
    x = np.concatenate(data.x).reshape(-1, len(flat))
    for k in range(6):
        rest = x - (x * weights) @ flat[:, :k] @ flat[:, :k].T
        left = np.sqrt((rest**2 @ weights).sum() / (len(x) * mass[SYSTEM.vertex.free].sum()))
        assert found.left_out[k] == pytest.approx(left, rel=1e-6, abs=1e-9)
    assert found.left_out[6] < 1e-6 * found.left_out[0]


def test_changes_count_where_they_are_asked_for():
    """A large slow shape and a small quick one: the first vector is the one, or with much weight the other."""
    slow, quick = np.zeros((2, 20, 3))
    slow[7, 0], quick[12, 1] = 1.0, 0.3
    t = np.arange(50)[:, None, None]
    data = Recorded(0)
    data.x = [np.cos(2 * np.pi * t / 50) * slow + (-1.0) ** t * quick]
    for changes, vertex in ((0.0, 7), (5.0, 12)):
        first = basis.decompose(data, 0, [SYSTEM], 2, [0], changes).vectors[:, :, 0]
        assert np.abs(first).max(axis=1).argmax() == vertex


def test_the_modes_of_a_string_are_sines():
    """A string of equal masses under tension T: ω² = 4 T/(m a) sin²(j π/2(n+1)), across it, for mode j of n."""
    count, a, k, m, stretched = 12, 0.1, 50.0, 0.02, 1.05
    n = count - 1
    made = {
        "vertPos": [{"x": i * a, "y": 0.0, "z": 0.0} for i in range(count + 1)],
        "vertIsFixed": [i in (0, count) for i in range(count + 1)],
        "vertMass": [m] * (count + 1), "springs": [v for i in range(count) for v in (i, i + 1)],
        "springStiffness": [k] * count, "triangles": [], "dragCoefficient": 0.0, "damping": 0.0,
        "optimizationSettings": "nn",
    }  # fmt: skip
    system = build(scene_of(document(made)), 0)
    modes = basis.vibration(system, system.x0 * stretched, 6)
    j, i = np.arange(1, 4), np.arange(1, count)
    shape = np.sin(np.outer(i, j) * np.pi / count)
    across = modes[1:count, 1:].reshape(-1, 6)  # two of each frequency, along y and z
    for pair in range(3):
        own = across[:, 2 * pair : 2 * pair + 2].reshape(n, 2, 2)
        expected = shape[:, pair] / np.linalg.norm(shape[:, pair])
        fit = np.einsum("i,icm->cm", expected, own)
        np.testing.assert_allclose(own, np.einsum("i,cm->icm", expected, fit), atol=1e-6)
    assert abs(modes[:, 0]).max() < 1e-6


def test_modes_take_the_place_of_the_last_vectors():
    found = basis.decompose(Recorded(60), 0, [SYSTEM] * 3, 40, [0, 1, 2])
    made = basis.enriched(found, SYSTEM, 6, SYSTEM.x0, 2)
    flat = made.reshape(-1, made.shape[2])
    np.testing.assert_array_equal(made[:, :, :4], found.vectors[:, :, :4])
    weights = np.repeat(SYSTEM.vertex.mass, 3)
    np.testing.assert_allclose(flat.T @ (weights[:, None] * flat), np.eye(6), atol=1e-9)
