"""The motion for h → 0: exact where it can be, and otherwise no farther off than it says."""

import numpy as np
import pytest
from helpers.physics import ball, scene, thing, xyz

from clothfit.base.errors import InvalidInput
from clothfit.evaluation.richardson import Halving, converged, extent, per_frame, root_mean_square
from clothfit.motion.divergence import Diverged
from clothfit.motion.simulate import simulate

pytestmark = pytest.mark.slow  # compiles a fit

STILL = {"gravity": xyz((0, 0, 0))}


def halved(run, order, count):
    """A Halving after so many runs."""
    made = Halving(run, order)
    for _ in range(count):
        made.refine()
    return made


def shifted(c, *terms):
    """Runs that are c + Σ a/m^q, three frames of two vertices."""
    return lambda m: np.full((3, 2, 3), c + sum(a / m**q for a, q in terms))


# --- extrapolation


@pytest.mark.parametrize("order", [1, 2, 4])
def test_an_error_of_one_power_vanishes(order):
    found = halved(shifted(2.0, (0.3, order)), order, 3)
    np.testing.assert_allclose(found.extrapolants[1], 2.0, rtol=1e-15)  # rounding
    assert found.order() == pytest.approx(order, abs=1e-6)  # differences of 1e-4 at least, rounded to 1e-16
    assert found.errors().max() < 1e-14  # rounding


def test_the_estimate_is_above_the_error_that_is_left():
    found = halved(shifted(2.0, (0.3, 4), (0.2, 5)), 4, 4)
    error = np.abs(found.extrapolants[1] - 2.0).max() * np.sqrt(3)
    assert 0 < error < found.errors().max() < 100 * error


def test_a_slower_decay_than_expected_is_seen_and_covered():
    found = halved(shifted(2.0, (0.3, 1)), 4, 6)
    error = np.abs(found.extrapolants[1] - 2.0).max() * np.sqrt(3)
    assert found.order() == pytest.approx(1, abs=1e-9)  # rounding
    assert error < 1.01 * found.errors().max()


def test_runs_that_diverge_do_not_count():
    def run(m):
        return None if m < 8 else shifted(1.0, (1.0, 4))(m)

    assert not halved(run, 4, 4).known
    assert halved(run, 4, 5).known


def test_runs_that_agree_have_no_order():
    found = halved(shifted(2.0), 4, 3)
    assert (found.order(), found.errors().max()) == (None, 0.0)


def test_symplectic_free_fall_is_off_by_h_g_t_over_2_and_its_extrapolant_by_nothing():
    fall = [thing([(0, 2, 0)])]

    def run(m):
        return simulate(scene(*fall, integrationMethod=1, delta=0.1 / m), 10 * m + 1).positions[::m]

    t = 0.1 * np.arange(11)
    exact = 2 - 9.81 * t**2 / 2
    np.testing.assert_allclose(run(4)[:, 0, 1], exact - 0.025 * 9.81 * t / 2, atol=1e-14)  # rounding
    np.testing.assert_allclose(halved(run, 1, 3).extrapolants[1][:, 0, 1], exact, atol=1e-13)  # rounding


# --- motions


def test_free_fall_and_an_oscillator_come_out():
    pair = thing([(0, 0, 0), (1, 0, 0)], [(0, 1)], fixed=(0,), vertVel=[xyz((0, 0, 0)), xyz((0.5, 0, 0))])
    found = converged(scene(pair, **STILL), 51)
    error = found.positions[:, 1, 0] - (1 + 0.05 * np.sin(10 * 0.02 * np.arange(51)))
    assert np.abs(error).max() <= 2 * found.errors.max()  # over both vertices the mean is 1/√2 of the one that moves
    assert found.error < 1e-7 * 1.05  # of the extent, from the fixed end to the farthest point
    assert found.order == pytest.approx(4, abs=0.2)  # h ω ≤ 0.05
    assert found.integrator == "Runge-Kutta"
    fall = converged(scene(thing([(0, 2, 0)])), 11)
    assert fall.order is None
    # rounding of 2 m
    np.testing.assert_allclose(fall.positions[:, 0, 1], 2 - 9.81 * (0.02 * np.arange(11)) ** 2 / 2, atol=1e-14)


