"""How a small difference at the start grows: by known laws, and where a sheet buckles."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import cloth, document
from helpers.subspaces import moving, scene_of, whole

from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.motion.simulate import simulate
from clothfit.subspace.judge import GOES_ON, floor, growth

pytestmark = pytest.mark.slow  # compiles motions

FRAMES = 40
LOOSE = {"springStiffness": [1e-9] * 23, "dragCoefficient": 0.0, "damping": 0.0, "vertIsFixed": [False] * 12}


def test_in_free_fall_it_stays():
    scene = scene_of(document(cloth(4, 3, **LOOSE)))
    assert growth(scene, simulate(scene, FRAMES)) == pytest.approx(1.0, abs=1e-6)  # what is left of the springs


def test_of_a_cloth_that_hangs_it_decays_and_of_one_that_is_pushed_together_it_grows():
    held = [i < 4 for i in range(12)]
    scene = scene_of(document(cloth(4, 3, damping=2.0, dragCoefficient=0.0, vertIsFixed=held)))
    hanging = growth(scene, simulate(scene, FRAMES))
    upwards = np.array(scene.cloths[0].positions[11] - scene.cloths[0].positions[3])
    turned = replace(scene, gravity=9.81 * upwards / np.linalg.norm(upwards))
    pushed = replace(scene, gravity=-turned.gravity)
    stretched = growth(turned, simulate(turned, FRAMES))
    assert stretched < 1.0
    assert growth(pushed, simulate(pushed, FRAMES)) > 3.0 * max(stretched, hanging)


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
    size = np.sqrt((x**2).sum(axis=2).mean())
    assert floor(basis, system, x, 1e-12) == pytest.approx(lost / size, rel=1e-5)  # the springs that are left


def test_a_whole_basis_leaves_nothing_out():
    """With wind, a pin that moves and obstacles; what is left is rounding."""
    scene = scene_of(moving())
    system = build(scene, 0, steps=FRAMES - 1)
    x = rollout(system, FRAMES - 1, scene.tolerance)[0].x - system.x0
    assert floor(whole(system), system, x, scene.tolerance) < 1e-8
