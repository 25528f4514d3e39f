"""Residuals under registrations: their derivative by everything, the plain cost as a special case; and registrations of
captures of the model's own motion, found with few values that cannot reproduce it.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import cloth, document, load_text
from helpers.strangers import sheet, stranger

from clothfit.fit.registered_fit import few
from clothfit.fit.registration import THETA, Unknowns, find, sought
from clothfit.motion.degrade import degrade
from clothfit.motion.simulate import simulate
from clothfit.objective.comparison import loss_named
from clothfit.objective.experiment import experiments
from clothfit.objective.objective import Objective
from clothfit.registration.record import Registration, rotation
from clothfit.scene.fit_vector import parameters, with_parameters

pytestmark = pytest.mark.slow  # compiles a simulation and its sensitivity
STILL = {"x": 0, "y": 0, "z": 0}


def scene_and_target(method=2, seed=0, **more):
    own = cloth(vertIsFixed=[i < 4 for i in range(12)])
    fields = {"optimizationIterations": 10, "fit": {"gravity": "G"}, "integrationMethod": method, **more}
    made = load_text(json.dumps(document(own, **fields)))
    cloths = tuple(replace(each, settings="GF", fits={"damping": "G"}) for each in made.cloths)
    scene = replace(made, cloths=cloths)
    return scene, degrade(simulate(scene, tolerance=1e-12), 1e-2, observed=0.7, seed=seed)


def unknown(scene, motion, base=None, loss=None, by=1.1):
    """Everything unknown, around values that are off by a factor."""
    given, p = experiments(scene, motion), by * parameters(scene)
    free = np.ones(THETA, bool)
    return Unknowns(scene, given, p, [base or Registration()], free, loss or loss_named(), 1e-13)


@pytest.mark.parametrize("method", [2, 3])
@pytest.mark.parametrize("loss", ["linear", "soft_l1"])
def test_the_derivative_by_values_clock_and_place(method, loss):
    scene, motion = scene_and_target(method)
    base = Registration(1.07, -0.013, rotation(np.array([0.1, 0.2, -0.1])), np.array([0.1, -0.2, 0.05]), 1.2)
    unknowns = unknown(scene, motion, base, loss_named(loss, 0.05 if loss != "linear" else None))
    z = unknowns.here
    z[-THETA:] = 0.1 * np.random.default_rng(1).normal(size=THETA)
    g, e = unknowns.model(z).g, 1e-6
    for own, change in zip(g, e * np.eye(len(z)), strict=True):
        # the difference of costs of about 1 has a rounding of 1e-16 / e
        difference = (unknowns.cost(z + change) - unknowns.cost(z - change)) / (2 * e)
        assert difference == pytest.approx(2.0 * own, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("more", [{}, {"gravityKeys": {"times": [0, 1], "values": [STILL, {"x": 1, "y": 9, "z": 0}]}}])
def test_without_registration_the_cost_is_that_of_the_fit(more):
    scene, motion = scene_and_target(**more)
    unknowns = unknown(scene, motion)
    assert unknowns.cost() == pytest.approx(Objective(scene, motion, 1e-13).cost(unknowns.p), rel=1e-10)


def test_the_gain_of_a_step_is_as_predicted_near_the_minimum():
    made, _ = scene_and_target()
    scene = replace(made, cloths=tuple(replace(each, settings="FF") for each in made.cloths))
    unknowns = unknown(scene, simulate(scene, tolerance=1e-12), by=1.0)
    step = 1e-4 * np.random.default_rng(3).normal(size=len(unknowns.here))
    step[-THETA : 2 - THETA] = -1e-4  # the velocity jumps at a frame: frames move forward only
    gain = step @ unknowns.model(unknowns.here).H @ step
    assert unknowns.cost(unknowns.here + step) == pytest.approx(gain, rel=1e-2)  # the next term is smaller by the step


# --- the search


R, D = rotation(np.array([0.02, 0.03, -0.04])), np.array([0.02, -0.015, 0.02])


@pytest.mark.parametrize("offset", [0.015, -0.015])
@pytest.mark.parametrize("rate", [1.0, 1.1])
def test_clock_and_place_are_found_though_the_stiffnesses_are_not(offset, rate):
    asked = sheet(20.0, "nL", frames=60)
    count = len(parameters(asked))
    uneven = with_parameters(asked, np.random.default_rng(1).permutation(np.geomspace(10.0, 40.0, count)))
    exact = simulate(uneven, tolerance=1e-10)
    late = replace(exact, times=rate * exact.times + offset)
    begun = late.times >= 0.0
    late = replace(late, times=late.times[begun], positions=late.positions[begun])
    seen = degrade(stranger(late, turn=R, move=D), 1e-4, observed=0.5, seed=2)
    (found,) = find(few(asked, experiments(asked, seen), sought(True, True), loss_named()))
    # a ten-thousandth of the sheet's size as noise, which the bounds leave many times; with all frames weighing the
    # same the clock would be milliseconds off, as one factor on the stiffnesses is no more than 1 cm from the motion
    assert found.offset == pytest.approx(offset, abs=5e-4)
    assert found.rate == pytest.approx(rate, rel=5e-3)  # 1 ms over the 0.2 s of free fall, which weigh most
    assert found.translation == pytest.approx(D, abs=1e-3)
    assert np.degrees(np.linalg.norm(found.rotation - R) / np.sqrt(2.0)) < 0.1
