"""Contacts that a step only ends in: closed forms, what is left of a surface that turns away, and exact derivatives."""

import numba
import numpy as np
import pytest
from helpers.derivatives import assert_derivatives
from helpers.physics import METHODS, scene, sheet, thing, xyz

from clothfit.engine.rollout import rollout
from clothfit.engine.system import build

TIGHT = 1e-13


def prism(outline):
    """A closed mesh with this outline in x and y, of five corners, all of which the fourth one sees."""
    return {
        "type": 4, "pos": xyz((0, 0, 0)), "scale": xyz((1, 1, 1)), "thickness": 0.01, "friction": 0.3,
        "mesh": {
            "vertices": [xyz((x, y, z)) for z in (-1, 1) for x, y in outline],
            "triangles": [3, 0, 4, 3, 1, 0, 3, 2, 1, 8, 9, 5, 8, 5, 6, 8, 6, 7]
            + [i for e in range(5) for a, b in [(e, (e + 1) % 5)] for i in (a, b, b + 5, a, b + 5, a + 5)],
        },
    }  # fmt: skip


FLOOR = prism([(-1, -1), (1, -1), (1, 0), (0, 0), (-1, 0)])
VALLEY = prism([(-1, -1), (1, -1), (1, 1), (0, 0), (-1, 1)])


def flat(height, speed, mass, **fields):
    """Four vertices that come down on something."""
    corners = [(a, height, b) for a in (-0.1, 0.1) for b in (-0.1, 0.1)]
    own = thing(corners, [(0, 1), (1, 3), (3, 2), (2, 0)], mass=mass)
    own["vertVel"] = [xyz((0, -speed, 0))] * 4
    made = {"integrationMethod": 2, "delta": 0.02, "gravity": xyz((0, -9.81, 0))}
    return scene(own, tolerance=TIGHT, **{**made, **fields})


def test_a_vertex_that_ends_in_a_mesh_is_held_by_an_implicit_spring():
    m, h, kappa, y = 0.01, 0.02, 1000.0, 0.012
    part = rollout(build(flat(y, 0.0, m, colliders=[FLOOR]), 0), 1, TIGHT)[0]
    assert part.used[0] == 1
    assert part.met[0, 0].all()
    expected = (-9.81 * h * m + h * kappa * (0.01 - y)) / (m + h * h * kappa)
    np.testing.assert_allclose(part.velocity(1)[:, 1], expected, rtol=1e-12)


def test_what_the_step_knew_or_does_not_reach_is_not_met():
    for y, speed in ((0.05, 1.0), (0.05, 3.0), (0.009, 3.0)):
        assert not rollout(build(flat(y, speed, 0.01, colliders=[FLOOR]), 0), 1, TIGHT)[0].met.any()


def over(turning, method="implicit", newton=1, frames=3):
    """A sheet that falls on a floor, or along one side of a valley and into the other."""
    one = sheet("LL", vertIsFixed=[False] * 9, damping=0.1)
    x = np.array([[0.04 * p["x"], 0.0, 0.1 * p["z"]] for p in one["vertPos"]])
    x -= x.mean(axis=0)
    x[:, 1] = 0.013 + 2e-4 * np.arange(9)
    v = np.array([(1.0 + 0.1 * i, 0.0, 0.3) for i in range(9)])
    if turning:
        x, v = x @ TURN.T + [-0.08, 0.08, 0.0], np.array([(4.0 + 0.02 * i, -4.1, 0.3) for i in range(9)])
    one["vertPos"], one["vertVel"] = [xyz(p) for p in x], [xyz(p) for p in v]
    one.pop("springRestLength", None)
    return scene(
        one, integrationMethod=METHODS[method], forwardSubSteps=newton, delta=0.02, optimizationIterations=frames,
        colliders=[VALLEY if turning else FLOOR], tolerance=TIGHT, fit={"gravity": True},
        gravity=xyz((0, -9.81, 0) if turning else (0, -40, 0)),
    )  # fmt: skip


TURN = np.array([[1, 1, 0], [-1, 1, 0], [0, 0, np.sqrt(2)]]) / np.sqrt(2)
VARIANTS = [("implicit", 1, False), ("implicit", 1, True), ("implicit", 3, True), ("bdf2", 1, True)]


@pytest.mark.slow
@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="hundreds of simulations are slow without compilation")
@pytest.mark.parametrize(("method", "newton", "turning"), VARIANTS)
def test_gradient_and_tangent(method, newton, turning):
    made = over(turning, method, newton)
    part = rollout(build(made, 0), 2, TIGHT)[0]
    assert part.met.any() or turning
    assert (part.used > newton).any() == turning  # the other side is no part of what the first solution knows
    # systems are solved to 1e-13, and friction makes their condition about 1e4
    assert_derivatives(made, TIGHT, 1e-10, 1e-9)
