"""Fits of targets with another clock or place: what is found, and that nothing gets worse."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from helpers.fits import Watching, estimate
from helpers.strangers import sheet, stranger, with_finer_steps

from clothfit import degrade, parameters, simulate, with_parameters
from clothfit.registration.record import Registration, rotation

pytestmark = pytest.mark.slow  # compiles a fit

R, D = rotation(np.array([0.1, 0.3, -0.2])), np.array([0.3, -0.2, 0.1])


@pytest.fixture(scope="module")
def exact():
    """The motion of a sheet."""
    return simulate(sheet(20.0), tolerance=1e-10)


@pytest.fixture(scope="module")
def noisy(exact):
    """The same with noise of 1 mm."""
    return degrade(exact, 1e-3, seed=1)


@pytest.mark.parametrize(("rate", "offset"), [(0.8, 0.03), (1.32, 0.0)])
def test_the_clock_of_an_exact_target_is_found_with_its_stiffness(exact, rate, offset):
    found = estimate(sheet(50.0), stranger(exact, rate, offset), fit_time=True)
    (clock,) = found.registration
    # the search ends where a step would save a thousandth of a cost that is nearly 0
    assert clock.rate == pytest.approx(rate, rel=1e-4)
    assert clock.offset == pytest.approx(offset, abs=1e-4)
    assert np.array_equal(clock.rotation, np.eye(3))
    assert found.scene.cloths[0].stiffness == pytest.approx(20.0, rel=1e-3)
    assert found.scene.frames == 40
    assert found.verdict.model == "adequate"


@pytest.mark.parametrize(("placed", "size"), [(True, 1.0), (False, 1.05), (True, 1.05)])
def test_the_place_and_the_scale_of_a_noisy_target_are_found_within_its_noise(noisy, placed, size):
    seen = stranger(noisy, turn=R, move=D) if placed else noisy
    seen = replace(seen, positions=size * seen.positions)
    found = estimate(sheet(50.0), seen, fit_scale=size != 1.0, fit_placement=placed)
    (place,) = found.registration
    # noise of 1 mm in 40 × 36 positions leaves far less than that open; the sheet is 0.5 m long
    assert place.translation == pytest.approx(D if placed else np.zeros(3), abs=1e-3)
    assert place.rotation == pytest.approx(R if placed else np.eye(3), abs=2e-3)
    assert place.scale == pytest.approx(1.0 / size, rel=1e-3 if size != 1.0 else 0.0)
    assert (place.rate, place.offset) == (1.0, 0.0)
    assert found.rmse == pytest.approx(np.sqrt(3) * 1e-3, rel=0.1)


def test_clock_and_place_are_found_beside_all_stiffnesses_and_their_intervals_hold_the_truth():
    seed, asked = 1, sheet(20.0, "nL", frames=50)
    uneven = np.exp(np.random.default_rng(seed).normal(scale=0.3, size=len(parameters(asked)))) * 20.0
    exact = simulate(with_parameters(asked, uneven), tolerance=1e-10)
    turn, move = rotation(np.array([0.02, 0.03, -0.04])), np.array([0.02, -0.015, 0.02])
    late = stranger(exact, offset=0.015, turn=turn, move=move)
    found = estimate(asked, degrade(late, 1e-3, observed=0.5, seed=seed), fit_time=True, fit_placement=True)
    (known,) = found.registration
    away = known.numbers - Registration(1.0, 0.015, turn, move).numbers
    # with few values alone the offset would be 0.6 to 1.4 ms off; noise of 1 mm leaves 0.15 ms (one standard deviation)
    assert abs(known.offset - 0.015) < 5e-4
    assert np.linalg.norm(known.translation - move) < 1e-3
    assert np.all(np.abs(away) <= 1.5 * known.within)  # of 24 numbers one is outside of 95 %, but hardly far
    assert known.within[1] < 1e-3
    low, high = known.summary()["intervals"]["offset"]
    assert low < known.offset < high


def test_a_clock_that_keeps_time_as_far_as_noise_shows_has_the_rate_1(noisy):
    (late,) = estimate(sheet(50.0), stranger(noisy, 1.0, 0.03), fit_time=True).registration
    assert late.rate == 1.0
    ends = late.intervals()
    assert ends["rate"][0] < 1.0 < ends["rate"][1]
    assert ends["offset"][0] < 0.03 < ends["offset"][1]
    (slow,) = estimate(sheet(50.0), stranger(noisy, 1.05, 0.03), fit_time=True).registration
    assert slow.rate == pytest.approx(1.05, abs=0.01)  # five of its standard errors away from 1
    assert slow.intervals()["rate"][0] > 1.0


def test_the_place_is_found_with_the_clock_where_the_model_differs():
    asked, every, said = sheet(50.0), with_finer_steps(sheet(20.0), 4), []
    plain = estimate(asked, every, intervals=False)
    moved = stranger(every, 1.3, 0.0, R, D)
    both = {"fit_time": True, "fit_placement": True}
    found = estimate(asked, moved, intervals=False, observer=Watching(progress=said.append), **both)
    (known,) = found.registration
    # what is held and the start say where it is, however wrong the model is later
    assert known.translation == pytest.approx(D, abs=5e-3)
    assert known.rotation == pytest.approx(R, abs=2e-2)
    assert found.rmse < plain.rmse
    for one, later in pairwise(said):  # of several fits, whose progress goes on
        assert later.evaluations >= one.evaluations
        assert later.seconds >= one.seconds
        assert later.cost <= one.cost


def test_each_target_has_its_own_registration():
    scene = sheet(20.0)
    blown = replace(scene, wind=np.array([0.0, 0.0, 3.0]))
    cloths = tuple(replace(each, drag=2e3) for each in scene.cloths)
    still, windy = (replace(each, cloths=cloths) for each in (scene, blown))
    targets = [
        stranger(simulate(still, tolerance=1e-10), 1.1),
        (stranger(simulate(windy, tolerance=1e-10), 0.9), windy),
    ]
    found = estimate(still, targets, start=50.0, fit_time=True, intervals=False)
    assert [each.rate for each in found.registration] == pytest.approx([1.1, 0.9], rel=1e-3)


def test_a_target_that_fits_as_it_is_stays_as_it_is_and_gravity_beside_the_clock_is_warned_of(exact):
    scene = replace(sheet(20.0), fits={"gravity": "G"})
    found = estimate(scene, exact, fit_time=True, fit_placement=True)
    (known,) = found.registration
    assert (known.rate, known.offset) == pytest.approx((1.0, 0.0), abs=1e-6)
    assert known.translation == pytest.approx(0.0, abs=1e-6)
    assert found.rmse < 1e-6
    assert any("clock" in warning for warning in found.warnings)


def test_a_budget_of_time_ends_the_search_with_a_result(exact):
    found = estimate(sheet(50.0), stranger(exact, 1.2), fit_time=True, time_limit=1e-3)
    assert len(found.registration) == 1
    assert found.scene.frames == 40
