"""The start that knows nothing of the scene's own flagged values."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers.marks import FITS
from helpers.scenes import changed, cloth, document, even, sphere, trial

from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import LOWER, UPPER, parameters, with_parameters
from clothfit.scene.scene import load
from clothfit.strategy.start import (
    COARSE_FRAMES,
    best_scales,
    decades,
    fabric,
    neighbours,
    neutral,
    neutral_start,
    proportions,
    undetermined,
)

pytestmark = FITS

FINEST = 10**0.125
"""Ratio of neighbouring values on the finest grid."""


def test_neighbours_are_the_points_around_within_the_bounds():
    axis = (-4.0, 4.0)
    assert sorted(neighbours((0.0,), 0.5, [axis])) == [(-0.5,), (0.5,)]
    assert len(set(neighbours((0.0, 1.0), 0.5, [axis] * 2))) == 8
    assert sorted(neighbours((4.0,), 0.5, [axis])) == [(3.5,)]
    corner = sorted(neighbours((-4.0, 0.0), 1.0, [axis] * 2))
    assert corner == [(-4.0, -1.0), (-4.0, 1.0), (-3.0, -1.0), (-3.0, 0.0), (-3.0, 1.0)]


FREE = {"contact": "G"}


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
    assert len(starts) == 2  # in the proportions of a fabric, and all alike
    (start,) = [p for p in starts if len(set(p.tolist())) == 1][:1]
    assert start.shape == parameters(scene).shape
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
    scene = load(even("LL", nx=3, ny=3))
    p, shapes = fabric(scene), proportions(scene.cloths[0])
    np.testing.assert_array_equal(p, np.concatenate(shapes))
    one = load(even("GG", nx=3, ny=3))
    np.testing.assert_array_equal(fabric(one), neutral(one))


@pytest.mark.parametrize("settings", ["Ln", "nG", "LL", "GL"])
def test_it_does_not_depend_on_the_flagged_values(settings):
    scene = load(trial(settings))
    motion = simulate(scene)
    others = [with_parameters(scene, p) for p in (7 * parameters(scene), np.ones(len(parameters(scene))))]
    first, *rest = (best_scales(Objective(s, motion), [fabric(s), neutral(s)]) for s in (scene, *others))
    for start in rest:
        np.testing.assert_array_equal(start, first)


def test_it_does_depend_on_the_target():
    scene = load(even("nG"))
    targets = [simulate(load(even("nG", springStiffness=[k] * 33))) for k in (3.0, 300.0)]
    soft, stiff = (neutral_start(Objective(scene, target)) for target in targets)
    assert stiff[0] > 30 * soft[0]


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


def test_every_cloth_has_its_own():
    one = even("nG")["objects"][0]
    stiff = changed(one, ("springStiffness",), [3000.0] * 33)
    scene = load(document(one, changed(one, ("optimizationSettings",), "nn"), stiff, optimizationIterations=20))
    first, second = neutral_start(Objective(scene, simulate(scene)))
    assert 30.0 / FINEST < first < 30.0 * FINEST
    assert second > 10 * first  # the stiffer, the less the motion tells


def test_what_was_not_seen_does_not_count():
    scene = load(even("nG"))
    motion = simulate(scene)
    seen = np.zeros((20, 16), bool)
    seen[:, 15] = True
    positions = np.where(seen[:, :, None], motion.positions, np.nan)
    start = neutral_start(Objective(scene, Motion(positions, motion.times, (16,), seen)))
    assert 30.0 / FINEST < start[0] < 30.0 * FINEST


def test_values_that_diverge_are_passed_over():
    scene = load(even("nG", 30, integrationMethod=0, delta=0.004))
    start = neutral_start(Objective(scene, simulate(scene)))
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
