"""Values for Houdini's Vellum: constraints, masses, mantissa and exponent."""

import json

import numpy as np
import pytest
from helpers.exports import ROUNDING, built, content, of, two
from helpers.scenes import cloth, document, load_text

from clothfit import simulate
from clothfit.base.errors import InvalidInput
from clothfit.export.tools import exported
from clothfit.export.topology import roles

POINTS, PRIMITIVES = "pointattributes", "primitiveattributes"


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
    for values in content(scene, "vellum", "vellum.json")["objects"]:
        mean, mantissa, exponent = (values["traction"][name] for name in ("mean", "mantissa", "exponent"))
        assert 1 <= mantissa < 10
        assert mantissa * 10.0**exponent == pytest.approx(mean, rel=ROUNDING)


def moved_by_constraints(points, ends, constraints, velocity, h, steps):
    """Move points as solvers of compliant constraints do, each step with sweeps until nothing changes.

    XPBD: M. Macklin, M. Müller, N. Chentanez, MIG 2016.
    """
    x, v = np.array(points["P"]), np.array(velocity)
    inverse = np.array([1 / m if m else 0.0 for m in points["mass"]])
    compliance = 1 / np.array(constraints["stiffness"]) / h**2
    for _ in range(steps):
        before = x.copy()
        x = x + (h * v + h**2 * np.array([0, -9.81, 0])) * (inverse > 0)[:, None]
        multiplier = np.zeros(len(ends))
        for _ in range(40):
            for s, (a, b) in enumerate(ends):
                e = x[a] - x[b]
                length = np.sqrt(e @ e)
                gap = length - constraints["restlength"][s]
                change = -(gap + compliance[s] * multiplier[s]) / (inverse[a] + inverse[b] + compliance[s])
                multiplier[s] += change
                x[a] += inverse[a] * change * e / length
                x[b] -= inverse[b] * change * e / length
        v = (x - before) / h
    return x


def test_a_solver_of_constraints_moves_the_exported_cloth_as_it_moves_here():
    # both take backward Euler steps; what is left comes from how far a constraint turns within a step
    still = {"dragCoefficient": 0.0, "damping": 0.0}
    h, steps = 0.01, 25
    how = {"delta": h, "optimizationIterations": steps + 1, "forwardSubSteps": 30, "tolerance": 1e-9}
    scene = load_text(json.dumps(document(built(1, **still), **how)))
    _, _, ends, held = geometry(exported(scene, "vellum")["object0.constraints.geo"])
    points, constraints = ({name: held[of, name] for of, name in held if of == kind} for kind in (POINTS, PRIMITIVES))
    found = moved_by_constraints(points, ends, constraints, points["v"], h, steps)
    expected = simulate(scene).positions[-1] * np.array([1.0, 1.0, -1.0])
    moved = np.abs(expected - points["P"]).max()
    assert moved > 0.1
    assert np.abs(found - expected).max() < 1e-3 * moved  # 3e-4 at this step, 1e-8 over shorter and fewer ones
    softer = {**constraints, "stiffness": [0.9 * k for k in constraints["stiffness"]]}
    other = moved_by_constraints(points, ends, softer, points["v"], h, steps)
    assert np.abs(other - expected).max() > 1e-2 * moved  # so the stiffnesses do decide


@pytest.mark.parametrize("tool", ["vellum", "obi", "blender"])
def test_a_value_that_overflows_in_the_tools_terms_is_refused(tool):
    """A mass of 1e-200 kg on a spring of 1e200 N/m: the damping ratio is the root of 1e400."""
    made = of(cloth(2, 2, vertMass=[1e-200] * 4, springStiffness=[1e200] * 5, damping=1e250))
    if tool == "vellum":
        with pytest.raises(InvalidInput, match=r"vellum cannot have the scene: a value in its terms is infinite"):
            exported(made, tool)
    else:  # which take what there is
        assert exported(made, tool)
