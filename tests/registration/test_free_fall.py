"""The clock of a target by its free fall, for motions that are written down: u = g t² / 2, and what a step adds."""

import numpy as np
import pytest
from helpers.strangers import sheet

from clothfit.motion.motion import as_motion
from clothfit.registration.free_fall import other_fall

H = 0.005


@pytest.mark.parametrize("rate", [0.7, 1.3, 2.0])
@pytest.mark.parametrize(
    "ahead",
    [lambda t: 0.0 * t, lambda t: 0.5 * H * t, lambda t: 0.75 * H**2 * (1.0 - 3.0 ** (-t / H))],
    ids=["exact", "implicit Euler", "BDF2"],
)
def test_the_rate_of_a_clock_is_the_root_of_the_gravity_over_the_fall_that_it_shows(rate, ahead):
    scene = sheet(delta=H)
    times = H * np.arange(17)
    fallen = 0.5 * times**2 + ahead(times)
    positions = scene.cloths[0].positions + fallen[:, None, None] * scene.gravity
    fall = other_fall(scene, as_motion(scene, positions, rate * times))
    assert fall.acceleration == pytest.approx(9.81 / rate**2, rel=1e-9)  # rounding of a regression
    assert fall.rate == pytest.approx(rate, rel=1e-9)
    assert other_fall(scene, as_motion(scene, positions, times)) is None
