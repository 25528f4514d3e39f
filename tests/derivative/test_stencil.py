"""Which vertices act on which."""

import numpy as np
import pytest
from helpers import physics
from helpers.physics import thing

from clothfit.derivative.step_jacobian import stencil


def joined(system):
    """Whether (n, n) two vertices are the same, or share a spring or a face."""
    near = np.eye(len(system.x0), dtype=bool)
    for corners in [*system.springs.ends.tolist(), *system.faces.corners.tolist()]:
        near[np.ix_(corners, corners)] = True
    return near


SYSTEMS = {
    "cloth": physics.full(4, 3),
    "chain": physics.system(thing([(i, 0, 0) for i in range(6)], [(i, i + 1) for i in range(5)])),
    "one face": physics.system(thing(np.eye(3), triangles=[(0, 1, 2)], dragCoefficient=1.0)),
    "double springs": physics.system(thing(np.eye(3), [(0, 1), (1, 0), (0, 1), (1, 2)])),
    "lone vertices": physics.system(thing(np.eye(3))),
    "not connected": physics.system(thing(np.arange(12.0).reshape(4, 3), [(0, 1), (2, 3)])),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_neighbours_are_those_that_something_joins(name):
    near, expected = stencil(SYSTEMS[name]), joined(SYSTEMS[name])
    for i, row in enumerate(expected):
        assert near.neighbour[near.start[i] : near.start[i + 1]].tolist() == np.flatnonzero(row).tolist()
    first, second = np.nonzero(expected)
    assert near.neighbour[near.entries(first, second)].tolist() == second.tolist()
