"""The clock of a target by its free fall, for motions that are written down: u = g t² / 2, and what a step adds."""

import numpy as np
import pytest
from helpers.strangers import sheet

from clothfit.motion.motion import as_motion
from clothfit.registration.free_fall import late_start, other_fall

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


@pytest.mark.parametrize(("h", "odd"), [(0.02, (3,)), (0.02, (4, 6)), (0.01, (6,)), (0.01, (5, 6)), (0.005, (2, 4))])
def test_steps_of_bdf2_that_are_taken_by_implicit_euler_are_no_other_clock(h, odd):
    """Each one sets all vertices ahead alike, by h²/2, and by what the next steps make of that."""
    scene, n = sheet(delta=h), np.arange(17)
    ahead = sum(0.75 * h**2 * (1.0 - 3.0 ** -np.maximum(n - step, 0)) for step in (0, *odd))
    positions = scene.cloths[0].positions + (0.5 * (h * n) ** 2 + ahead)[:, None, None] * scene.gravity
    assert other_fall(scene, as_motion(scene, positions, h * n)) is None


@pytest.mark.parametrize("ahead", [0.0, 0.5 * H], ids=["exact", "implicit Euler"])
@pytest.mark.parametrize("noise", [0.0, 2e-6])
def test_a_cloth_that_stands_still_at_first_begins_to_fall_late(ahead, noise):
    """A fall of 1.2e-4 m in a frame, seen through noise that the mean of 18 vertices takes a quarter of."""
    scene, late = sheet(delta=H), 10
    times = H * np.arange(40)
    t = np.maximum(times - H * late, 0.0)
    rest = scene.cloths[0].positions
    free = np.where(scene.cloths[0].fixed[:, None], 0.0, 1.0)
    fallen = (0.5 * t**2 + ahead * t)[:, None, None] * scene.gravity * free
    seen = rest + fallen + noise * np.random.default_rng(0).normal(size=(40, *rest.shape))
    assert late_start(scene, as_motion(scene, seen, times)) == pytest.approx(H * late, rel=1e-12)
    assert late_start(scene, as_motion(scene, seen[late:], times[:-late])) == 0.0  # at once
    waved = rest + np.sin(20.0 * t)[:, None, None] * 0.01 * scene.gravity  # what is held moves, too
    assert late_start(scene, as_motion(scene, waved, times)) == 0.0
    assert late_start(scene, as_motion(scene, rest + 0.0 * fallen, times)) == 0.0  # always
    rising = rest - fallen
    assert late_start(scene, as_motion(scene, rising, times)) == 0.0
