"""Paths of pins that a fit finds: what they do, their derivatives with all that they meet, and fits."""


import numpy as np
import pytest
from helpers.derivatives import assert_gradient_and_tangent
from helpers.physics import METHODS, ball, scene, sheet, xyz

from clothfit.derivative.columns import columns
from clothfit.derivative.sensitivity import at_start, sweep, tangents
from clothfit.engine.system import mobile
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import parameters

pytestmark = pytest.mark.slow  # compiles a fit

TIGHT = 1e-15
VARIANTS = [("explicit", 1), ("symplectic", 1), ("implicit", 1), ("implicit", 3), ("bdf2", 1), ("bdf2", 3)]
FIT = {"posKeys": "L", "pinOffset": "G"}


def keys(times, values, **fields):
    """Keys as the file has them."""
    return {"times": list(map(float, times)), "values": [xyz(value) for value in values], **fields}


def led(method="implicit", newton=1, fit=FIT, settings="nn", touch=True, **fields):
    """A cloth whose corners go along keys of all interpolations, in wind, with bodies that rub and axes that turn."""
    own = {"damping": 0.3, "dragCoefficient": 0.3, "pinOffset": xyz((0.004, -0.003, 0.002)), "fit": fit}
    one = sheet(settings, vertIsFixed=[i in (0, 1, 2) for i in range(9)], **own)
    one["pins"] = [
        {"vertices": [2], "rotKeys": keys([0, 0.03], [(0, 0, 0), (20, 40, 10)], interpolation="smooth"),
         "posKeys": keys([0, 0.02, 0.05], [(0.1, 0, 0), (0.08, 0.01, 0), (0.1, 0, 0.03)], interpolation="smooth")},
        {"vertices": [1], "posKeys": keys([-0.01, 0.015, 0.04], [(0, 0, 0), (0.02, 0.05, 0), (0, 0, 0)])},
        {"vertices": [0], "posKeys": keys([0, 0.02], [(0, 0, 0), (0, 0.004, 0.01)], interpolation="hold")},
    ]  # fmt: skip
    rubbing = {**ball((1.0, -0.748, 1.0), 0.75), "friction": 0.4, "thickness": 0.03}
    turning = {"rotKeys": keys([0, 0.1], [(0, 0, 0), (5, 10, 3)]), "posKeys": keys([0, 0.1], [(0, 0, 0), (0.1, 0, 0)])}
    whole = {"colliders": [rubbing], "frame": turning} if touch else {}
    return scene(
        one, integrationMethod=METHODS[method], forwardSubSteps=newton, delta=0.01, optimizationIterations=7,
        windVel=xyz((4, -2, -3)), tolerance=TIGHT, **{**whole, **fields},
    )  # fmt: skip


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
def test_gradient_and_tangent(method, newton):
    assert_gradient_and_tangent(led(method, newton, settings="LL"), TIGHT, 1e-12)


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
def test_the_dense_sensitivity_is_that_of_all_tangents(method, newton):
    made = led(method, newton, settings="LL")
    objective, p = Objective(made, simulate(made), TIGHT), parameters(made)
    system, tape = objective.simulate(objective.runs[0], p)
    assert mobile(system).all()
    count = len(p)
    wanted = columns(system, objective.blocks, p, np.arange(count, dtype=np.int32), np.ones(count), count)
    start = at_start(system, wanted)
    assert start[:, -3:].any()  # of the offset
    assert not start[:, :-3].any()
    for dense, single in zip(sweep(system, tape, wanted), tangents(system, tape, wanted, TIGHT), strict=True):
        # two ways to the same sums of some hundred products
        np.testing.assert_allclose(dense, single, atol=1e-11 * np.abs(single).max())


def test_a_cloth_that_touches_itself_and_is_led():
    made = led(touch=False, selfCollision={"thickness": 0.7, "stiffness": 30, "friction": 0.3})
    assert_gradient_and_tangent(made, TIGHT, 1e-12)
