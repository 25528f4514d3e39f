"""Modes F, R and M: factors on the values that a scene has."""

import numpy as np
import pytest
from helpers.physics import scene
from helpers.scenes import cloth

from clothfit.scene.factors import LEAST_MODES, MAP_VALUES, Factors, modes_of_each, smooth_maps
from clothfit.scene.families import spring_groups
from clothfit.scene.fit_vector import elements, parameters, with_parameters

STIFFNESS = [3.0, 5.0, 0.0, *np.linspace(1.0, 40.0, 13)]
MASSES = np.linspace(0.01, 0.3, 9).tolist()


def made(letters, rest="n"):
    """A sheet of 9 vertices and 16 springs, whose values all differ and of which one is 0."""
    own = cloth(3, 3, optimizationSettings=letters, fit={"springRestLength": rest})
    return scene({**own, "vertMass": MASSES, "springStiffness": STIFFNESS})


def block(given, name):
    """The block of a kind."""
    return next(each for each in given.blocks if each.name == name)


@pytest.mark.parametrize("letters", ["nF", "fn", "RR", "Mm", "FL", "nR", "GM"])
def test_factors_are_1_at_the_values_of_the_scene(letters):
    given = made(letters, rest="M")
    for each in given.blocks:
        inside = parameters(given)[each.part]
        np.testing.assert_array_equal(inside, 1.0 if each.factors else inside)
    back = with_parameters(given, parameters(given))
    kept = [i for i, mode in enumerate(letters.upper()) if mode != "G"]
    for name in np.array(["mass", "stiffness"])[kept]:
        np.testing.assert_array_equal(getattr(back.cloths[0], name), getattr(given.cloths[0], name))
    np.testing.assert_array_equal(back.cloths[0].rest, given.cloths[0].rest)


def test_one_factor_keeps_the_proportions():
    given = made("FF", rest="F")
    changed = with_parameters(given, [2.0, 3.0, 0.5]).cloths[0]
    np.testing.assert_array_equal(changed.mass, 2.0 * given.cloths[0].mass)
    np.testing.assert_array_equal(changed.stiffness, 3.0 * given.cloths[0].stiffness)
    np.testing.assert_array_equal(changed.rest, 0.5 * given.cloths[0].rest)
    still = scene({**cloth(3, 3, optimizationSettings="nF"), "springStiffness": [0.0] * 16})
    assert with_parameters(still, [7.0]).cloths[0].stiffness.tolist() == [0.0] * 16
    assert parameters(still, flags=still).tolist() == [1.0]  # which is hidden


def test_a_factor_for_each_group():
    given = made("nR")
    groups, own = spring_groups(given.cloths[0]), block(given, "stiffness")
    assert own.factors.names == groups.names
    assert len(groups.names) > 1
    p = 1.0 + np.arange(own.count)
    changed = with_parameters(given, p).cloths[0].stiffness
    np.testing.assert_array_equal(changed, p[groups.of] * given.cloths[0].stiffness)
    # products and logarithms; the first group has the value that is 0
    np.testing.assert_allclose(parameters(with_parameters(given, p), flags=given), p, rtol=1e-14)


def test_a_map_contains_the_factors_of_groups():
    groups, maps = made("nR"), made("nM")
    constant = block(maps, "stiffness").constant
    p = np.ones(len(constant))
    p[constant] = 1.0 + np.arange(constant.sum())
    values = [with_parameters(given, q).cloths[0].stiffness for given, q in ((groups, p[constant]), (maps, p))]
    np.testing.assert_allclose(*values, rtol=1e-14)  # exp(log p)


def test_the_factor_of_a_mode_is_the_change_where_the_mode_is_1():
    given = made("Mn")
    own = block(given, "mass").factors
    B = own.dense()
    assert (B[:, 0] == 1).all()
    p = np.ones(own.count)
    p[1] = 1.7
    ratio = with_parameters(given, p).cloths[0].mass / given.cloths[0].mass
    at = int(np.argmax(B[:, 1]))
    assert B[at, 1] == 1.0  # the largest of a mode on the vertices
    np.testing.assert_allclose(ratio, 1.7 ** B[:, 1], rtol=1e-14)  # exp(log p)


def test_the_nearest_map_of_a_map_is_itself():
    own = cloth(3, 3, optimizationSettings="MM")
    given = scene({**own, "vertMass": MASSES, "springStiffness": [2.5 + k for k in STIFFNESS]})
    p = np.exp(np.random.default_rng(1).normal(0.0, 0.3, len(parameters(given))))
    found = parameters(with_parameters(given, p), flags=given)
    np.testing.assert_allclose(found, p, rtol=1e-12)  # a least-squares problem of condition below 1e3


def test_no_value_of_a_map_passes_the_bounds():
    given = made("nM")
    own = block(given, "stiffness")
    for factor in (1e-9, 1e9, 1e300):
        values = elements(given, 0, np.full(own.count, factor)).stiffness
        assert np.isfinite(values).all()
        assert values[2] == 0.0
        positive = np.delete(values, 2)
        assert own.ends[0] <= positive.min() <= positive.max() <= own.ends[1]


def test_how_many_modes_each_map_has():
    assert modes_of_each([200, 300]) == [MAP_VALUES // 2] * 2
    assert modes_of_each([500]) == [MAP_VALUES]
    assert modes_of_each([50] * 40) == [LEAST_MODES] * 40
    assert modes_of_each([3, 400]) == [3, MAP_VALUES // 2]
    given = made("nM")
    sizes = np.bincount(spring_groups(given.cloths[0]).of)
    assert (np.array(block(given, "stiffness").factors.modes) <= sizes).all()


def test_modes_that_say_nothing_new_are_left_out():
    x = np.linspace(-1.0, 1.0, 5)
    modes = np.stack([np.ones(5), x, 2 * x + 3, x**2], axis=1)
    found = smooth_maps(np.ones(5), np.zeros(5, np.int32), ("all",), modes, (1e-4, 1e4))
    assert found.modes == (3,)
    np.testing.assert_array_equal(found.dense(), modes[:, [0, 1, 3]])


@pytest.mark.parametrize("letters", ["F", "R", "M"])
def test_the_change_of_the_values_is_their_derivative_and_the_gradient_its_transpose(letters):
    own: Factors = block(made(f"n{letters}"), "stiffness").factors
    rng = np.random.default_rng(2)
    p, d, g = np.exp(rng.normal(0, 0.2, own.count)), rng.normal(size=own.count), rng.normal(size=16)
    h = 1e-6
    difference = (own.values(p + h * d) - own.values(p - h * d)) / (2 * h)
    np.testing.assert_allclose(own.change(p, d), difference, atol=1e-7)  # h² and rounding over h, of values up to 40
    assert own.gradient(p, g) @ d == pytest.approx(g @ own.change(p, d), rel=1e-12)
