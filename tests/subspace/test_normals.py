"""Normals of decoded frames: exact, and by regression."""

import numpy as np
from helpers.scenes import cloth, document
from helpers.subspaces import scene_of

from clothfit.subspace.frames import RIDGE, Decoder, angles, regression

OWN = scene_of(document(cloth(5, 4))).cloths[0]
SIZE, FRAMES = 6, 40


def motion():
    """Coordinates (F, r), a basis and positions (F, n, 3) of a sheet that bends a little."""
    rng = np.random.default_rng(5)
    q = rng.standard_normal((FRAMES, SIZE)) * np.geomspace(1.0, 0.01, SIZE)
    basis = 0.2 * rng.standard_normal((len(OWN.mass), 3, SIZE))
    return q, basis, OWN.positions + np.einsum("nir,fr->fni", basis, q)


def by_numpy(x):
    """The normals (n, 3) at positions (n, 3)."""
    a, b, c = (x[corner] for corner in OWN.triangles.T)
    out = np.zeros_like(x)
    for corner in OWN.triangles.T:
        np.add.at(out, corner, np.cross(b - a, c - a))
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def test_exact_ones_are_weighted_by_the_areas_of_faces():
    _, basis, x = motion()
    decoder = Decoder(OWN.positions, basis, OWN.triangles)
    for made, frame in zip(decoder.normals(x[:5].astype(np.float32)), x, strict=False):
        np.testing.assert_allclose(made, by_numpy(frame), atol=1e-5)  # single precision


def test_the_regression_is_that_of_least_squares():
    q, _, x = motion()
    found = regression([(q[:15], x[:15]), (q[15:], x[15:])], OWN.triangles)
    normals = np.array([by_numpy(frame) for frame in x]).reshape(FRAMES, -1)
    known = np.column_stack([np.ones(FRAMES), q])
    best, *_ = np.linalg.lstsq(known, normals, rcond=None)
    left, least = (np.linalg.norm(known @ each - normals) for each in (found.reshape(-1, 1 + SIZE).T, best))
    assert least <= left * (1 + 1e-6)
    assert left <= least * (1 + RIDGE) + 1e-5  # single precision of the normals and of N


def test_one_product_gives_those_of_many_frames():
    q, basis, x = motion()
    decoder = Decoder(OWN.positions, basis, OWN.triangles, regression([(q, x)], OWN.triangles))
    places = decoder.positions(q)
    np.testing.assert_allclose(places, x, atol=1e-5)
    together = decoder.predicted(q).copy()
    for frame in range(FRAMES):
        np.testing.assert_allclose(together[frame], decoder.predicted(q[[frame]])[0], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(together, axis=2), 1.0, atol=1e-5)
    assert np.nanmean(angles(together, np.array([by_numpy(frame) for frame in x]))) < 10.0


def test_angles_are_exact_where_a_cosine_would_round():
    turn = np.radians(np.array([0.0, 1e-6, 90.0, 180.0]))
    a = np.tile([1.0, 0.0, 0.0], (4, 1))
    b = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    np.testing.assert_allclose(angles(a, b), np.degrees(turn), rtol=1e-9, atol=1e-13)
    assert np.isnan(angles(a[0], np.zeros(3)))
