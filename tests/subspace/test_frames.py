"""What a player needs of a frame: normals, exact and by regression, and vertices pushed out of obstacles."""

import numpy as np
import pytest
from helpers.scenes import cloth, document, sphere
from helpers.subspaces import keys, scene_of, xyz

from clothfit.base.errors import InvalidInput
from clothfit.engine.system import build
from clothfit.subspace.frames import RIDGE, Decoder, angles, push_all, regression

OWN = scene_of(document(cloth(5, 4))).cloths[0]
SIZE, FRAMES = 6, 40


@pytest.fixture(scope="module")
def bent():
    """Coordinates (F, r), a basis and positions (F, n, 3) of a sheet that bends a little, with their normals."""
    rng = np.random.default_rng(5)
    q = rng.standard_normal((FRAMES, SIZE)) * np.geomspace(1.0, 0.01, SIZE)
    basis = 0.2 * rng.standard_normal((len(OWN.mass), 3, SIZE))
    x = OWN.positions + np.einsum("nir,fr->fni", basis, q)
    normals = np.zeros_like(x)
    a, b, c = (x[:, corner] for corner in OWN.triangles.T)
    for corner in OWN.triangles.T:
        np.add.at(normals, (slice(None), corner), np.cross(b - a, c - a))
    return q, basis, x, normals / np.linalg.norm(normals, axis=2, keepdims=True)


def test_positions_and_exact_normals_which_are_weighted_by_the_areas_of_faces(bent):
    q, basis, x, normals = bent
    decoder = Decoder(OWN.positions, basis, OWN.triangles)
    np.testing.assert_allclose(decoder.positions(q), x, atol=1e-5)  # single precision
    np.testing.assert_allclose(decoder.normals(x.astype(np.float32)), normals, atol=1e-5)


def test_the_regression_is_that_of_least_squares(bent):
    q, basis, x, normals = bent
    found = regression([(q[:15], x[:15]), (q[15:], x[15:])], OWN.triangles)
    known, flat = np.column_stack([np.ones(FRAMES), q]), normals.reshape(FRAMES, -1)
    best, *_ = np.linalg.lstsq(known, flat, rcond=None)
    left, least = (np.linalg.norm(known @ each - flat) for each in (found.reshape(-1, 1 + SIZE).T, best))
    assert least <= left * (1 + 1e-6)
    assert left <= least * (1 + RIDGE) + 1e-5  # single precision of the normals and of N
    made = Decoder(OWN.positions, basis, OWN.triangles, found).predicted(q)
    by = known @ found.reshape(-1, 1 + SIZE).T
    np.testing.assert_allclose(made, by.reshape(x.shape) / np.linalg.norm(by.reshape(x.shape), axis=2, keepdims=True),
                               atol=1e-5)  # fmt: skip
    assert np.nanmean(angles(made, normals)) < 10.0


def test_angles_are_exact_where_a_cosine_would_round():
    turn = np.radians(np.array([0.0, 1e-6, 90.0, 180.0]))
    a = np.tile([1.0, 0.0, 0.0], (4, 1))
    b = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    np.testing.assert_allclose(angles(a, b), np.degrees(turn), rtol=1e-9, atol=1e-13)
    assert np.isnan(angles(a[0], np.zeros(3)))


CAPSULE = {"type": 2, "pos": xyz((1.2, 0.1, 0.8))[0], "rot": xyz((20, 40, 70))[0], "scale": xyz((0.8, 1.9, 0.8))[0],
           "radius2": 0.15, "friction": 0.2}


def moved(colliders, distance, frames=1):
    """Random positions around the middle, as they were and as they are pushed; and the system."""
    own = build(scene_of(document(cloth(12, 10, 0.25), colliders=colliders)), 0, steps=max(frames - 1, 1))
    x = np.random.default_rng(3).uniform(-1.0, 2.0, (frames, 120, 3))
    pushed = x.copy()
    push_all(own, pushed, distance)
    return x, pushed, own


def ball_distance(x, ends, radii, count=20001):
    """The distance of points (n, 3) to what balls along a line cover: no formula of cones."""
    t = np.linspace(0.0, 1.0, count)
    centres, sizes = ends[0] + t[:, None] * (ends[1] - ends[0]), radii[0] + t * (radii[1] - radii[0])
    return np.array([(np.linalg.norm(p - centres, axis=1) - sizes).min() for p in x])


def test_out_of_a_capsule_with_two_radii():
    x, pushed, own = moved([CAPSULE], 0.03)
    rows = own.colliders.rows[0]
    r, s, length = rows[6]
    assert (r, s) == (0.4, 0.15)
    ends = rows[0] + np.array([[-0.5], [0.5]]) * length * rows[4]
    before, after = (ball_distance(each[0], ends, (r, s)) for each in (x, pushed))
    inside = (before < 0.03) & own.vertex.free
    assert inside.sum() > 5
    np.testing.assert_allclose(after[inside], 0.03, atol=1e-6)  # balls stand 1e-4 m apart
    np.testing.assert_allclose(np.linalg.norm(pushed[0] - x[0], axis=1)[inside], (0.03 - before)[inside], atol=1e-6)
    np.testing.assert_array_equal(pushed[0][~inside], x[0][~inside])


def test_out_of_a_sphere_that_moves_frame_by_frame():
    way = {"posKeys": keys([0, 0.1], (0, 0, 0), (0.5, 0.2, 0))}
    x, pushed, own = moved([sphere(0.6, **way)], 0.0, 6)
    centre = own.inputs.centre[:6, :1]
    assert np.linalg.norm(pushed - centre, axis=2)[:, own.vertex.free].min() >= 0.6 - 1e-12
    np.testing.assert_allclose(np.cross(pushed - x, x - centre), 0.0, atol=1e-12)  # straight outward


def test_out_of_two_that_overlap():
    both = [sphere(0.5), {**sphere(0.5), "pos": xyz((0.6, 0, 0))[0], "friction": 0.1}]
    _, pushed, own = moved(both, 0.0)
    free = pushed[0][own.vertex.free]
    gaps = [np.linalg.norm(free - centre, axis=1) - 0.5 for centre in ((0, 0, 0), (0.6, 0, 0))]
    assert min(gap.min() for gap in gaps) > -0.02  # a few turns leave little where two surfaces meet


@pytest.mark.parametrize(("obstacles", "distance", "said"), [([], 0.0, "no obstacles"), ([CAPSULE], -1.0, "at least")])
def test_what_cannot_be_pushed_is_said(obstacles, distance, said):
    with pytest.raises(InvalidInput, match=said):
        moved(obstacles, distance)
