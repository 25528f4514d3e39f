"""From the fit vector to columns: shares, factors, directions."""

import numpy as np
from helpers.physics import scene, xyz
from helpers.scenes import cloth

from clothfit.derivative.columns import columns
from clothfit.derivative.sensitivity import along
from clothfit.engine.system import build
from clothfit.scene.fit_vector import changes, parameters, size

EVERY = {"damping": "G", "dragCoefficient": "G", "vertVel": "L", "springRestLength": "G"}
VELOCITIES = [xyz((0.1 * i, 1, -i)) for i in range(9)]


def made(settings="LG", fit=EVERY, whole=None):
    """A scene of two cloths, the second one flagged."""
    own = cloth(3, 3, optimizationSettings=settings, fit=fit, vertVel=VELOCITIES)
    return scene(cloth(2, 2, optimizationSettings="LL"), own, fit=whole or {"windVel": True, "gravity": True})


def of_second(given, column, factor, count):
    """The columns of the second cloth."""
    own = [block for block in given.blocks if block.cloth in (1, None)]
    return columns(build(given, 1), own, parameters(given), column, factor, count)


def test_a_column_is_the_change_of_all_elements_by_its_parameter():
    given = made()
    count = size(given)
    own = np.concatenate([np.arange(count)[block.part] for block in given.blocks if block.cloth in (1, None)])
    column, factor = np.full(count, -1, np.int32), np.random.default_rng(2).uniform(0.5, 2.0, count)
    column[own] = np.random.default_rng(3).permutation(len(own))
    found = of_second(given, column, factor, len(own))
    assert found.width == len(own)
    for i in own:
        unit = np.zeros(count)
        unit[i] = factor[i]
        expected = changes(given, 1, parameters(given), unit)
        change = along(build(given, 1), found, int(column[i]))
        for name, value in expected._asdict().items():
            # a kind that a column does not touch may be left out of its change
            whole = np.broadcast_to(getattr(change, name), value.shape) if getattr(change, name).size else 0.0 * value
            np.testing.assert_array_equal(whole, value)


def test_what_is_held_has_no_column():
    given = made("LL")
    column = np.full(size(given), -1, np.int32)
    places = {(block.cloth, block.name): block.start for block in given.blocks}
    column[places[1, "mass"] + 4] = 0
    column[places[1, "stiffness"] + 7] = 1
    column[places[1, "velocity"] + 5] = 2
    found = of_second(given, column, np.ones(len(column)), 3)
    assert np.flatnonzero(found.mass.column >= 0).tolist() == [4]
    assert np.flatnonzero(found.stiffness.column >= 0).tolist() == [7]
    assert [len(part) for part in (found.rest.column, found.everywhere, found.velocity)] == [0, 0, 1]
    ((place, change),) = found.velocity
    assert place == 2
    assert np.argwhere(change != 0).tolist() == [[1, 2]]


def test_one_value_for_all_has_one_column_with_the_units_of_its_elements():
    given = made("GG")
    count = size(given)
    places = {block.name: block for block in given.blocks if block.cloth == 1}
    column = np.full(count, -1, np.int32)
    column[places["stiffness"].start], column[places["rest"].start] = 0, 1
    found = of_second(given, column, np.full(count, 3.0), 2)
    assert set(found.stiffness.column.tolist()) == {0}
    np.testing.assert_array_equal(found.stiffness.factor, 3.0)
    assert set(found.rest.column.tolist()) == {1}
    # one factor on the lengths at vertPos; rounding of a product
    np.testing.assert_allclose(found.rest.factor, 3.0 * given.cloths[1].lengths, rtol=1e-15)


def test_nothing_to_fit_has_no_columns():
    given = scene(cloth(3, 3))
    found = columns(build(given, 0), given.blocks, np.zeros(0), np.zeros(0, np.int32), np.zeros(0), 0)
    assert len(parameters(given)) == 0
    assert found.width == 0
    assert (found.mass.column == -1).all()
    assert (found.stiffness.column == -1).all()
