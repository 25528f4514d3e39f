"""Which parameters a motion cannot reveal, by the masks of a cloth; and which are hard to tell apart."""

import numpy as np
import pytest
from helpers.physics import ball, chain, scene, thing
from helpers.scenes import even

from clothfit import load, parameters, simulate, with_parameters
from clothfit.objective.identifiability import FEW, MOST, NOTABLE, STRONG, Value, identifiable, strongest, unobservable


def test_fixed_masses_and_springs_between_fixed_vertices_are_hidden():
    one = scene(chain(4, "LL", fixed=[0, 1])).cloths[0]
    assert unobservable(one, "mass", 0).tolist() == [True, True, False, False]
    assert unobservable(one, "stiffness", 0).tolist() == [True, False, False]


def test_the_mass_of_a_vertex_that_only_falls_is_hidden_unless_something_pushes_it():
    points, triangles = [(0, 0, 0), (1, 0, 0), (0, 0, 1), (5, 0, 0)], [(0, 1, 2)]
    made = {drag: scene(thing(points, triangles=triangles, dragCoefficient=drag)).cloths[0] for drag in (0.0, 0.5)}
    assert unobservable(made[0.0], "mass", 0).tolist() == [True] * 4
    assert unobservable(made[0.5], "mass", 0).tolist() == [False, False, False, True]
    assert unobservable(made[0.0], "mass", 1).tolist() == [False] * 4


def test_what_is_hidden_is_not_fitted():
    one = scene(chain(4, "LL", fixed=[0, 1]))
    assert [np.flatnonzero(~identifiable(one)[block.part]).tolist() for block in one.blocks] == [[0, 1], [0]]
    assert identifiable(one).tolist() == [False, False, True, True, False, True, True]


def test_one_value_for_all_is_hidden_only_when_all_are():
    some, every = (scene(chain(2, "GG", fixed=fixed)) for fixed in ([0], [0, 1]))
    assert identifiable(some).tolist() == [True, True]
    assert identifiable(every).tolist() == [False, False]


def test_hidden_parameters_do_not_move_the_cloth():
    one = scene(
        chain(4, "LL", fixed=[0, 1], damping=0.2), optimizationIterations=10, colliders=[ball((3, -0.5, 0), 0.52)]
    )
    p = parameters(one)
    other = np.where(identifiable(one), p, 2 * p)
    first, second = (simulate(with_parameters(one, q)).positions for q in (p, other))
    np.testing.assert_array_equal(first, second)
    third = simulate(with_parameters(one, 2 * other)).positions
    assert np.abs(first - third).max() > 1e-6


# --- values that are hard to tell apart


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
