"""Fits of cloths that lie, slide and fall on colliders: friction, contact stiffness, and where the collider is."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.marks import FITS
from helpers.physics import ball, xyz

from clothfit.fit.estimate import estimate, record_target
from clothfit.meshes.mesh import plane
from clothfit.meshes.new_scene import new_scene
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.scene import dumps, load

pytestmark = FITS

RUBS = {"friction": 0.3, "thickness": 0.01}
BOX = {"type": 3, "pos": xyz((0, 0.25, 0)), "scale": xyz((0.6, 0.5, 0.6)), **RUBS}
FLOOR = {"type": 0, "pos": xyz((0, 0, 0)), "scale": xyz((1, 1, 1)), **RUBS}
STEPS = {"times": [0, 0.4, 0.8], "values": [xyz((0, 0, 0)), xyz((0.1, 0.02, 0.05)), xyz((0.2, 0, 0))]}
WALK = {"posKeys": {**STEPS, "interpolation": "smooth"}}
FIGURE = [
    {"type": 2, "pos": xyz((0, 0.1, 0)), "scale": xyz((1, 1, 1)), "radius": 0.17, "radius2": 0.2, "height": 0.5},
    {"type": 2, "pos": xyz((0, 0.4, 0)), "rot": xyz((0, 0, 90)), "scale": xyz([1] * 3), "radius": 0.08, "height": 0.5},
    ball((0, 0.5, 0), 0.1),
]


def dropped(colliders, settings, fit, frames=41, **fields):
    """A cloth of 1 m that falls onto colliders, a little off their middle."""
    mesh = plane(6, 1.0)
    turn = np.array([[np.cos(0.3), 0, np.sin(0.3)], [0, 1, 0], [-np.sin(0.3), 0, np.cos(0.3)]])
    mesh = mesh._replace(positions=mesh.positions @ turn.T + [0.1, fields.pop("height", 0.53), 0.07])
    bare = json.loads(dumps(new_scene(mesh, fit=settings, integrator="implicit", frames=frames)))
    return load({**bare, "planes": "solid", "colliders": colliders, "fit": fit, **fields})


def intervals(found):
    """Of all values, in the order of the fit vector, (P, 2)."""
    return np.array([ends for block in found.parameters for ends in block.interval])


def noisy(motion, metres):
    """The motion with noise of so many metres in each coordinate of all frames but the first."""
    noise = np.random.default_rng(3).normal(0, metres, motion.positions.shape)
    noise[0] = 0
    return replace(motion, positions=motion.positions + noise)


@pytest.mark.parametrize("settings", ["nn", "nF"])
@pytest.mark.parametrize("off", [0.5, 2.0])
def test_the_friction_of_a_tablecloth_is_found_from_a_start_that_is_off_by_two(settings, off):
    made = dropped([BOX, FLOOR], settings, {"friction": "G"})
    exact, truth = record_target(made), parameters(made)
    start = with_parameters(made, off * truth)
    truth = parameters(made, flags=start)
    found = estimate(start, exact)
    # the positions are known to 1e-8 m, of which a change of friction by 1e-4 makes some µm
    np.testing.assert_allclose(parameters(found.scene, flags=start), truth, rtol=1e-4)
    rough = estimate(start, noisy(exact, 1e-3))
    lower, upper = intervals(rough).T
    assert np.all((lower <= truth) & (truth <= upper))  # so in 95 of 100; the seed is one of those
    assert np.all(upper - lower < 0.1 * truth)


def test_where_a_figure_walks_is_found():
    made = dropped([{**each, **WALK} for each in FIGURE], "nn", {"colliderOffset": "G"}, height=0.72)
    moved = with_parameters(made, [0.03, -0.02, 0.025])
    found = estimate(made, record_target(moved))
    np.testing.assert_allclose(found.scene.offset, moved.offset, rtol=1e-4)


def test_the_law_of_self_contact_is_found_where_a_sheet_slides_down_a_sheet():
    mesh = plane(6, 0.4)
    count = len(mesh.positions)
    below = mesh.positions - mesh.positions.mean(axis=0)
    above = below + [0.03, 0.012, 0.01]
    both = mesh._replace(
        positions=np.concatenate([below, above]), triangles=np.concatenate([mesh.triangles, mesh.triangles + count])
    )
    slope = xyz((9.81 * np.sin(0.25), -9.81 * np.cos(0.25), 0))
    held = np.arange(2 * count) < count
    bare = json.loads(dumps(new_scene(both, fixed=held, integrator="implicit", frames=31, fit="nn")))
    law = {"thickness": 0.01, "stiffness": 200.0, "friction": 0.15}
    made = load({**bare, "gravity": slope, "selfCollision": law, "fit": {"friction": "G", "contact": "G"}})
    truth = parameters(made)
    found = estimate(with_parameters(made, 0.7 * truth), record_target(made)).scene
    # the positions are known to 1e-8 m, of which a change by 1e-4 makes some µm
    np.testing.assert_allclose(parameters(found), truth, rtol=1e-4)
    assert load(json.loads(dumps(found))).self_contact == found.self_contact
