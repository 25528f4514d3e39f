"""Which vertices act on which, and colours that keep them apart."""

import numpy as np
import pytest
from helpers import physics
from helpers.physics import gentle, thing

from clothfit.derivative.step_jacobian import stencil
from clothfit.engine.step import explicit


def distances(system):
    """Distance (n, n) between all vertices, in springs and sides of faces, by powers of the neighbourhood."""
    n = len(system.x0)
    near = np.eye(n, dtype=int)
    for corners in [*system.springs.ends.tolist(), *system.faces.corners.tolist()]:
        near[np.ix_(corners, corners)] = 1
    found, reach = np.full((n, n), n), np.eye(n, dtype=int)
    for distance in range(n):
        found = np.where((reach > 0) & (found == n), distance, found)
        reach = np.minimum(reach @ near, 1)
    return found


SYSTEMS = {
    "cloth": physics.full(4, 3),
    "chain": physics.system(thing([(i, 0, 0) for i in range(6)], [(i, i + 1) for i in range(5)])),
    "one face": physics.system(thing(np.eye(3), triangles=[(0, 1, 2)], dragCoefficient=1.0)),
    "double springs": physics.system(thing(np.eye(3), [(0, 1), (1, 0), (0, 1), (1, 2)])),
    "lone vertices": physics.system(thing(np.eye(3))),
    "not connected": physics.system(thing(np.arange(12.0).reshape(4, 3), [(0, 1), (2, 3)])),
}


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("distance", [1, 2])
def test_neighbours_are_those_that_something_joins_and_two_of_one_colour_are_farther_apart(name, distance):
    system = SYSTEMS[name]
    made, apart = stencil(system, distance), distances(system)
    for i, row in enumerate(apart):
        found = made.neighbour[made.start[i] : made.start[i + 1]]
        assert found.tolist() == np.flatnonzero(row <= 1).tolist()
    same = made.color[:, None] == made.color[None, :]
    np.fill_diagonal(same, False)
    assert (apart[same] > distance).all()
    assert sorted(set(made.color.tolist())) == list(range(made.colors))


def test_the_number_of_colours_does_not_grow_with_the_cloth():
    # greedy: at most one more than the neighbours at distance 2, of which an inner vertex of this pattern has 18
    assert stencil(gentle(nx=12, ny=12), 2).colors <= 19


def test_no_force_reaches_beyond_the_stencil():
    system = gentle(nx=5, ny=4)
    near, v = stencil(system, 2), np.zeros_like(system.x0)
    still = explicit_force(system, system.x0, v)
    for i in range(len(system.x0)):
        moved = system.x0.copy()
        moved[i] += (0.01, 0.02, -0.03)
        felt = np.flatnonzero((explicit_force(system, moved, v) != still).any(axis=1))
        assert set(felt.tolist()) <= set(near.neighbour[near.start[i] : near.start[i + 1]].tolist())


def explicit_force(system, x, v):
    """The velocity after an explicit step: linear in the force."""
    w = np.zeros_like(x)
    explicit.step(system, x, v, w, np.empty_like(x))
    return w
