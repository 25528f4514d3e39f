"""From how many vertices on a subspace is predicted to pay."""

import numpy as np
import pytest
from helpers.scenes import cloth, document
from helpers.subspaces import scene_of

from clothfit.subspace.worth import FULL, STATE, frame, full_step, pays_from, sentence, vertices_from, worth

DIGITS = 0.06
"""Numbers of vertices have two digits."""


@pytest.mark.parametrize("way", list(STATE))
@pytest.mark.parametrize("iterations", [1, 4])
def test_it_pays_from_where_both_cost_the_same(way, iterations):
    count = vertices_from(way, iterations)
    above, below = int((1 + DIGITS) * count) + 2, int((1 - DIGITS) * count) - 2
    assert frame(above, 2 * above, way, iterations) < full_step(above, iterations)
    assert below < 1 or frame(below, 2 * below, way, iterations) > full_step(below, iterations)


def test_full_steps_are_those_that_were_measured_and_grow_with_every_vertex():
    for vertices, us in FULL:
        assert full_step(vertices) == pytest.approx(us, rel=1e-12)
    times = [full_step(n) for n in np.unique(np.geomspace(1, 1e6, 200).astype(int))]
    assert (np.diff(times) > 0).all()


def test_what_was_measured_scales_the_prediction():
    scene = scene_of(document(cloth(20, 20)))
    faces = len(scene.cloths[0].triangles)
    same = frame(400, faces, "physics", 1, 64)
    assert pays_from(scene, 0, 64, "physics", same, full_step(400)) == vertices_from("physics")
    assert pays_from(scene, 0, 64, "physics", 50.0, 50.0) == pytest.approx(400, rel=DIGITS)  # it costs the same here
    assert pays_from(scene, 0, 64, "physics", 500.0, 50.0) > 400
    assert pays_from(scene, 0, 64, "physics", 5.0, 50.0) < 400


def test_scenes_that_a_subspace_does_not_know_have_none():
    for fields in ({"integrationMethod": 1}, {"selfCollision": {"thickness": 0.01}}):
        assert worth(scene_of(document(cloth(), **fields))) is None
    small, large = (worth(scene_of(document(cloth(n, n)))) for n in (4, 60))
    assert not small.pays
    assert large.pays
    assert f"from about {large.vertices_from} vertices on" in sentence(large)
