"""Vertices that are pushed out of obstacles."""

import numpy as np
import pytest
from helpers.scenes import cloth, document, sphere
from helpers.subspaces import keys, scene_of, xyz

from clothfit.base.errors import InvalidInput
from clothfit.engine.system import build
from clothfit.subspace.frames import push_all

ZERO = xyz((0, 0, 0))[0]
CAPSULE = {"type": 2, "pos": xyz((1.2, 0.1, 0.8))[0], "rot": xyz((20, 40, 70))[0], "scale": xyz((0.8, 1.9, 0.8))[0],
           "radius2": 0.15, "friction": 0.2}
CLOTH = cloth(12, 10, 0.25)


def moved(colliders, distance, frames=1):
    """Random positions around the middle, as they were and as they are pushed; and the system."""
    own = build(scene_of(document(CLOTH, colliders=colliders)), 0, steps=max(frames - 1, 1))
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
    for frame in range(6):
        centre = own.inputs.centre[frame, 0]
        far = np.linalg.norm(pushed[frame] - centre, axis=1)
        assert far[own.vertex.free].min() >= 0.6 - 1e-12
        away = pushed[frame] - x[frame]
        np.testing.assert_allclose(np.cross(away, x[frame] - centre), 0.0, atol=1e-12)  # straight outward


def test_out_of_two_that_overlap():
    both = [sphere(0.5), {**sphere(0.5), "pos": xyz((0.6, 0, 0))[0], "friction": 0.1}]
    _, pushed, own = moved(both, 0.0)
    free = pushed[0][own.vertex.free]
    gaps = [np.linalg.norm(free - centre, axis=1) - 0.5 for centre in ((0, 0, 0), (0.6, 0, 0))]
    assert min(gap.min() for gap in gaps) > -0.02  # a few turns leave little where two surfaces meet


def test_what_cannot_be_pushed_is_said():
    with pytest.raises(InvalidInput, match="no obstacles"):
        moved([], 0.0)
    with pytest.raises(InvalidInput, match="at least 0"):
        moved([CAPSULE], -1.0)
