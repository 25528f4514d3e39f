"""Values for other tools (tables, Obi, Vellum): what is written reads back, and means there what it means here."""

import csv
import io
import json

import numpy as np
import pytest
from helpers.exports import ROUNDING, built, content, of, two
from helpers.scenes import cloth, trial, write_scene

from clothfit import InvalidInput, mesh
from clothfit.cli.program import run
from clothfit.export.tools import PATHS, TOOLS, exported
from clothfit.export.topology import roles
from clothfit.pictures.camera import normals

SMALL = trial("nG", 5)
VALUES = [tool for tool in TOOLS if tool not in PATHS]


@pytest.fixture(scope="module")
def scene():
    """Two objects, the first with bending springs."""
    return two()


# --- which spring is what


@pytest.mark.parametrize("divisions", [0, 1, 4])
def test_springs_are_told_apart_as_the_front_end_made_them_and_bending_ones_go_across_their_hinges(divisions):
    found, known = of(built(divisions)).cloths[0], mesh.springs(mesh.plane(divisions, 1.0), 50.0).bends
    role = roles(found)
    assert (role.bending == known).all()
    assert (role.traction == ~known).all()
    faces = {frozenset(face) for face in found.triangles.tolist()}
    pairs = zip(found.springs[role.bending].tolist(), role.hinges[role.bending].tolist(), strict=True)
    assert all({frozenset((*hinge, end)) for end in ends} <= faces for ends, hinge in pairs)
    assert (role.hinges[role.traction] == np.sort(found.springs[role.traction], axis=1)).all()


def test_without_faces_nothing_is_told_apart_and_a_spring_between_far_vertices_is_neither():
    bare, far = of(cloth(3, 3, triangles=[]), cloth(4, 4, springs=[0, 15, 0, 1], springStiffness=[1, 2])).cloths
    assert set(roles(bare).names) == {"other"}
    assert roles(far).names == ["other", "traction"]


# --- tables


def test_the_tables_hold_every_number_as_it_is(scene):
    made = exported(scene, "csv")
    tables = {name: list(csv.DictReader(io.StringIO(data.decode()))) for name, data in made.items()}
    for number, found in enumerate(scene.cloths):
        objects, vertices, springs = (
            {key: [row[key] for row in table if row["object"] == str(number)] for key in table[0]}
            for table in tables.values()
        )
        assert (objects["vertices"], objects["springs"]) == ([str(len(found.mass))], [str(len(found.springs))])
        columns = [vertices[key] for key in ("mass", "x", "y", "z", "fixed", "vertex")]
        columns += [springs[key] for key in ("a", "b", "stiffness", "rest_length")]
        own = [found.mass, *found.positions.T, found.fixed, range(len(found.mass)), *found.springs.T, found.stiffness,
               found.rest]  # fmt: skip
        assert [[float(value) for value in column] for column in columns] == [list(values) for values in own]
        assert springs["kind"] == roles(found).names
        assert np.array(springs["damping"], float) == pytest.approx(0.05 * found.stiffness, rel=ROUNDING)


# --- Obi


def test_every_spring_is_one_constraint_of_obi_with_the_inverse_of_its_stiffness(scene):
    for found, values in zip(scene.cloths, content(scene, "obi", "obi.json")["objects"], strict=True):
        springs = values["distance"]["spring"] + values["bend"]["spring"]
        assert sorted(springs) == list(range(len(found.springs)))
        compliance = np.array(values["distance"]["compliance"] + values["bend"]["compliance"])
        assert 1 / compliance == pytest.approx(found.stiffness[springs], rel=ROUNDING)
        assert values["distance"]["particles"] + values["bend"]["particles"] == found.springs[springs].tolist()
        assert values["distance"]["restLength"] + values["bend"]["restLength"] == found.rest[springs].tolist()
        # particles carry their masses, and fixed ones cannot move
        assert values["particles"]["mass"] == found.mass.tolist()
        inverse = np.array(values["particles"]["inverseMass"])
        assert (inverse[found.fixed] == 0).all()
        assert 1 / inverse[~found.fixed] == pytest.approx(found.mass[~found.fixed], rel=ROUNDING)


def test_an_actor_of_obi_has_the_compliance_of_the_mean_stiffness(scene):
    found, (first, second) = scene.cloths[0], content(scene, "obi", "obi.json")["objects"]
    for name, chosen in (("bendCompliance", roles(found).bending), ("stretchCompliance", ~roles(found).bending)):
        assert 1 / first["actor"][name] == pytest.approx(found.stiffness[chosen].mean(), rel=ROUNDING)
    assert second["actor"]["bendCompliance"] is None
    weak = of(cloth(2, 2, springStiffness=[0, 1, 2, 3, 4]))
    assert content(weak, "obi", "obi.json")["objects"][0]["distance"]["compliance"][0] is None


