"""The Runge–Kutta method: closed forms, its order, what stays, what diverges."""

import numpy as np
import pytest
from helpers.physics import gentle, system, thing, xyz

from clothfit.engine import rollout
from clothfit.evaluation.runge_kutta import record

pytestmark = pytest.mark.slow  # compiles a fit

STILL = {"gravity": xyz((0, 0, 0))}


def oscillator(speed=0.5):
    """A mass of 0.1 kg on a spring of 10 N/m along x, one end fixed: x = 1 + speed/ω sin ωt, ω = 10/s."""
    pair = thing([(0, 0, 0), (1, 0, 0)], [(0, 1)], fixed=(0,), vertVel=[xyz((0, 0, 0)), xyz((speed, 0, 0))])
    return system(pair, **STILL)


def test_free_fall_is_exact():
    positions = record(system(thing([(0, 2, 0)], vertVel=[xyz((1, 0, 0))])), 0.1, 11, 1)
    t = 0.1 * np.arange(11)
    # quadratic in t, so only rounding is left
    np.testing.assert_allclose(positions[:, 0, 1], 2 - 9.81 * t**2 / 2, atol=1e-14)
    np.testing.assert_allclose(positions[:, 0, 0], t, atol=1e-15)


def test_it_is_of_order_4_on_an_oscillator():
    t = 0.02 * np.arange(51)
    exact = 1 + 0.05 * np.sin(10 * t)
    errors = [np.abs(record(oscillator(), 0.02, 51, m)[:, 1, 0] - exact).max() for m in (1, 2, 4)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 4, atol=0.1)  # h ω = 0.2 … 0.05: the next term of the error is that much smaller


def test_a_damped_vertex_slows_down_as_it_should():
    one = system(thing([(0, 0, 0)], vertVel=[xyz((2, 0, 0))], damping=3.0), **STILL)
    t = 0.1 * np.arange(11)
    # h α = 0.0375: the error of order 4 is (h α)⁴/120 of 2/3 m
    np.testing.assert_allclose(record(one, 0.1, 11, 8)[:, 0, 0], 2 / 3 * (1 - np.exp(-3 * t)), atol=2e-8)


def test_fixed_vertices_stay():
    held = gentle()
    positions = record(held, 0.01, 5, 4)
    assert (positions[:, [0, 2]] == held.x0[[0, 2]]).all()
    assert np.ptp(positions[:, 4], axis=0).max() > 1e-4


def test_it_does_not_matter_how_the_steps_are_shared_out(monkeypatch):
    whole = record(gentle(), 0.01, 4, 8)
    monkeypatch.setattr(rollout, "STRETCH", 1)  # every step a call of its own
    assert (record(gentle(), 0.01, 4, 8) == whole).all()


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid")  # as plain Python
def test_what_diverges_is_none():
    assert record(oscillator(), 1.0, 60, 1) is None  # h ω = 10, far beyond the limit of 2.8


def test_the_system_is_left_as_it_was():
    one = oscillator()
    before = one.x0.copy(), one.v0.copy()
    record(one, 0.02, 5, 2)
    assert (one.x0 == before[0]).all()
    assert (one.v0 == before[1]).all()
