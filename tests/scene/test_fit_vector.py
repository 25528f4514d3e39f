"""The fit vector of a scene: order, reduction, and the way back."""

import numpy as np
import pytest
from helpers.physics import chain, scene, thing

from clothfit.base.errors import InvalidInput
from clothfit.scene.fit_vector import changes, elements, fitted_cloths, parameters, size, with_parameters

MIXED = scene(chain(3, "LG"), chain(4, "nn"), chain(2, "Gn"), chain(4, "nl"))


def test_objects_in_order_and_masses_before_stiffnesses():
    assert parameters(MIXED).tolist() == [1, 2, 3, 15, 1.5, 10, 20, 30]
    found = [(b.cloth, b.name, b.mode, b.elements, b.start, b.count) for b in MIXED.blocks]
    assert found == [
        (0, "mass", "L", 3, 0, 3),
        (0, "stiffness", "G", 2, 3, 1),
        (2, "mass", "G", 2, 4, 1),
        (3, "stiffness", "L", 3, 5, 3),
    ]
    assert size(MIXED) == 8
    lonely = scene(thing([(0, 0, 0)], optimizationSettings="GG"))  # a flag on nothing has no parameters
    assert [block.name for block in lonely.blocks] == ["mass"]
    assert fitted_cloths(MIXED) == [0, 2, 3]


def test_there_and_back():
    p = 2.0 + np.arange(8)
    back = with_parameters(MIXED, p)
    np.testing.assert_array_equal(parameters(back), p)
    assert back.cloths[0].stiffness.tolist() == [5, 5]
    assert back.cloths[0].mass.tolist() == [2, 3, 4]
    assert back.cloths[2].mass.tolist() == [6, 6]
    assert back.cloths[2].stiffness.tolist() == [10]  # not flagged
    assert back.cloths[1].mass.tolist() == MIXED.cloths[1].mass.tolist()
    values, change = elements(MIXED, 2, p), changes(MIXED, 2, p, p)
    assert (values.mass.tolist(), values.stiffness.tolist()) == ([6, 6], [10])
    assert (change.mass.tolist(), change.stiffness.tolist()) == ([6, 6], [0])
    mass, stiffness, *_ = MIXED.blocks
    assert mass.reduce(np.array([1.0, 2, 3]), p).tolist() == [1, 2, 3]
    assert stiffness.reduce(np.array([5.0, 7]), p).tolist() == [12]  # of one value the sum over the elements


@pytest.mark.parametrize("p", [np.ones(7), np.ones((8, 1)), 1.0])
def test_a_vector_of_another_shape_is_refused(p):
    with pytest.raises(InvalidInput) as caught:
        with_parameters(MIXED, p)
    assert str(caught.value) == f"parameters: shape {np.shape(p)} given, scene has (8,)"


def test_parameters_of_one_scene_with_the_flags_of_another():
    plain = scene(chain(3, "nn"))
    assert parameters(plain, flags=scene(chain(3, "Ln"))).tolist() == [1, 2, 3]
    with pytest.raises(InvalidInput) as caught:
        parameters(plain, flags=scene(chain(4, "Ln")))
    assert str(caught.value) == "scene: objects[0] has 3 values of mass, 4 are needed"
    with pytest.raises(InvalidInput):
        parameters(plain, flags=scene(chain(3, "nn"), chain(2, "Ln")))
