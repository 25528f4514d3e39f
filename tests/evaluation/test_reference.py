"""The motion for h → 0: exact where it can be, and otherwise no farther off than it says."""

import numpy as np
import pytest
from helpers.physics import ball, scene, thing, xyz

from clothfit import Diverged, InvalidInput
from clothfit.evaluation import reference
from clothfit.evaluation.reference import agree, converged, extent, order_of, per_frame, root_mean_square

pytestmark = pytest.mark.slow  # compiles a fit

STILL = {"gravity": xyz((0, 0, 0))}
FALL = scene(thing([(0, 2, 0)]))
OSCILLATOR = scene(
    thing([(0, 0, 0), (1, 0, 0)], [(0, 1)], fixed=(0,), vertVel=[xyz((0, 0, 0)), xyz((0.5, 0, 0))]), **STILL
)


def shifted(c, *terms):
    """Runs of 4, 8 and 16 steps that are c + Σ a/m^q, three frames of two vertices."""
    return [np.full((3, 2, 3), c + sum(a / m**q for a, q in terms)) for m in (4, 8, 16)]


@pytest.mark.parametrize("order", [1, 2])
def test_the_order_of_runs_is_measured_and_their_distance_covers_the_error(order):
    runs = shifted(2.0, (0.3, order))
    assert order_of(runs) == pytest.approx(order, abs=1e-6)  # differences of 1e-4 at least, rounded to 1e-16
    error, told = root_mean_square(per_frame(runs[-1] - 2.0)), root_mean_square(per_frame(runs[-1] - runs[-2]))
    assert told == pytest.approx((2**order - 1) * error, rel=1e-9)  # rounding
    assert not agree(runs, 0.0)


def test_runs_that_agree_have_no_order_and_two_have_none_either():
    assert order_of(shifted(2.0)) is order_of(shifted(2.0, (0.3, 1))[:2]) is None
    assert agree(shifted(2.0), 0.0)
    assert not agree(shifted(2.0)[:1], 1.0)
    gap = np.zeros((2, 2, 3))
    gap[1, 0] = 3.0, 0.0, 4.0
    np.testing.assert_allclose(per_frame(gap), [0, 5 / np.sqrt(2)])
    assert root_mean_square(per_frame(gap)) == pytest.approx(2.5)  # √(25/4)
    assert extent(gap) == 5.0


def test_an_oscillator_comes_out_at_second_order_and_no_farther_off_than_it_says():
    found = converged(OSCILLATOR, 51)
    error = np.abs(found.positions[:, 1, 0] - (1 + 0.05 * np.sin(10 * 0.02 * np.arange(51))))
    # over both vertices the mean is 1/√2 of the one that moves; a third of the difference is left at order 2
    assert 0.4 * found.errors.max() < error.max() <= found.errors.max()
    assert found.error < 1e-5 * 1.05  # of the extent, from the fixed end to the farthest point
    assert found.order == pytest.approx(2, abs=0.05)  # h ω ≤ 0.01
    assert (found.integrator, found.step) == ("bdf2", 0.02 / 128)


def test_a_free_fall_and_two_objects_in_file_order():
    first, second = thing([(0, 2, 0)]), thing([(0, 5, 0), (1, 5, 0)], vertVel=[xyz((1, 0, 0))] * 2)
    found = converged(scene(first, second), 5)
    t = 0.02 * np.arange(5)
    assert found.positions.shape == (5, 3, 3)
    assert found.positions[:, 1, 0] == pytest.approx(t)
    assert found.positions[:, 2, 0] == pytest.approx(1 + t)
    assert np.abs(found.positions[:, 0, 1] - (2 - 9.81 * t**2 / 2)).max() <= found.errors.max()
    start = found.upto(3)
    assert (start.positions.shape, start.errors.shape, start.step) == ((3, 3, 3), (3,), found.step)
    still = converged(scene(thing([(0, 0, 0), (1, 0, 0)], fixed=(0, 1))), 3)
    assert (still.error, still.order, extent(still.positions), still.step) == (0.0, None, 1.0, 0.02 / 128)


def test_a_fall_on_a_sphere_is_as_far_off_as_it_says():
    # 0.1 kg from 0.5 m above the top of a sphere of 1000 N/m: there after √(2·0.5/9.81) s, then
    # depth = g/ω² (1 − cos ωs) + v/ω sin ωs, ω = 100/s, until it comes up again, after s = 0.0323 s
    found = converged(scene(thing([(0, 1.5, 0)]), colliders=[ball((0, 0, 0), 1.0)]), 18)
    t = 0.02 * np.arange(18)
    landing, w, speed = np.sqrt(1 / 9.81), 100.0, np.sqrt(9.81)
    s = t - landing
    inside = 1.0 - 9.81 / w**2 * (1 - np.cos(w * s)) - speed / w * np.sin(w * s)
    exact = np.where(s < 0, 1.5 - 9.81 * t**2 / 2, inside)
    assert ((s > 0).sum(), (exact[s > 0] < 1).all()) == (2, True)
    assert np.abs(found.positions[:, 0, 1] - exact).max() < 3 * found.errors.max()  # the estimate is no bound
    assert found.errors.max() < 1e-4


def test_runs_that_diverge_do_not_count(monkeypatch):
    own = reference.moving
    monkeypatch.setattr(reference, "moving", lambda *given: None if given[2] < 64 else own(*given))
    assert converged(FALL, 3, error=1.0).step == 0.02 / 128


def test_no_time_too_few_frames_and_too_many_are_refused():
    with pytest.raises(InvalidInput, match="use fewer frames"):
        converged(FALL, 10**12)
    with pytest.raises(InvalidInput, match="frames must be at least 2 to compare"):
        converged(FALL, 1)
    with pytest.raises(Diverged, match="no steps that fit into the time"):
        converged(FALL, 5, seconds=0.0)
