"""From the fit vector to columns: shares, factors, directions."""

import numpy as np
from helpers.physics import scene, xyz
from helpers.scenes import cloth

from clothfit.derivative.sensitivity import along, columns
from clothfit.engine.system import build
from clothfit.scene.fit_vector import acting, changes, parameters, size

EVERY = {"damping": "G", "dragCoefficient": "G", "vertVel": "L", "springRestLength": "G"}
VELOCITIES = [xyz((0.1 * i, 1, -i)) for i in range(9)]


def made(settings="LG", fit=EVERY, whole=None):
    """A scene of two cloths, the second one flagged."""
    own = cloth(3, 3, optimizationSettings=settings, fit=fit, vertVel=VELOCITIES)
    return scene(cloth(2, 2, optimizationSettings="LL"), own, fit=whole or {"windVel": True, "gravity": True})


def of_second(given, column, factor, count):
    """The columns of the second cloth."""
    return columns(build(given, 1), acting(given, 1), parameters(given), column, factor, count)


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


def test_nothing_to_fit_has_no_columns():
    given = scene(cloth(3, 3))
    found = columns(build(given, 0), [], np.zeros(0), np.zeros(0, np.int32), np.zeros(0), 0)
    assert len(parameters(given)) == 0
    assert found.width == 0
    assert (found.mass.column == -1).all()
    assert (found.stiffness.column == -1).all()