def test_a_fall_on_a_sphere_is_as_far_off_as_it_says():
    # 0.1 kg from 0.5 m above the top of a sphere of 1000 N/m: there after √(2·0.5/9.81) s, then
    # depth = g/ω² (1 − cos ωs) + v/ω sin ωs, ω = 100/s, until it comes up again, after s = 0.0323 s
    found = converged(scene(thing([(0, 1.5, 0)]), colliders=[ball((0, 0, 0), 1.0)]), 18, error=1e-6)
    t = 0.02 * np.arange(18)
    landing, w, speed = np.sqrt(1 / 9.81), 100.0, np.sqrt(9.81)
    s = t - landing
    inside = 1.0 - 9.81 / w**2 * (1 - np.cos(w * s)) - speed / w * np.sin(w * s)
    exact = np.where(s < 0, 1.5 - 9.81 * t**2 / 2, inside)
    assert ((s > 0).sum(), (exact[s > 0] < 1).all()) == (2, True)
    assert np.abs(found.positions[:, 0, 1] - exact).max() < 3 * found.errors.max()  # the estimate is no bound
    assert found.errors.max() < 1e-5


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid")  # as plain Python
def test_strong_damping_takes_the_implicit_step():
    # α = 1e7/s: Runge–Kutta would need steps below 2.8e-7 s; the vertex sinks at g/α
    found = converged(scene(thing([(0, 0, 0)], damping=1e7)), 4, error=1e-5)
    assert found.integrator == "implicit"
    t = 0.02 * np.arange(4)
    exact = -9.81 / 1e7 * (t - 1e-7)
    gap = np.abs(found.positions[1:, 0, 1] - exact[1:]).max()
    assert gap <= 2 * found.errors.max() + 1e-15  # rounding: the implicit step of a constant force is all but exact


def test_several_objects_are_told_in_file_order():
    first, second = thing([(0, 0, 0)]), thing([(0, 5, 0), (1, 5, 0)], vertVel=[xyz((1, 0, 0))] * 2)
    found = converged(scene(first, second), 5)
    assert found.positions.shape == (5, 3, 3)
    assert found.positions[4, :, 0] == pytest.approx([0, 0.08, 1.08])


def test_its_first_frames_are_a_reference():
    found = converged(scene(thing([(0, 0, 0)])), 5).upto(3)
    assert (found.positions.shape, found.errors.shape) == ((3, 1, 3), (3,))


def test_what_stands_still_is_known_exactly():
    found = converged(scene(thing([(0, 0, 0), (1, 0, 0)], fixed=(0, 1))), 3)
    assert (found.error, found.order, extent(found.positions)) == (0.0, None, 1.0)


def test_measures_of_a_motion():
    gap = np.zeros((2, 2, 3))
    gap[1, 0] = 3.0, 0.0, 4.0
    np.testing.assert_allclose(per_frame(gap), [0, 5 / np.sqrt(2)])
    assert root_mean_square(per_frame(gap)) == pytest.approx(2.5)  # √(25/4)
    assert extent(gap) == 5.0


def test_a_motion_that_cannot_be_kept_is_refused():
    with pytest.raises(InvalidInput, match="use fewer frames"):
        converged(scene(thing([(0, 0, 0)])), 10**12)


def test_no_time_and_no_frames_are_refused():
    with pytest.raises(InvalidInput, match="frames must be at least 2 to compare"):
        converged(scene(thing([(0, 0, 0)])), 1)
    with pytest.raises(Diverged, match="no steps that fit into the time"):
        converged(scene(thing([(0, 0, 0)])), 5, seconds=0.0)
