"""The clock of a target by its free fall, for motions that are written down: u = g t² / 2."""

import numpy as np
import pytest
from helpers.strangers import sheet

from clothfit.motion.motion import as_motion
from clothfit.registration.free_fall import other_fall


@pytest.mark.parametrize("rate", [0.7, 1.3, 2.0])
def test_the_rate_of_a_clock_is_the_root_of_the_gravity_over_the_fall_that_it_shows(rate):
    scene = sheet(delta=0.005)
    times = scene.delta * np.arange(17)
    positions = scene.cloths[0].positions + 0.5 * times[:, None, None] ** 2 * scene.gravity
    fall = other_fall(scene, as_motion(scene, positions, rate * times))
    assert fall.acceleration == pytest.approx(9.81 / rate**2, rel=1e-9)  # rounding of a regression
    assert fall.rate == pytest.approx(rate, rel=1e-9)
    assert other_fall(scene, as_motion(scene, positions, times)) is None
