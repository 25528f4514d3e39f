"""The derivatives of motions in which all that moves a cloth, or touches it, is there at once: wind and gravity over
time, pins whose paths are fitted, colliders of each shape that go, turn, grow and rub, a mesh that bends, axes that
turn.
"""

import numpy as np
import pytest
from helpers.derivatives import assert_gradient_and_tangent
from helpers.obstacles import plane, ring
from helpers.physics import METHODS, VARIANTS, ball, keys, scene, sheet, xyz
from helpers.surfaces import block, body

from clothfit import parameters, simulate
from clothfit.derivative.sensitivity import at_start, columns, sweep, tangents
from clothfit.derivative.verify import check
from clothfit.engine.system import mobile
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import acting

pytestmark = pytest.mark.slow  # compiles a fit

TIGHT = 1e-15
ZERO = (0.0, 0.0, 0.0)
OWN = dict.fromkeys(("vertVel", "springRestLength", "posKeys"), "L")
OWN |= dict.fromkeys(("damping", "dragCoefficient", "pinOffset"), "G")
PINS = [
    {"vertices": [2], "rotKeys": keys([0, 0.03], [ZERO, (20, 40, 10)], interpolation="smooth"),
     "posKeys": keys([0, 0.02, 0.05], [(0.1, 0, 0), (0.08, 0.01, 0), (0.1, 0, 0.03)], interpolation="smooth")},
    {"vertices": [1], "posKeys": keys([-0.01, 0.015, 0.04], [ZERO, (0.02, 0.05, 0), ZERO])},
    {"vertices": [0], "posKeys": keys([0, 0.02], [ZERO, (0, 0.004, 0.01)], interpolation="hold")},
]  # fmt: skip
FRAME = {
    "posKeys": keys([0, 0.03], [ZERO, (0.05, -0.02, 0.04)]), "pivot": xyz((0.3, 0.1, 0.2)),
    "rotKeys": keys([0, 0.05], [ZERO, (10, 30, 5)], interpolation="smooth"),
}  # fmt: skip
LAW = {
    "friction": 0.4, "thickness": 0.12, "stiffness": 40,
    "scaleKeys": keys([0, 0.04, 0.1], [(2, 2, 2), (2.6, 2.4, 2.2), (2.2, 3, 2.6)]),
}  # fmt: skip
GOES = {"posKeys": keys([0, 0.1], [ZERO, (0.05, 0, 0.02)]), "rotKeys": keys([0, 0.1], [ZERO, (9, 5, 2)])}


def obstacles(wobble):
    """Colliders that hold a sheet wherever it is: a plain sphere, and with friction all shapes."""
    mesh = body(block())

    def shape(kind, lengths, at, angles):
        return {**mesh, "type": kind, "pos": xyz(at), "scale": xyz(lengths), "rot": xyz(angles), **LAW}

    return [
        {**ball((1.0, -0.74, 1.0), 0.8), "posKeys": keys([0, 0.05], [ZERO, (0.01, 0.02, 0)])},
        {**ball((1.0, -0.75, 1.0), 0.75), **LAW, **GOES},
        plane((0, 0.05, 0), (3, 0, 2), friction=0.5, thickness=0.1, stiffness=60),
        shape(2, (0.3, 0.5, 0.3), (0.0, -0.25, 1.0), (0, 0, 80)),
        shape(3, (0.5, 0.4, 0.5), (2.0, -0.25, 1.1), (5, 3, 0)),
        shape(4, (0.5, 0.4, 0.5), (1.0, -0.25, 2.0), (3, 5, 0)),
        ring(wobble, stiffness=60),
    ]


