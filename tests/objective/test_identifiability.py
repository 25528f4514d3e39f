"""Which parameters a motion cannot reveal: the masks of a cloth, and that they are right."""

import numpy as np
from helpers.physics import ball, chain, scene, thing

from clothfit.motion.simulate import simulate
from clothfit.objective.identifiability import hidden, identifiable
from clothfit.scene.fit_vector import parameters, with_parameters


def test_fixed_masses_and_springs_between_fixed_vertices_are_hidden():
    one = scene(chain(4, "LL", fixed=[0, 1])).cloths[0]
    assert hidden(one, "mass", 0).tolist() == [True, True, False, False]
    assert hidden(one, "stiffness", 0).tolist() == [True, False, False]


def test_the_mass_of_a_vertex_that_only_falls_is_hidden_unless_something_pushes_it():
    points, triangles = [(0, 0, 0), (1, 0, 0), (0, 0, 1), (5, 0, 0)], [(0, 1, 2)]
    made = {drag: scene(thing(points, triangles=triangles, dragCoefficient=drag)).cloths[0] for drag in (0.0, 0.5)}
    assert hidden(made[0.0], "mass", 0).tolist() == [True] * 4
    assert hidden(made[0.5], "mass", 0).tolist() == [False, False, False, True]
    assert hidden(made[0.0], "mass", 1).tolist() == [False] * 4


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
