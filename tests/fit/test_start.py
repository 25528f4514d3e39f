"""The start that knows nothing of the scene's own flagged values, the proportions of one fabric, and a steady wind
before its keys.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.physics import scene, thing
from helpers.scenes import cloth, document, even, sphere, trial
from helpers.strangers import WIND, windy

import clothfit
from clothfit.fit.start import (
    COARSE_FRAMES,
    best_scales,
    decades,
    fabric,
    is_steady,
    neutral,
    neutral_start,
    proportions,
    steadied,
    undetermined,
    values_by,
)
from clothfit.meshes import mesh
from clothfit.meshes.mesh import Mesh
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import LOWER, UPPER, parameters, with_parameters
from clothfit.scene.keys import Keys
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow

FINEST = 10**0.125
"""Ratio of neighbouring values on the finest grid."""


FREE = {"contact": "G"}
AIR = {"triangles": [], "dragCoefficient": 0.0}


@pytest.mark.parametrize(
    ("settings", "fields", "factor"),
    [
        ("GG", AIR, "feels neither air nor spheres, so its motion shows masses and stiffnesses"),
        ("GG", {"fit": {"dragCoefficient": "G"}}, "feels no spheres, so its motion shows masses, stiffnesses and drag"),
        ("GG", {}, None),
        ("nG", AIR, None),
    ],
)
def test_values_that_are_known_up_to_a_common_factor_are_named(settings, fields, factor):
    known = [] if factor is None else [f"objects[0] {factor} only up to one common factor"]
    one = {**cloth(2, 2), "optimizationSettings": settings, **fields}
    assert undetermined(load(document(one))) == known


@pytest.mark.parametrize(
    ("fit", "plain", "warned"),
    [({}, False, False), ({"friction": "G"}, False, False), (FREE, False, True), (FREE, True, False)],
)
def test_contacts_that_are_fitted_scale_with_masses_and_stiffnesses(fit, plain, warned):
    one = {**cloth(2, 2), "dragCoefficient": 0.0, "optimizationSettings": "LL"}
    colliders = [sphere(1.1, friction=0.2), *([sphere(1.1)] if plain else [])]
    made = load(document(one, colliders=colliders, fit=fit))
    known = ["objects[0] shows masses, stiffnesses and those of contacts only up to one common factor"]
    assert undetermined(made) == (known if warned else [])
    twice = made.with_values([2 * made.cloths[0].mass], [2 * made.cloths[0].stiffness], contact=2 * made.contact)
    # the same motion but for rounding: with plain spheres, whose stiffness is given, it is another
    same = np.allclose(simulate(made, 8).positions, simulate(twice, 8).positions, atol=1e-9)
    assert same != plain


@pytest.mark.parametrize(("settings", "true"), [("Gn", 0.02), ("nG", 30.0), ("Ln", 0.02), ("nL", 30.0)])
def test_one_value_is_found_to_the_finest_grid(settings, true):
    scene = load(even(settings))
    starts = best_scales(Objective(scene, simulate(scene)), [fabric(scene), neutral(scene)])
    assert [p.shape for p in starts] == [parameters(scene).shape] * 2  # in the proportions of a fabric, and all alike
    start = next(p for p in starts if len(set(p.tolist())) == 1)
    assert true / FINEST < start[0] < true * FINEST


def test_the_best_pattern_comes_first():
    scene = load(even("nL"))
    motion = simulate(scene)
    aim = Objective(scene, motion)
    wild = np.exp(np.random.default_rng(1).normal(size=33))
    for patterns in ([wild, np.ones(33)], [np.ones(33), wild]):
        starts = best_scales(aim, patterns)
        assert len(set(starts[0].tolist())) == 1
        assert aim.cost(starts[0]) < aim.cost(starts[1])
        # a pattern is followed up to one factor; rounding
        np.testing.assert_allclose(starts[1] / starts[1][0], wild / wild[0], rtol=1e-12)


def test_a_fabric_has_its_proportions_and_the_neutral_values():
    scene, one = (load(even(settings, nx=3, ny=3)) for settings in ("LL", "GG"))
    np.testing.assert_array_equal(fabric(scene), np.concatenate(proportions(scene.cloths[0])))
    np.testing.assert_array_equal(fabric(one), neutral(one))


@pytest.mark.parametrize("settings", ["Ln", "nG", "LL", "GL"])
def test_it_does_not_depend_on_the_flagged_values(settings):
    scene = load(trial(settings))
    motion = simulate(scene)
    others = [with_parameters(scene, p) for p in (7 * parameters(scene), np.ones(len(parameters(scene))))]
    first, *rest = (best_scales(Objective(s, motion), [fabric(s), neutral(s)]) for s in (scene, *others))
    for start in rest:
        np.testing.assert_array_equal(start, first)


def test_only_the_first_frames_count():
    scene = load(even("nG", 2 * COARSE_FRAMES))
    motion = simulate(scene)
    positions = motion.positions.copy()
    positions[COARSE_FRAMES:] += 5.0
    later = Motion(positions, motion.times, motion.vertex_counts)
    starts = [neutral_start(Objective(scene, m)) for m in (motion, later)]
    np.testing.assert_array_equal(*starts)
    positions[COARSE_FRAMES - 1] += 5.0
    assert (neutral_start(Objective(scene, later)) != starts[0]).any()


@pytest.mark.parametrize(
    ("fields", "shown"), [({}, np.arange(16) == 15), ({"integrationMethod": 0, "delta": 0.004}, np.ones(16, bool))]
)
def test_what_was_not_seen_does_not_count_and_values_that_diverge_are_passed_over(fields, shown):
    scene = load(even("nG", 30, **fields))
    motion, seen = simulate(scene), np.tile(shown, (30, 1))
    positions = np.where(seen[:, :, None], motion.positions, np.nan)
    start = neutral_start(Objective(scene, Motion(positions, motion.times, (16,), seen)))
    assert 30.0 / FINEST < start[0] < 30.0 * FINEST


def test_where_every_value_diverges_it_still_gives_values_within_the_bounds():
    scene = load(even("nG", 40, integrationMethod=0, delta=1.0, damping=1e3))
    still = np.broadcast_to(scene.cloths[0].positions, (40, 16, 3)).copy()
    start = neutral_start(Objective(scene, Motion(still, np.arange(40.0), (16,))))
    assert LOWER <= start[0] <= UPPER


def test_decades_end_where_numbers_do():
    """Bounds relative to values near the largest number are infinite."""
    assert decades(SimpleNamespace(ends=(1e306, np.inf))) == (306.0, 307.0, 308.0)
    assert decades(SimpleNamespace(ends=(1e-1, 1e1))) == (-1.0, 0.0, 1.0)


# --- the proportions of one fabric


RNG = np.random.default_rng(12)


def uneven():
    """A plane whose vertices are moved, so that no two triangles are alike."""
    flat = mesh.plane(4, 1.0, 0.7)
    return Mesh(flat.positions + 0.02 * RNG.normal(size=flat.positions.shape), flat.triangles)


MESHES = {"square": mesh.plane(5, 1.0), "oblong": mesh.plane(6, 2.0, 0.9, upright=True), "uneven": uneven()}


def fabric_of(shape, bending=True, **fields):
    """A cloth of one fabric."""
    held = np.zeros(len(shape.positions), bool)
    own = mesh.object_document(shape, held, density=0.2, stiffness=40.0, bending=bending)
    return scene({**own, **fields}).cloths[0]


def relative(values):
    return values / np.exp(np.log(values).mean())


@pytest.mark.parametrize("bending", [True, False])
@pytest.mark.parametrize("name", MESHES)
def test_a_fabric_of_the_front_end_has_its_proportions(name, bending):
    one = fabric_of(MESHES[name], bending)
    mass, stiffness = proportions(one)
    np.testing.assert_allclose(mass, relative(one.mass), rtol=1e-13)  # rounding
    np.testing.assert_allclose(stiffness, relative(one.stiffness), rtol=1e-13)


def test_in_whatever_order_the_springs_and_vertices_stand():
    shape = MESHES["uneven"]
    one = fabric_of(shape)
    mass, stiffness = proportions(one)
    vertex, spring = RNG.permutation(len(mass)), RNG.permutation(len(stiffness))
    place = np.argsort(vertex)  # of each old vertex
    ends = place[one.springs[spring]]
    turned = np.where(RNG.uniform(size=(len(ends), 1)) < 0.5, ends, ends[:, ::-1])  # and whichever end comes first
    other = scene(thing(shape.positions[vertex], turned, place[shape.triangles])).cloths[0]
    found = proportions(other)
    np.testing.assert_allclose(found[0], mass[vertex], rtol=1e-13)  # rounding
    np.testing.assert_allclose(found[1], stiffness[spring], rtol=1e-13)


def test_what_belongs_to_no_triangle_has_the_mean_of_the_rest():
    shape = MESHES["uneven"]
    n = len(shape.positions)
    one = fabric_of(shape)
    points = np.concatenate([shape.positions, [[5.0, 0.0, 0.0]]])
    ends = np.concatenate([one.springs, [[0, n], [0, n - 1]]])  # to a vertex of no face, and across the cloth
    mass, stiffness = proportions(scene(thing(points, ends, shape.triangles)).cloths[0])
    assert mass[-1] == 1.0
    assert stiffness[-2:].tolist() == [1.0, 1.0]
    np.testing.assert_allclose(mass[:-1], proportions(one)[0], rtol=1e-13)  # rounding
    np.testing.assert_allclose(stiffness[:-2], proportions(one)[1], rtol=1e-13)


def test_without_triangles_all_are_alike():
    for own, sizes in ((cloth(3, 3, triangles=[]), (9, 16)), (thing(np.eye(3)), (3, 0))):
        assert [each.tolist() for each in proportions(scene(own).cloths[0])] == [[1.0] * size for size in sizes]


def test_an_edge_of_three_triangles_stands_for_all_of_them():
    points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 2), (0, -3, 0)]
    one = scene(thing(points, [(0, 1), (0, 2)], [(0, 1, 2), (0, 1, 3), (0, 1, 4)])).cloths[0]
    found = proportions(one)[1]
    assert found[0] / found[1] == pytest.approx(3.0 / 0.5, rel=1e-14)  # areas 0.5 + 1 + 1.5, and 0.5; lengths 1


# --- a steady wind before its keys


def gusty(values, flags=None, **fields):
    """The sheet in wind with keys each 0.1 s, what is fitted of the scene as `flags` say: the keys."""
    values = np.array(values, float)
    keys = Keys(0.1 * np.arange(len(values)), values, "linear", place="windVelKeys")
    return replace(windy(**fields), wind_keys=keys, fits={"gusts": "L"} if flags is None else flags)


STEADY, SWINGING = np.tile([1.0, 2.0, 3.0], (3, 1)), [(0, 0, 0), (1, -1, 2), (0, 2, -1)]


def test_steady_is_where_keys_that_are_fitted_have_one_value():
    assert is_steady(gusty(STEADY))
    assert not is_steady(gusty(SWINGING))
    assert not is_steady(gusty(STEADY, flags={"wind": "G"}))
    assert not is_steady(gusty(STEADY[:1]))
    assert not is_steady(windy())


@pytest.mark.parametrize("flags", [{"gusts": "L"}, {"gusts": "L", "wind": "G"}])
def test_a_steady_wind_gives_the_same_motion_and_goes_back_to_the_keys(flags):
    scene = gusty(STEADY, flags, frames=12)
    steady = steadied(scene)
    assert steady.fits == {"wind": "G"}
    np.testing.assert_allclose(steady.wind, np.add(WIND, STEADY[0]), rtol=1e-15)
    np.testing.assert_allclose(simulate(steady).positions, simulate(scene).positions, atol=1e-15)
    p = values_by(steady, scene)
    np.testing.assert_allclose(simulate(with_parameters(scene, p)).positions, simulate(scene).positions, atol=1e-15)
    p = values_by(with_parameters(steady, 2.0 * parameters(steady)), scene)
    at = with_parameters(scene, p)
    np.testing.assert_allclose(at.wind + at.gusts, np.tile(2.0 * steady.wind, (3, 1)), rtol=1e-15)
    assert "wind" in flags or np.array_equal(at.wind, WIND)


def test_gusts_are_found_from_still_air():
    true = gusty(SWINGING + [(1, 1, 1)], wind=(0, 0, 0), frames=50, delta=0.005)
    still = gusty(np.zeros((4, 3)), wind=(0, 0, 0), drag=100.0, frames=50, delta=0.005)
    found = clothfit.estimate(still, clothfit.simulate(true, tolerance=1e-12))
    # the last key is not reached: of 0.245 s the wind is that of keys 2 and 3, whose sum alone is known less well
    np.testing.assert_allclose(found.scene.gusts[1:3], true.gusts[1:3], atol=1e-2)
    assert found.rmse < 1e-7
