"""What a scene will ask for, against what is then measured."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from helpers.paths import EXAMPLES
from helpers.scenes import cloth, document, trial

from clothfit import Diverged, Objective, load, simulate
from clothfit.evaluation.forecast import forecast

pytestmark = pytest.mark.slow  # compiles a fit


@pytest.mark.parametrize("name", ["side", "drape"])
def test_the_memory_of_a_fit_is_what_the_fit_foresees(name):
    scene = load(EXAMPLES / f"{name}.json")
    motion = simulate(scene)
    assert forecast(scene).motion == motion.positions.nbytes
    assert forecast(scene).fit == pytest.approx(Objective(scene, motion).needs.predicted, rel=0.05)  # small arrays
    assert forecast(load(trial("nn", 5))).fit is None


def moved(scene, method, ratio):
    """How far a scene goes in 300 steps of the limit times a ratio."""
    limit = forecast(scene).steps[method].limit
    made = replace(scene, method=method, delta=ratio * limit)
    return float(np.abs(simulate(made, 301).positions).max())


def test_steps_below_the_limit_stay_and_those_above_do_not():
    # without air, whose part in the limit is only an upper one
    scene = load(trial("nG", 5, 4, 4, damping=0.05, dragCoefficient=0.0))
    assert moved(scene, 1, 0.9) < 20
    with pytest.raises(Diverged):
        moved(scene, 1, 1.3)


def test_implicit_steps_have_no_limit_and_the_worst_object_decides():
    stiff = cloth(3, 3, springStiffness=[1e4] * 16)
    both, one = (forecast(load(document(*objects))).steps for objects in ((cloth(3, 3), stiff), (stiff,)))
    assert [each.integrator for each in both] == ["explicit", "symplectic", "implicit", "bdf2"]
    assert [each.limit for each in both] == [each.limit for each in one]
    assert both[2].limit == both[3].limit == inf
    assert [each.stable for each in both] == [False, False, True, True]
