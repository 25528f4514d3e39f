"""Fits of motions that were made under known forces."""

import numpy as np
import pytest
from helpers.physics import METHODS, scene, xyz
from helpers.scenes import cloth

import clothfit
from clothfit.scene.forces import Forces

pytestmark = pytest.mark.slow  # compiles fits with inputs


@pytest.mark.parametrize("how", ["momentum", "gauss-newton"])
def test_values_come_back_from_a_motion_under_forces(how):
    one = cloth(damping=0.3, springStiffness=(20.0 + np.arange(23)).tolist(), optimizationSettings="nL")
    own = scene(
        one, integrationMethod=METHODS["implicit"], windVel=xyz((3, 1, -2)), optimizationIterations=31, delta=0.02
    )
    values, turn = np.zeros((30, 12, 3)), np.linspace(0.0, 6.0, 30)[:, None]
    values[:, [5, 6, 11]] = 0.5 * np.stack([np.sin(turn), np.cos(turn), np.sin(2.0 * turn)], axis=2)
    known = own.with_forces(Forces(0.02 * np.arange(30), values))
    target = clothfit.simulate(known, tolerance=1e-12)
    guess = known.with_values([known.cloths[0].mass], [1.3 * known.cloths[0].stiffness])
    found = clothfit.estimate(guess, target, method=how)
    moved = ~own.cloths[0].fixed[own.cloths[0].springs].all(axis=1)  # the others are not seen
    truth = known.cloths[0].stiffness[moved]
    np.testing.assert_allclose(found.scene.cloths[0].stiffness[moved], truth, rtol=1e-6)  # errors of solves
    blind = clothfit.estimate(guess.with_forces(None), target, method=how)
    assert blind.rmse > 1e3 * found.rmse
