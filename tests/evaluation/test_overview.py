"""What is told of a scene, against NumPy and counts made in another way."""

import json

import numpy as np
import pytest
from helpers.paths import EXAMPLES
from helpers.scenes import cloth, document, sphere, trial

from clothfit import load, mesh, new_scene, parameters
from clothfit.evaluation import overview
from clothfit.evaluation.overview import Flagged, beyond_bounds, facts, flagged, spring_kinds

SCENES = sorted(EXAMPLES.glob("*.json"))


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_the_facts_of_the_examples_are_numpys(path):
    text = json.loads(path.read_text("utf-8"))["objects"][0]
    own = facts(load(path).cloths[0])
    assert (own.vertices, own.triangles, own.springs) == (len(text["vertPos"]), 242, 726) == (144, 242, 726)
    assert (own.fixed, own.parts, own.loose) == (sum(text["vertIsFixed"]), (144,), 0)
    for values, found in ((text["vertMass"], own.mass), (text["springStiffness"], own.stiffness)):
        assert (found.least, found.median, found.most) == (min(values), np.median(values), max(values))
        assert found.total == pytest.approx(sum(values), rel=1e-13)
    points = np.array([[p["x"], p["y"], p["z"]] for p in text["vertPos"]])
    assert (own.low, own.high) == (tuple(points.min(axis=0)), tuple(points.max(axis=0)))
    pairs = np.array(text["springs"]).reshape(-1, 2)
    lengths = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    assert own.rest.most == pytest.approx(lengths.max(), rel=1e-14)
    assert (own.moving, own.strained) == (False, False)


@pytest.mark.parametrize("sheet", [mesh.plane(10, 7.0), mesh.plane(3, 2.0, 1.0), mesh.plane(0, 1.0)])
def test_springs_are_told_apart_as_they_were_made(sheet):
    made = mesh.springs(sheet, 1.0)
    edge, bends = spring_kinds(made.ends, sheet.triangles)
    np.testing.assert_array_equal(bends, made.bends)
    np.testing.assert_array_equal(edge, ~made.bends)


def test_of_a_tetrahedron_every_pair_is_an_edge_and_opposite_one_and_a_diagonal_is_neither():
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]], np.int32)
    made = mesh.springs(mesh.Mesh(np.random.default_rng(0).normal(size=(4, 3)), faces), 1.0)
    edge, bends = spring_kinds(made.ends, faces)
    assert (edge.sum(), bends.sum()) == (6, 6)
    edge, bends = spring_kinds(np.array([[0, 15], [0, 1]], np.int32), mesh.plane(2, 1.0).triangles)
    assert (edge.tolist(), bends.tolist()) == ([False, True], [False, False])  # a spring of neither kind


def test_an_object_of_one_vertex_and_nothing_else():
    point = {"vertPos": [{"x": 0, "y": 0, "z": 0}], "vertIsFixed": [False], "vertMass": [1.0], "springs": [],
             "springStiffness": []}  # fmt: skip
    own = facts(load(document(point)).cloths[0])
    assert (own.parts, own.loose, own.triangles, own.rest.least) == ((), 1, 0, None)


def test_parts_and_what_no_spring_holds():
    made = cloth(3, 2)
    made["vertPos"] += [{"x": 9.0 + i, "y": 0.0, "z": 0.0} for i in range(3)]
    made["vertIsFixed"] += [False] * 3
    made["vertMass"] += [1.0] * 3
    made["springs"] += [6, 7]
    made["springStiffness"] += [1.0]
    own = facts(load(document(made)).cloths[0])
    assert (own.parts, own.loose) == ((6, 2), 1)


def test_what_is_flagged_is_in_the_order_of_the_fit_vector():
    kinds = {"damping": "G", "vertVel": "L", "springRestLength": "G"}
    objects = cloth(3, 3, optimizationSettings="Ln", fit=kinds), cloth(2, 2, optimizationSettings="nG")
    scene = load(document(*objects, fit={"windVel": True}))
    assert flagged(scene) == [
        Flagged(0, "mass", "L", 9), Flagged(0, "damping", "G", 1), Flagged(0, "velocity", "L", 27),
        Flagged(0, "rest", "G", 1), Flagged(1, "stiffness", "G", 1), Flagged(None, "wind", "G", 3),
    ]  # fmt: skip
    assert sum(each.count for each in flagged(scene)) == len(parameters(scene))


def test_values_beyond_a_fits_bounds_are_told():
    sheet = mesh.plane(3, 0.1)  # 25 vertices of 0.01 m²
    assert beyond_bounds(new_scene(sheet, fit="nG")) == []
    light = {fit: new_scene(sheet, fit=fit, density=0.2) for fit in ("Ln", "Gn", "Fn")}
    assert [beyond_bounds(scene) for scene in light.values()] == [[]] * 3  # the bounds go beyond the cloth's own values
    given = {fit: scene.with_bounds({"mass": (1e-4, None)}) for fit, scene in light.items()}
    (of_each,) = beyond_bounds(given["Ln"])
    assert of_each.startswith("objects[0] mass: 16 of 25 values are not within 0.0001 … 10000 kg")
    assert beyond_bounds(given["Fn"]) == [of_each]
    (mean,) = beyond_bounds(given["Gn"])
    assert "the mean is not within" in mean
    assert beyond_bounds(new_scene(sheet, fit="nn", fits={"rest": "G", "wind": "G"})) == []


def test_fields_that_nobody_knows_are_named_once():
    objects = cloth(2, 2, useBendingSprings=True), cloth(2, 2, useBendingSprings=True, meshVertices=[0, 1, 2, 3])
    scene = load(document(*objects, colliders=[sphere(name="ball")], **{"my field": 1}))
    assert list(overview.unknown_fields(scene)) == ['"my field"', "colliders[0].name", "objects[0].useBendingSprings"]
    assert overview.unknown_fields(load(trial("nG", 5))) == {}


def test_a_field_that_is_nearly_a_known_one_is_asked_about():
    made = trial("nG", 5, selfColision={}, windvelkeys={}, wind=3, colliders=[{**sphere(), "posKey": {}, "colour": 1}])
    made["objects"][0] |= {"vertNormals": [], "pins": [], "warpp": 0}
    made["windVelKeys"] = {"times": [0], "values": [{"x": 0, "y": 0, "z": 0}], "interpolatoin": "hold"}
    assert overview.misspelt_fields(load(made)) == [
        f"{where}: the program knows no such field, and keeps it; did you mean {meant}?" for where, meant in (
            ("colliders[0].posKey", "posKeys"), ("objects[0].warpp", "warp"), ("selfColision", "selfCollision"),
            ("windVelKeys.interpolatoin", "interpolation"),
        )
    ]  # fmt: skip
    del made["windVelKeys"]
    assert any("windvelkeys: " in each for each in overview.misspelt_fields(load(made)))