# --- all of them


@pytest.mark.parametrize("tool", VALUES)
def test_the_same_scene_gives_the_same_bytes_and_odd_objects_are_written_too(scene, tool):
    assert exported(scene, tool) == exported(scene, tool)
    lone = cloth(2, 2, springs=[], springStiffness=[], triangles=[])
    held = cloth(2, 2, vertIsFixed=[True] * 4, damping=0, springStiffness=[0.0] * 5)
    made = exported(of(lone, held), tool)
    assert all(data for data in made.values())
    assert all(b"NaN" not in data and b"Infinity" not in data for data in made.values())


@pytest.mark.parametrize("tool", VALUES)
def test_the_command_writes_a_folder_and_says_so(folder, capsys, tool):
    assert run(["export", "scene.json", "--to", tool, "--json"]) == 0
    out, err = capsys.readouterr()
    values = json.loads(out)
    assert (values["to"], values["output"]) == (tool, f"scene-{tool}")
    assert sorted(values["files"]) == sorted(path.name for path in (folder / values["output"]).iterdir())
    assert "\nscene.json: 1 object, 16 vertices, 33 springs → scene-" in f"\n{err}"
    assert values["objects"][0]["springs"] == {"traction": 33, "bending": 0, "other": 0}


def test_the_scene_itself_is_never_written_over_and_an_unknown_tool_is_refused(folder, capsys):
    text = (folder / "scene.json").rename("obi.json").read_bytes()
    for options, message in (
        (["obi", "-o", "."], "it is an input, which is never written over"),
        (["maya"], "'maya' is not one of 'csv', 'obi', 'blender', 'vellum', 'gltf', 'usd'"),
    ):
        assert run(["export", "obi.json", "--to", *options]) == 3
        assert message in capsys.readouterr().err
    assert (folder / "obi.json").read_bytes() == text


@pytest.mark.parametrize(
    ("method", "tool", "count"), [(2, "blender", 0), (3, "blender", 1), (3, "obi", 1), (3, "csv", 0)]
)
def test_a_step_that_the_tool_does_not_have_is_warned_of(tmp_path, capsys, method, tool, count):
    path = write_scene(tmp_path, {**SMALL, "integrationMethod": method})
    assert run(["export", path, "--to", tool, "-o", str(tmp_path / "made")]) == 0
    assert capsys.readouterr().err.count(f"which {tool} does not have") == count


POINTS, PRIMITIVES = "pointattributes", "primitiveattributes"


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


def test_the_constraints_of_vellum_are_the_springs_and_its_mesh_is_right_handed(scene):
    made, mirror = exported(scene, "vellum"), np.array([1.0, 1.0, -1.0])
    for number, (found, means) in enumerate(zip(scene.cloths, json.loads(made["vellum.json"])["objects"], strict=True)):
        mean, mantissa, exponent = (means["traction"][name] for name in ("mean", "mantissa", "exponent"))
        assert 1 <= mantissa < 10
        assert mantissa * 10.0**exponent == pytest.approx(mean, rel=ROUNDING)
        count, kind, ends, held = geometry(made[f"object{number}.constraints.geo"])
        assert (count, kind) == (len(found.mass), "PolygonCurve_run")
        assert (ends == found.springs).all()
        assert [held[PRIMITIVES, name] for name in ("stiffness", "restlength", "role", "type")] == [
            found.stiffness.tolist(), found.rest.tolist(), roles(found).names, ["distance"] * len(ends)
        ]  # fmt: skip
        assert (np.array(held[POINTS, "mass"]) == np.where(found.fixed, 0, found.mass)).all()
        count, kind, corners, held = geometry(made[f"object{number}.cloth.geo"])
        assert (count, kind) == (len(found.mass), "Polygon_run")
        points = np.array(held[POINTS, "P"])
        assert (points * mirror == found.positions).all()
        assert (np.array(held[POINTS, "v"]) * mirror == found.velocity).all()
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


def test_a_value_that_overflows_in_the_tools_terms_is_refused():
    """A mass of 1e-200 kg on a spring of 1e200 N/m: the damping ratio is the root of 1e400."""
    made = of(cloth(2, 2, vertMass=[1e-200] * 4, springStiffness=[1e200] * 5, damping=1e250))
    with pytest.raises(InvalidInput, match=r"vellum cannot have the scene: a value in its terms is infinite"):
        exported(made, "vellum")
    assert exported(made, "obi")  # which takes what there is
    assert exported(made, "blender")
