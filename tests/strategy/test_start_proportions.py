"""The proportions of one fabric, for cloths of the editor's making and for others."""

import numpy as np
import pytest
from helpers.physics import scene, thing
from helpers.scenes import cloth

from clothfit.meshes import mesh
from clothfit.meshes.mesh import Mesh, areas
from clothfit.strategy.start import normalised, proportions

pytestmark = pytest.mark.slow  # compiles a fit

RNG = np.random.default_rng(12)


def uneven():
    """A plane whose vertices are moved, so that no two triangles are alike."""
    flat = mesh.plane(4, 1.0, 0.7)
    return Mesh(flat.positions + 0.02 * RNG.normal(size=flat.positions.shape), flat.triangles)


MESHES = {"square": mesh.plane(5, 1.0), "oblong": mesh.plane(6, 2.0, 0.9, upright=True), "uneven": uneven()}


def made(shape, bending=True, **fields):
    """A cloth of one fabric."""
    held = np.zeros(len(shape.positions), bool)
    own = mesh.object_document(shape, held, density=0.2, stiffness=40.0, bending=bending)
    return scene({**own, **fields}).cloths[0]


def relative(values):
    return values / np.exp(np.log(values).mean())


@pytest.mark.parametrize("bending", [True, False])
@pytest.mark.parametrize("name", MESHES)
def test_a_fabric_of_the_front_end_has_its_proportions(name, bending):
    one = made(MESHES[name], bending)
    mass, stiffness = proportions(one)
    np.testing.assert_allclose(mass, relative(one.mass), rtol=1e-13)  # rounding
    np.testing.assert_allclose(stiffness, relative(one.stiffness), rtol=1e-13)


def test_they_do_not_depend_on_the_values_in_the_scene():
    one, other = made(MESHES["uneven"]), made(MESHES["uneven"], vertMass=[7.0] * len(MESHES["uneven"].positions))
    np.testing.assert_array_equal(proportions(one)[0], proportions(other)[0])


def test_they_do_not_depend_on_size_or_place():
    shape = MESHES["uneven"]
    one, other = made(shape), made(Mesh(3.0 * shape.positions + 0.5, shape.triangles))
    for found, expected in zip(proportions(other), proportions(one), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12)  # rounding of differences of metres


def test_in_whatever_order_the_springs_and_vertices_stand():
    shape = MESHES["uneven"]
    one = made(shape)
    mass, stiffness = proportions(one)
    vertex, spring = RNG.permutation(len(mass)), RNG.permutation(len(stiffness))
    place = np.argsort(vertex)  # of each old vertex
    ends = place[one.springs[spring]]
    turned = np.where(RNG.uniform(size=(len(ends), 1)) < 0.5, ends, ends[:, ::-1])  # and whichever end comes first
    other = scene(thing(shape.positions[vertex], turned, place[shape.triangles])).cloths[0]
    found = proportions(other)
    np.testing.assert_allclose(found[0], mass[vertex], rtol=1e-13)  # rounding
    np.testing.assert_allclose(found[1], stiffness[spring], rtol=1e-13)


def test_the_geometric_mean_is_1():
    for values in proportions(made(MESHES["uneven"])):
        assert np.log(values).mean() == pytest.approx(0.0, abs=1e-14)  # rounding


def test_what_belongs_to_no_triangle_has_the_mean_of_the_rest():
    shape = MESHES["uneven"]
    n = len(shape.positions)
    one = made(shape)
    points = np.concatenate([shape.positions, [[5.0, 0.0, 0.0]]])
    ends = np.concatenate([one.springs, [[0, n], [0, n - 1]]])  # to a vertex of no face, and across the cloth
    mass, stiffness = proportions(scene(thing(points, ends, shape.triangles)).cloths[0])
    assert mass[-1] == 1.0
    assert stiffness[-2:].tolist() == [1.0, 1.0]
    np.testing.assert_allclose(mass[:-1], proportions(one)[0], rtol=1e-13)  # rounding
    np.testing.assert_allclose(stiffness[:-2], proportions(one)[1], rtol=1e-13)


def test_without_triangles_all_are_alike():
    mass, stiffness = proportions(scene(cloth(3, 3, triangles=[])).cloths[0])
    assert (mass == 1.0).all()
    assert (stiffness == 1.0).all()
    mass, stiffness = proportions(scene(thing(np.eye(3))).cloths[0])
    assert (len(mass), len(stiffness)) == (3, 0)


def test_an_edge_of_three_triangles_stands_for_all_of_them():
    points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 2), (0, -3, 0)]
    one = scene(thing(points, [(0, 1), (0, 2)], [(0, 1, 2), (0, 1, 3), (0, 1, 4)])).cloths[0]
    found = proportions(one)[1]
    assert found[0] / found[1] == pytest.approx(3.0 / 0.5, rel=1e-14)  # areas 0.5 + 1 + 1.5, and 0.5; lengths 1


def test_areas_and_means():
    assert areas(Mesh(np.array([(0, 0, 0), (2.0, 0, 0), (0, 0, 3)]), np.array([[0, 1, 2]]))).tolist() == [3.0]
    assert normalised(np.array([4.0, 0.0, 1.0])).tolist() == [2.0, 1.0, 0.5]
    assert normalised(np.zeros(2)).tolist() == [1.0, 1.0]
