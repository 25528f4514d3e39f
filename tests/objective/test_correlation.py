"""Which values are hard to tell apart."""

import numpy as np
import pytest
from helpers.scenes import even

import clothfit
from clothfit.motion.degrade import degrade
from clothfit.motion.simulate import simulate
from clothfit.objective.identifiability import FEW, MOST, NOTABLE, STRONG, Value, strongest
from clothfit.scene.scene import load


def blocks():
    return load(even("LG", 4)).blocks


def test_the_correlation_of_two_values_is_that_of_their_covariance():
    matrix = np.array([[4.0, -5.4, 0.1], [-5.4, 9.0, 0.0], [0.1, 0.0, 1.0]])
    own = blocks()
    count = own[0].count
    (found,) = strongest(matrix, np.array([0, 2, count]), own)  # 0.1 / 2 is not worth a line
    assert found.correlation == pytest.approx(-0.9, rel=1e-12)
    assert (found.first, found.second) == (Value(0, "mass", 0), Value(0, "mass", 2))
    assert NOTABLE <= 0.9


def test_of_many_values_the_strongest_pairs_are_listed():
    own = blocks()
    count = own[0].count
    assert count > FEW
    matrix = np.full((count, count), 0.95) + 0.05 * np.eye(count)
    matrix[0, 1] = matrix[1, 0] = 0.99
    matrix[2, 3] = matrix[3, 2] = 0.5 * STRONG
    found = strongest(matrix, np.arange(count), own)
    assert len(found) == MOST
    assert found[0].correlation == pytest.approx(0.99)
    assert (2, 3) not in [(each.first.index, each.second.index) for each in found]


def test_a_value_without_a_variance_has_no_correlation():
    assert strongest(np.array([[0.0, 0.0], [0.0, 1.0]]), np.array([0, 1]), blocks()) == ()


@pytest.mark.slow
def test_a_fit_says_where_it_began_and_what_it_can_hardly_tell_apart():
    scene = load(even("Gn", 20, fit={"gravity": "G"}))
    p = clothfit.parameters(scene)
    found = clothfit.estimate(scene, degrade(simulate(scene, 20, 1e-10), noise=1e-3), start=p + 0.01)
    assert clothfit.parameters(found.start) == pytest.approx(p + 0.01, rel=1e-12)
    assert found.parameters[0].start == pytest.approx(p[0] + 0.01)
    assert found.parameters[1].start == pytest.approx((p[1:] + 0.01).tolist())
    assert found.objective == {"position": 1.0}
    pair = found.correlations[0]
    assert (pair.first, pair.second) == (Value(0, "mass", 0), Value(None, "gravity", 1))
    best, step = clothfit.parameters(found.scene), 1e-4
    scales = np.eye(4) * [best[0], 1.0, 1.0, 1.0]  # of the mass the logarithm counts
    there, back = ([motion_after(scene, best + way * each) for each in scales] for way in (step, -step))
    J = np.array(there) - np.array(back)
    C = np.linalg.inv(J @ J.T)
    # differences of second order in steps of 1e-4
    assert pair.correlation == pytest.approx(C[0, 2] / np.sqrt(C[0, 0] * C[2, 2]), abs=1e-5)


def motion_after(scene, p):
    """The positions with the values p, flat."""
    return simulate(clothfit.with_parameters(scene, p), 20, 1e-12).positions.ravel()
