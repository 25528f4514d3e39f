"""How a model is judged against the full simulation, and from how many vertices on it is predicted to pay."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import cloth, document
from helpers.subspaces import model_of, moving, scene_of, whole

from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.motion.motion import rms
from clothfit.motion.simulate import simulate
from clothfit.subspace.break_even import FULL, STATE, break_even, frame, full_step, pays_from, sentence, vertices_from
from clothfit.subspace.validation import GOES_ON, bands, compare, floor, growth

pytestmark = pytest.mark.slow  # compiles motions with inputs

SCENE = scene_of(moving())
FRAMES = 30
LOOSE = {"springStiffness": [1e-9] * 23, "dragCoefficient": 0.0, "damping": 0.0, "vertIsFixed": [False] * 12}


def test_a_basis_of_all_motions_leaves_nothing_out():
    """The model of all motions of the cloth, in double precision."""
    some, system = model_of(SCENE), build(SCENE, 0, steps=FRAMES - 1)
    part = replace(some.parts[0], basis=whole(system))
    over = compare(replace(some, parts=(part,)), SCENE, FRAMES)
    found = over.found
    assert max(found.relative_rmse, found.drift, found.energy) < 1e-5  # its steps sum up in single precision
    assert found.normals.pop("faces") < 0.01
    assert found.normals == {}
    assert not found.forgets
    assert found.floor == 0.0  # not sought
    np.testing.assert_allclose(over.projected(0), over.coordinates[0], atol=1e-4)
    x = over.full.positions - system.x0
    assert floor(part.basis, system, x, SCENE.tolerance) < 1e-8  # what is left is rounding


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


# --- a small difference at the start grows by known laws, and where a sheet buckles


def test_in_free_fall_it_stays():
    scene = scene_of(document(cloth(4, 3, **LOOSE)))
    assert growth(scene, simulate(scene, FRAMES)) == pytest.approx(1.0, abs=1e-6)  # what is left of the springs


def test_of_a_cloth_that_hangs_it_decays_and_of_one_that_is_pushed_together_it_grows():
    held = [i < 4 for i in range(12)]
    scene = scene_of(document(cloth(4, 3, damping=2.0, dragCoefficient=0.0, vertIsFixed=held)))
    upwards = np.array(scene.cloths[0].positions[11] - scene.cloths[0].positions[3])
    turned = replace(scene, gravity=9.81 * upwards / np.linalg.norm(upwards))
    pushed = replace(scene, gravity=-turned.gravity)
    hanging, stretched, grown = (growth(each, simulate(each, 40)) for each in (scene, turned, pushed))
    assert stretched < 1.0
    assert grown > 3.0 * max(stretched, hanging)


def test_what_a_basis_leaves_out_of_a_free_flight_stays_left_out():
    """Points that nothing holds together fly on with the mean velocity, by mass, if that is all a basis has."""
    scene = scene_of(document(cloth(4, 3, **LOOSE), colliders=[]))
    system = build(scene, 0, steps=FRAMES - 1)
    v = np.random.default_rng(0).standard_normal(system.v0.shape)
    system = system._replace(v0=v)
    x = rollout(system, FRAMES - 1, 1e-12)[0].x - system.x0
    basis = np.broadcast_to(np.eye(3), (12, 3, 3)) / np.sqrt(system.vertex.mass.sum())
    rest = v - np.average(v, axis=0, weights=system.vertex.mass)
    time = system.h * np.arange(FRAMES)[int(GOES_ON[0] * FRAMES) :]
    lost = np.sqrt((rest**2).sum(axis=1).mean() * (time**2).sum() / FRAMES)
    assert floor(basis, system, x, 1e-12) == pytest.approx(lost / rms(x), rel=1e-5)  # the springs that are left


# --- the predicted times

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
    assert [full_step(vertices) for vertices, _ in FULL] == pytest.approx([us for _, us in FULL], rel=1e-12)
    times = [full_step(n) for n in np.unique(np.geomspace(1, 1e6, 200).astype(int))]
    assert (np.diff(times) > 0).all()


def test_what_was_measured_scales_the_prediction():
    scene = scene_of(document(cloth(20, 20)))
    same = frame(400, len(scene.cloths[0].triangles), "physics", 1, 64)
    assert pays_from(scene, 0, 64, "physics", same, full_step(400)) == vertices_from("physics")
    slow, alike, fast = (pays_from(scene, 0, 64, "physics", us, 50.0) for us in (500.0, 50.0, 5.0))
    assert slow > 400 > fast
    assert alike == pytest.approx(400, rel=DIGITS)  # it costs the same here


def test_scenes_that_a_subspace_does_not_know_have_none():
    for fields in ({"integrationMethod": 1}, {"selfCollision": {"thickness": 0.01}}):
        assert break_even(scene_of(document(cloth(), **fields))) is None
    small, large = (break_even(scene_of(document(cloth(n, n)))) for n in (4, 60))
    assert (small.pays, large.pays) == (False, True)
    assert f"from about {large.vertices_from} vertices on" in sentence(large)
