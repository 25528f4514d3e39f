"""Registrations of captures of the model's own motion, found with few values that cannot reproduce it."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.strangers import sheet, stranger

from clothfit.fit.registered_fit import few
from clothfit.motion.degrade import degrade
from clothfit.motion.simulate import simulate
from clothfit.objective.comparison import loss_named
from clothfit.objective.experiment import experiments
from clothfit.registration.record import rotation
from clothfit.registration.residuals import find, sought
from clothfit.scene.fit_vector import parameters, with_parameters

pytestmark = pytest.mark.slow  # compiles a simulation and its sensitivity

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