def everything(colliders, method="implicit", newton=1, settings="LL", own=OWN, law="editor", **fields):
    """A sheet of which all values are fitted, two of its corners and a vertex between them pinned."""
    one = sheet(settings, vertIsFixed=[i in (0, 1, 2) for i in range(9)], fit=own, pins=PINS, dragLaw=law)
    one |= {"vertVel": [xyz((1.0 + 0.1 * i, 0.5, 0.6)) for i in range(9)], "pinOffset": xyz((0.004, -0.003, 0.002))}
    whole = {
        "windVel": xyz((4, -2, -3)), "windVelKeys": keys([0, 0.01, 0.02], [ZERO, (-8, 1, 2), (1, 2, 3)]),
        "gravityKeys": keys([0.005, 0.01], [ZERO, (3, 1, 0)], interpolation="hold"),
        "fit": {"windVel": True, "gravity": True, "windVelKeys": "L"},
    }  # fmt: skip
    return scene(
        one, colliders=colliders, planes="solid", integrationMethod=METHODS[method], forwardSubSteps=newton,
        delta=0.005, optimizationIterations=6, tolerance=TIGHT, **{**whole, **fields},
    )  # fmt: skip


@pytest.mark.parametrize(("turning", "law"), [(False, "editor"), (True, "editor"), (False, "air")])
@pytest.mark.parametrize(("method", "newton"), VARIANTS)
def test_gradient_tangent_and_columns(wobble, method, newton, turning, law):
    fit = {"windVel": True, "gravity": True, "windVelKeys": "L", "friction": "L", "contact": "L"}
    more = {"frame": FRAME} if turning else {}  # where colliders have no offset
    fit |= {} if turning else {"colliderOffset": "G"}
    made = everything(obstacles(wobble), method, newton, law=law, fit=fit, **more)
    target = simulate(made.with_values([made.cloths[0].mass * 1.1], [made.cloths[0].stiffness * 0.9]))
    objective, p = Objective(made, target, TIGHT), parameters(made)
    assert check(objective, p, seed=1).passed
    gradient = objective.cost_and_gradient(p)[1]
    for block_ in objective.blocks:  # every collider pushes and rubs
        part = gradient[block_.part] != 0
        assert part.all() if block_.name in ("friction", "contact") else part.any()
    direction = np.random.default_rng(3).normal(size=len(p)) * np.maximum(np.abs(p), 0.1)
    ends = [objective.positions(p + step * direction)[0] for step in (1e-6, -1e-6)]
    change = objective.tangent(p, direction)[0]  # in the axes of the scene
    # a central difference: rounding 1e-16/1e-6 relative, and 1e-12 of the third derivative
    np.testing.assert_allclose((ends[0] - ends[1])[1:] / 2e-6, change[1:], atol=1e-6 * np.abs(change).max())
    system, tape = objective.simulate(objective.runs[0], p)
    assert mobile(system).all()
    wanted = columns(system, acting(objective.scene, 0), p, np.arange(len(p), dtype=np.int32), np.ones(len(p)), len(p))
    shift = next(block_.part for block_ in objective.blocks if block_.name == "shift")
    start = at_start(system, wanted)
    assert start[:, shift].any()
    start[:, shift] = 0.0
    assert not start.any()
    for dense, single in zip(sweep(system, tape, wanted), tangents(system, tape, wanted, TIGHT), strict=True):
        # two ways to the same sums of some hundred products
        np.testing.assert_allclose(dense, single, atol=1e-11 * np.abs(single).max())


def test_a_cloth_that_touches_itself_and_is_led():
    made = everything([], selfCollision={"thickness": 0.7, "stiffness": 30, "friction": 0.3})
    assert_gradient_and_tangent(made, TIGHT, 1e-12)


def test_without_friction_its_gradient_is_the_limit_from_above(wobble):
    made = everything(obstacles(wobble), "bdf2", settings="nn", own={}, fit={"friction": "L"})
    own = made.cloths[0]
    smooth = made.with_values([own.mass], [own.stiffness], friction=np.zeros(6))
    objective, t = Objective(smooth, simulate(made), TIGHT), 1e-6
    gradient = objective.cost_and_gradient(np.zeros(6))[1]
    # a one-sided difference of second order
    start = objective.cost(np.zeros(6))
    far = [(4 * objective.cost(t * e) - objective.cost(2 * t * e) - 3 * start) / (2 * t) for e in np.eye(6)]
    assert np.all(gradient != 0)
    np.testing.assert_allclose(gradient, far, rtol=1e-5)
