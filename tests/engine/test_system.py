"""From the scene to arrays: every name in its place, and nothing that the scene does not need."""

import numba
import numpy as np
from helpers.obstacles import box
from helpers.physics import ball, keys, scene, xyz
from helpers.scenes import cloth

from clothfit.base.arrays import Elements
from clothfit.engine.rollout import empty
from clothfit.engine.step.implicit import workspace
from clothfit.engine.system import BDF2, IMPLICIT, SYMPLECTIC, all_elements, build, with_elements

MADE = scene(
    cloth(2, 2), cloth(3, 3, damping=0.6, dragCoefficient=0.2), windVel=xyz((1, 2, 3)), delta=0.01, forwardSubSteps=4
)


def test_every_field_of_the_scene_has_its_place():
    source, system = MADE.cloths[1], build(MADE, 1)
    np.testing.assert_array_equal(system.x0, source.positions)
    assert (system.h, system.method, system.newton_iterations) == (0.01, IMPLICIT, 4)
    np.testing.assert_array_equal(system.vertex.mass, source.mass)
    assert system.vertex.damping == 0.6
    assert system.vertex.gravity.tolist() == [0, -9.81, 0]
    assert np.flatnonzero(~system.vertex.free).tolist() == [0, 2]
    np.testing.assert_array_equal(system.springs.ends, source.springs)
    np.testing.assert_array_equal(system.springs.stiffness, source.stiffness)
    assert system.springs.damping == 0.3  # α / 2
    np.testing.assert_array_equal(system.faces.corners, source.triangles)
    assert system.faces.drag == 0.2
    assert system.faces.wind.tolist() == [1, 2, 3]


def test_the_pattern_joins_the_free_ends_of_the_springs():
    system = build(MADE, 1)
    order, row, column, _ = system.pattern
    pairs = {(int(order[r]), int(column[e])) for r in range(len(order)) for e in range(row[r], row[r + 1])}
    free = set(range(9)) - {0, 2}
    assert pairs == {tuple(sorted(pair)) for pair in system.springs.ends.tolist() if set(pair) <= free}


def test_what_does_nothing_has_no_rows():
    still = build(scene(cloth(dragCoefficient=0.0), windVel=xyz((9, 9, 9)), integrationMethod=SYMPLECTIC), 0)
    assert still.method == SYMPLECTIC
    assert (still.faces.corners.shape, still.spheres.radius.shape) == ((0, 3), (0,))
    for name in ("colliders", "inputs", "surface", "contact", "applied"):
        assert getattr(still, name) is None
    planes = scene(colliders=[{**ball((0, 0, 0), 1.0), "type": 0}, ball((1, 2, 3), 0.25)])
    spheres = build(planes, 0).spheres
    assert (spheres.centre.tolist(), spheres.radius.tolist()) == ([[1, 2, 3]], [0.25])


def test_other_elements_and_nothing_else():
    system = build(MADE, 1)
    mass, stiffness = np.full(9, 2.0), np.full(16, 3.0)
    other = with_elements(system, Elements(mass, stiffness))
    mass[:] = stiffness[:] = 5.0  # memory of its own
    assert (other.vertex.mass.tolist(), other.springs.stiffness.tolist()) == ([2.0] * 9, [3.0] * 16)
    assert other.springs.rest is system.springs.rest
    for mine, its in zip(all_elements(other)[2:], all_elements(system)[2:], strict=True):
        np.testing.assert_array_equal(mine, its)
    np.testing.assert_array_equal(system.vertex.mass, MADE.cloths[1].mass)


def test_a_scene_is_of_one_of_two_types_of_arguments():
    """For each type all that takes a system is compiled: for plain scenes, and for all that move or touch."""
    pins = [{"vertices": [0], "posKeys": keys([0, 1], [(0, 0, 0), (0, 1, 0)])}]
    plain = scene(cloth(3, 3)), scene(cloth(3, 3, damping=0.1), integrationMethod=BDF2, windVel=xyz((1, 2, 3)))
    touching = {"thickness": 0.01, "stiffness": 50.0, "betweenObjects": True}
    others = (
        scene(cloth(3, 3), cloth(3, 3), selfCollision=touching),
        scene(cloth(3, 3), colliders=[box((0, -9, 0))]),
        scene(cloth(3, 3, pins=pins)),
        scene(cloth(3, 3), selfCollision={"thickness": 0.01, "stiffness": 50.0}),
    )
    found = [[*map(build, scenes, [0] * len(scenes))] for scenes in (plain, others)]
    found[1] += [build(MADE, 1, whole=True)]
    parts = [
        [(each, workspace(each), empty(each, 2)._replace(active_pairs=None)) for each in systems] for systems in found
    ]
    kinds = [set(map(numba.typeof, each)) for each in parts]
    assert [len(each) for each in kinds] == [1, 1]
