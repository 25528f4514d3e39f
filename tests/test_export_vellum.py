"""Values for Houdini's Vellum: constraints, masses, mantissa and exponent."""

import json

import numpy as np
import pytest
from exports import ROUNDING, content, of, two
from scenes import cloth

from clothfit.export import exported
from clothfit.export.topology import roles


@pytest.fixture(scope="module")
def scene():
    """Two objects, the first with bending springs."""
    return two()


def pairs(flat):
    """A list of keys and values in turn, as Houdini writes objects."""
    return dict(zip(flat[::2], flat[1::2], strict=True))


def geometry(data):
    """Counts, corners by polygon, and the attributes of points and primitives of a .geo file."""
    held = pairs(json.loads(data))
    corners = pairs(pairs(held["topology"])["pointref"])["indices"]
    ((kind, run),) = held["primitives"]
    run = pairs(run)
    sides, count = run["nvertices_rle"]
    attributes = {}
    for name, listed in pairs(held["attributes"]).items():
        for head, body in listed:
            head, body = pairs(head), pairs(body)
            if head["type"] == "string":
                (places,) = pairs(body["indices"])["arrays"]
                values = [body["strings"][place] for place in places]
            else:
                given = pairs(body["values"])
                values = given["tuples"] if "tuples" in given else given["arrays"][0]
            attributes[name, head["name"]] = values
    assert held["primitivecount"] == count == run["nprimitives"]
    assert held["vertexcount"] == len(corners) == sides * count
    return held["pointcount"], pairs(kind)["type"], np.reshape(corners, (count, sides)), attributes


def test_the_constraints_of_vellum_are_the_springs(scene):
    for number, found in enumerate(scene.cloths):
        count, kind, ends, held = geometry(exported(scene, "vellum")[f"object{number}.constraints.geo"])
        assert (count, kind) == (len(found.mass), "PolygonCurve_run")
        assert (ends == found.springs).all()
        assert held["primitiveattributes", "stiffness"] == found.stiffness.tolist()
        assert held["primitiveattributes", "restlength"] == found.rest.tolist()
        assert set(held["primitiveattributes", "type"]) == {"distance"}
        assert held["primitiveattributes", "role"] == roles(found).names
        mass = np.array(held["pointattributes", "mass"])
        assert (mass == np.where(found.fixed, 0, found.mass)).all()


def test_the_mesh_of_vellum_is_right_handed_and_faces_the_same_way(scene):
    for number, found in enumerate(scene.cloths):
        count, kind, corners, held = geometry(exported(scene, "vellum")[f"object{number}.cloth.geo"])
        assert (count, kind) == (len(found.mass), "Polygon_run")
        points, mirror = np.array(held["pointattributes", "P"]), np.array([1.0, 1.0, -1.0])
        assert (points * mirror == found.positions).all()
        assert (np.array(held["pointattributes", "v"]) * mirror == found.velocity).all()

        def normals(x, faces):
            return np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])

        # the mirror image of a face's front is the front of its mirror image
        assert np.allclose(normals(points, corners), normals(found.positions, found.triangles) * mirror, atol=1e-15)


def test_the_damping_ratio_is_1_where_a_spring_just_does_not_swing():
    # m v' = −k x − c v does not swing from c = 2 √(k m) on, and c = (α/2) k
    m, k = 0.5, 8.0
    alpha = 2 * 2 * (k * m) ** 0.5 / k
    held = {"vertIsFixed": [True, False, False, False], "vertMass": [9.0, m, m, m], "damping": alpha}
    found = of(cloth(2, 2, springStiffness=[k] * 5, **held))
    ratios = geometry(exported(found, "vellum")["object0.constraints.geo"])[3]["primitiveattributes", "dampingratio"]
    hung = found.cloths[0].fixed[found.cloths[0].springs].any(axis=1)
    assert np.array(ratios)[hung] == pytest.approx(1.0, rel=1e-12)
    assert np.array(ratios)[~hung] == pytest.approx(2**0.5, rel=1e-12)  # of two that swing, half the mass counts


def test_mantissa_and_exponent_are_the_mean(scene):
    for told in content(scene, "vellum", "vellum.json")["objects"]:
        mean, mantissa, exponent = (told["traction"][name] for name in ("mean", "mantissa", "exponent"))
        assert 1 <= mantissa < 10
        assert mantissa * 10.0**exponent == pytest.approx(mean, rel=ROUNDING)
