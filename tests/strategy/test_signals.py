"""A steady wind before its keys: the scenes are the same, and fits from still air find gusts."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.marks import compiled, fits
from helpers.strangers import WIND, windy, with_finer_steps

import clothfit
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.keys import Keys
from clothfit.strategy.start import is_steady, steadied, values_by, with_air


def gusty(values, flags=None, **fields):
    """The sheet in wind with keys each 0.1 s, what is fitted of the scene as `flags` say: the keys."""
    values = np.array(values, float)
    keys = Keys(0.1 * np.arange(len(values)), values, "linear", place="windVelKeys")
    return replace(windy(**fields), wind_keys=keys, fits={"gusts": "L"} if flags is None else flags)


STEADY, SWINGING = np.tile([1.0, 2.0, 3.0], (3, 1)), [(0, 0, 0), (1, -1, 2), (0, 2, -1)]


def test_steady_is_where_keys_that_are_fitted_have_one_value():
    assert is_steady(gusty(STEADY))
    assert not is_steady(gusty(SWINGING))
    assert not is_steady(gusty(STEADY, flags={"wind": "G"}))
    assert not is_steady(gusty(STEADY[:1]))
    assert not is_steady(windy())


@pytest.mark.parametrize("flags", [{"gusts": "L"}, {"gusts": "L", "wind": "G"}])
def test_a_steady_wind_gives_the_same_motion_and_goes_back_to_the_keys(flags):
    scene = gusty(STEADY, flags, frames=12)
    steady = steadied(scene)
    assert steady.fits == {"wind": "G"}
    np.testing.assert_allclose(steady.wind, np.add(WIND, STEADY[0]), rtol=1e-15)
    np.testing.assert_allclose(simulate(steady).positions, simulate(scene).positions, atol=1e-15)
    p = values_by(steady, scene)
    np.testing.assert_allclose(simulate(with_parameters(scene, p)).positions, simulate(scene).positions, atol=1e-15)
    p = values_by(with_parameters(steady, 2.0 * parameters(steady)), scene)
    at = with_parameters(scene, p)
    np.testing.assert_allclose(at.wind + at.gusts, np.tile(2.0 * steady.wind, (3, 1)), rtol=1e-15)
    assert "wind" in flags or np.array_equal(at.wind, WIND)


def test_parameters_by_the_same_flags_are_taken_as_they_are():
    scene = gusty(SWINGING)
    np.testing.assert_array_equal(values_by(scene, scene), parameters(scene))


@compiled
def test_a_fit_of_keys_starts_from_the_steady_wind_that_frames_show():
    motion = with_finer_steps(windy(), 4)  # differences of frames see what their steps hide
    start = gusty(np.zeros((5, 3)), wind=(0, 0, 0), drag=0.1)
    p = with_air(Objective(start, motion, 1e-10), parameters(start))
    keys = with_parameters(start, p).gusts
    assert (keys == keys[0]).all()
    np.testing.assert_allclose(keys[0], WIND, rtol=0.2)  # as near as differences of frames are


@fits
def test_gusts_are_found_from_still_air():
    true = gusty(SWINGING + [(1, 1, 1)], wind=(0, 0, 0), frames=100)
    found = clothfit.estimate(
        gusty(np.zeros((4, 3)), wind=(0, 0, 0), drag=100.0, frames=100), clothfit.simulate(true, tolerance=1e-12)
    )
    # the last key is not reached: of 0.2475 s the wind is that of keys 2 and 3, whose sum alone is known less well
    np.testing.assert_allclose(found.scene.gusts[1:3], true.gusts[1:3], atol=1e-2)
    assert found.rmse < 1e-7
