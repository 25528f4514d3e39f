"""The fields `families`, `regions` and `warp` of an object: what they do to the groups, and what is refused."""

import io
import json

import numpy as np
import pytest
from helpers.scenes import changed, cloth, document, load_text, problems
from scipy.spatial import Delaunay

from clothfit.meshes.mesh import Mesh, plane
from clothfit.meshes.new_scene import new_scene
from clothfit.scene.families import families_of, spring_groups, vertex_groups
from clothfit.scene.scene import dumps, load

GRID = cloth(4, 3)
SPRINGS = len(GRID["springStiffness"])
ZERO = [0] * SPRINGS


def groups(**fields):
    (own,) = load_text(json.dumps(document({**GRID, **fields}))).cloths
    return spring_groups(own), vertex_groups(own)


def counts(found):
    return dict(zip(found.names, np.bincount(found.of).tolist(), strict=True))


def test_given_families_replace_those_of_the_mesh_and_empty_ones_are_left_out():
    given = {"names": ["yarn", "nothing", "fold"], "springs": [0, 2] + [0] * (SPRINGS - 2)}
    springs, _ = groups(families=given, warp={"x": 1, "y": 0, "z": 0})
    assert counts(springs) == {"yarn": SPRINGS - 1, "fold": 1}


def test_a_spring_lies_in_the_first_region_with_both_its_ends_and_a_vertex_in_the_first_that_has_it():
    """Two columns of two cells each share a column of vertices; what lies in neither is elsewhere."""
    columns = [[4 * j + i for j in range(3)] for i in range(4)]
    left, right = columns[0] + columns[1], columns[1] + columns[2]
    springs, vertices = groups(regions=[{"name": "left", "vertices": left}, {"name": "right", "vertices": right}])
    assert counts(vertices) == {"left": 6, "right": 3, "elsewhere": 3}
    assert counts(springs) == {
        "edges along, left": 3, "edges along, right": 3, "edges along, elsewhere": 3,
        "edges across, left": 4, "edges across, right": 2, "edges across, elsewhere": 2,
        "edges diagonal, left": 2, "edges diagonal, right": 2, "edges diagonal, elsewhere": 2,
    }  # fmt: skip


@pytest.mark.parametrize(("axis", "along"), [("x", 9), ("z", 8)])
def test_the_warp_says_which_direction_of_a_grid_is_along(axis, along):
    springs, _ = groups(warp={"x": 0, "y": 0, "z": 0, axis: -3})
    assert counts(springs)["edges along"] == along


def test_without_a_grid_the_angle_with_the_warp_decides():
    """The angles are those with a direction that is turned with the mesh; 22.5° and 67.5° are the borders."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.random((200, 2)), np.zeros(200)])
    triangles = Delaunay(points[:, :2]).simplices.astype(np.int32)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    made = new_scene(Mesh(points, triangles), bending=False).cloths[0]
    warp = np.broadcast_to(turn[0], triangles.shape)
    family = families_of(points @ turn, triangles, made.springs, warp)
    e = points[made.springs[:, 1]] - points[made.springs[:, 0]]
    angle = np.degrees(np.arctan2(np.abs(e[:, 1]), np.abs(e[:, 0])))
    assert (family == np.select([angle < 22.5, angle > 67.5], [0, 1], 2)).all()


def test_a_warp_across_the_cloth_says_nothing():
    springs, _ = groups(warp={"x": 0, "y": 1, "z": 0})
    assert springs.names == groups()[0].names


def test_a_warp_along_the_diagonals_of_the_cells_is_followed():
    made = new_scene(plane(5, 1.0), bending=False).cloths[0]
    warp = np.broadcast_to([1.0, 0.0, 1.0], made.triangles.shape)
    family = families_of(made.positions, made.triangles, made.springs, warp)
    assert np.bincount(family).tolist() == [36, 0, 84]


def test_a_motion_has_nothing_to_do_with_the_fields():
    """And other values keep the groups: they are found once."""
    scene = load_text(json.dumps(document({**GRID, "regions": [{"name": "all", "vertices": [0, 1]}]})))
    other = scene.with_values([2 * scene.cloths[0].mass], [2 * scene.cloths[0].stiffness])
    assert spring_groups(other.cloths[0]) is spring_groups(scene.cloths[0])


def test_the_fields_survive_a_round_trip():
    fields = {
        "families": {"names": ["a"], "springs": ZERO, "by": "hand"},
        "regions": [{"name": "edge", "vertices": [3, 1, 1], "colour": "red"}],
        "warp": {"x": 0.50, "y": 0, "z": 1e0},
    }
    text = json.dumps(document({**GRID, **fields}), indent=1)
    scene = load(io.StringIO(text))
    assert dumps(scene).decode() == text
    changed_scene = scene.with_values([scene.cloths[0].mass * 2], [scene.cloths[0].stiffness])
    kept = json.loads(dumps(changed_scene))["objects"][0]
    assert {name: kept[name] for name in fields} == fields


@pytest.mark.parametrize(
    ("field", "value", "place", "word"),
    [
        ("families", [], "families", "a list is not an object"),
        ("families", {"names": ["a"]}, "families.springs", "is missing"),
        ("families", {"names": ["a"], "springs": 3}, "families.springs", "3 is not a list"),
        ("families", {"names": ["a"], "springs": [0]}, "families.springs", f"1 value for {SPRINGS} springs"),
        ("families", {"names": ["a"], "springs": [*ZERO[1:], 1]}, f"families.springs[{SPRINGS - 1}]", "family 1 does"),
        ("families", {"names": ["a"], "springs": [*ZERO[1:], -1]}, f"families.springs[{SPRINGS - 1}]", "1 name"),
        ("families", {"names": ["a"], "springs": [0.0, *ZERO[1:]]}, "families.springs[0]", "0.0 is not an index"),
        ("families", {"names": ["a", "a"], "springs": ZERO}, "families.names[1]", '"a" is there already'),
        ("families", {"names": [" "], "springs": ZERO}, "families.names[0]", "is empty"),
        ("families", {"names": [5], "springs": ZERO}, "families.names[0]", "5 is not text"),
        ("regions", {}, "regions", "an object is not a list"),
        ("regions", [{"name": "a"}], "regions[0].vertices", "is missing"),
        ("regions", [{"name": "a", "vertices": [0, 12]}], "regions[0].vertices[1]", "vertex 12 does not exist"),
        ("regions", [{"name": "a", "vertices": [10**30]}], "regions[0].vertices[0]", "does not exist"),
        ("regions", [{"name": "a", "vertices": ["1"]}], "regions[0].vertices[0]", '"1" is not an index'),
        ("regions", [{"name": "a", "vertices": [0]}] * 2, "regions[1].name", "there already"),
        ("regions", [{"name": "elsewhere", "vertices": [0]}], "regions[0].name", "in no region"),
        ("warp", {"x": 0, "y": 0, "z": 0}, "warp", "no length"),
        ("warp", {"x": 0, "y": 0}, "warp.z", "missing"),
        ("warp", "x", "warp", '"x" is not an object'),
    ],
)  # fmt: skip
def test_a_broken_field_gives_one_problem_with_its_place(field, value, place, word):
    (found,) = problems(changed(document(GRID), ("objects", 0, field), value))
    assert found.startswith(f"objects[0].{place}: ")
    assert word in found
