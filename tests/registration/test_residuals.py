"""Residuals under registrations: their derivative by everything, and the plain cost as a special case."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import cloth, document, load_text

from clothfit.motion.degrade import degrade
from clothfit.motion.simulate import simulate
from clothfit.objective.comparison import loss_named
from clothfit.objective.experiment import experiments
from clothfit.objective.objective import Objective
from clothfit.registration.record import Registration, rotation
from clothfit.registration.residuals import THETA, Registered, around
from clothfit.scene.fit_vector import parameters

pytestmark = pytest.mark.slow  # compiles a simulation and its sensitivity
STILL = {"x": 0, "y": 0, "z": 0}


def scene_and_target(method=2, seed=0, **more):
    own = cloth(vertIsFixed=[i < 4 for i in range(12)])
    fields = {"optimizationIterations": 10, "fit": {"gravity": "G"}, "integrationMethod": method, **more}
    made = load_text(json.dumps(document(own, **fields)))
    cloths = tuple(replace(each, settings="GF", fits={"damping": "G"}) for each in made.cloths)
    scene = replace(made, cloths=cloths)
    return scene, degrade(simulate(scene, tolerance=1e-12), 1e-2, observed=0.7, seed=seed)


@pytest.mark.parametrize("method", [2, 3])
@pytest.mark.parametrize("loss", ["linear", "soft_l1"])
def test_the_derivative_by_values_clock_and_place(method, loss):
    scene, motion = scene_and_target(method)
    p = parameters(scene) * 1.1
    base = Registration(1.07, -0.013, rotation(np.array([0.1, 0.2, -0.1])), np.array([0.1, -0.2, 0.05]), 1.2)
    where = [around(base, motion)]
    chosen = loss_named(loss, 0.05 if loss != "linear" else None)
    registered = Registered(scene, experiments(scene, motion), chosen, 1e-13)
    generator = np.random.default_rng(1)
    theta = 0.1 * generator.normal(size=(1, THETA))
    factor = np.maximum(np.abs(p), 0.1)
    g = registered.sums(p, where, theta, factor).g
    e = 1e-6
    for i in range(len(g)):
        q, moved = np.zeros(len(p)), np.zeros((1, THETA))
        (q if i < len(p) else moved[0])[i if i < len(p) else i - len(p)] = e
        up, down = (registered.sums(p + s * factor * q, where, theta + s * moved).cost for s in (1.0, -1.0))
        # the difference of costs of about 1 has a rounding of 1e-16 / e
        assert (up - down) / (2 * e) == pytest.approx(2.0 * g[i], rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("more", [{}, {"gravityKeys": {"times": [0, 1], "values": [STILL, {"x": 1, "y": 9, "z": 0}]}}])
def test_without_registration_the_cost_is_that_of_the_fit(more):
    scene, motion = scene_and_target(**more)
    p = parameters(scene) * 1.1
    registered = Registered(scene, experiments(scene, motion), loss_named(), 1e-13)
    cost = registered.sums(p, [around(Registration(), motion)], np.zeros((1, THETA))).cost
    assert cost == pytest.approx(Objective(scene, motion, 1e-13).cost(p), rel=1e-10)


def test_the_gain_of_a_step_is_as_predicted_near_the_minimum():
    made, _ = scene_and_target()
    scene = replace(made, cloths=tuple(replace(each, settings="FF") for each in made.cloths))
    exact = simulate(scene, tolerance=1e-12)
    registered = Registered(scene, experiments(scene, exact), loss_named(), 1e-13)
    p, where = parameters(scene), [around(Registration(), exact)]
    step = 1e-4 * np.random.default_rng(3).normal(size=len(p) + THETA)
    step[len(p) : len(p) + 2] = -1e-4  # the velocity jumps at a frame: frames move forward only
    sums = registered.sums(p, where, np.zeros((1, THETA)), np.maximum(np.abs(p), 0.1))
    q = p + step[: len(p)] * np.maximum(np.abs(p), 0.1)
    cost = registered.sums(q, where, step[None, len(p) :]).cost
    assert cost == pytest.approx(step @ sums.H @ step, rel=1e-2)  # the next term is smaller by the step's size
