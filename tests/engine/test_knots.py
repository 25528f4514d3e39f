"""Knots of controls beside keys that a scene has: its own values stay, and what is found is a change at the knots."""

import numpy as np
import pytest

from clothfit.engine.inputs import knots
from clothfit.engine.inputs.interpolation import interpolated
from clothfit.scene.keys import Keys

STEPS = 0.02 * np.arange(201)
AT = knots.times(2.0, 0.02, 0.25)


def given(interpolation, end=2.5):
    """Keys between the knots, at some of them, and after the last."""
    at = np.array([0.0, 0.31, 0.5, 1.1, 1.4, end])
    return Keys(at, np.random.default_rng(5).standard_normal((6, 3)), interpolation)


def read(document):
    """The keys of a document."""
    values = [[each[axis] for axis in "xyz"] for each in document["values"]]
    return Keys(np.array(document["times"]), np.array(values), document["interpolation"])


@pytest.mark.parametrize("interpolation", ["linear", "smooth", "hold"])
def test_a_scene_keeps_its_own_values_to_the_end(interpolation):
    own = given(interpolation)
    both = read(knots.keyed(AT, own))
    np.testing.assert_allclose(interpolated(both, STEPS), interpolated(own, STEPS), rtol=0, atol=1e-13)  # rounding


def test_a_smooth_curve_that_ends_early_goes_on_nearly_as_it_did():
    """Between its end and the next knot a curve of two continuous derivatives cannot stand still at once."""
    own = given("smooth", 1.6)
    both = read(knots.keyed(AT, own))
    away = np.abs(interpolated(both, STEPS) - interpolated(own, STEPS)).max(axis=1)
    assert away[STEPS > 1.5].max() < 0.05 * np.ptp(own.values)
    assert away[STEPS < 0.31].max() < 1e-3


@pytest.mark.parametrize("interpolation", ["linear", "smooth", "hold"])
def test_a_change_is_that_of_its_knots_alone(interpolation):
    """The values of the keys change as a curve through the knots does, and stay after the last."""
    own, change = given(interpolation), np.random.default_rng(6).standard_normal((len(AT), 3))
    both = read(knots.keyed(AT, own))
    found = Keys(both.times, both.values + knots.shares(AT, both) @ change, interpolation)
    wanted = interpolated(own, STEPS) + interpolated(Keys(AT, change, interpolation), STEPS)
    early, near = STEPS < 1.7, 0.05 if interpolation == "smooth" else 1e-12  # a spline's last bend is felt before it
    np.testing.assert_allclose(interpolated(found, STEPS)[early], wanted[early], rtol=0, atol=near)
    np.testing.assert_allclose(interpolated(found, [2.5]), wanted[[125]], rtol=0, atol=1e-12)


def test_a_key_beside_a_knot_is_one_with_it():
    own = Keys(np.array([0.0, 0.1 * 3, 2.0]), np.arange(9.0).reshape(3, 3), "hold")  # 0.30000000000000004
    at = knots.times(2.0, 0.02, 0.1)
    both = read(knots.keyed(at, own))
    assert len(both.times) == len(at)
    assert (knots.shares(at, both).sum(axis=0) >= 1.0).all()


def test_no_more_knots_than_steps():
    assert len(knots.times(2.0, 0.02, 1e-300)) == 101
