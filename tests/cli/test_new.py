"""`clothfit new`: what each option does to the scene, what is told, what is refused."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.paths import DOCS
from helpers.scenes import names

from clothfit import load, mesh, read_mesh
from clothfit.cli.program import group, run
from clothfit.scene.mesh_numbering import numberings

pytestmark = pytest.mark.slow  # starts processes

KEYS = {"schema_version", "command", "scene", "vertices", "triangles", "springs", "size", "mass", "fixed", "renumbered",
        "problems", "families", "regions", "output"}  # fmt: skip


def made(options, name="plane.json"):
    """The scene that the command writes."""
    assert run(["new", *shlex.split(options), "-q"]) == 0
    return load(name)


def torn_box(path="box.obj"):
    """A cube of 1 m as a tool writes it that gives each face corners of its own: 12 triangles, 36 vertices."""
    solid = trimesh.creation.box()
    points = solid.vertices[solid.faces.reshape(-1)]
    faces = np.arange(1, 37).reshape(-1, 3)
    rows = [f"v {x} {y} {z}" for x, y, z in points] + ["f {} {} {}".format(*face) for face in faces]
    Path(path).write_text("\n".join(rows))
    return points * [-1, 1, 1]


def test_a_plane_by_default(said):
    code, out, err = said("new plane")
    assert (code, out) == (0, "")
    assert err.splitlines() == [
        "fixed: none, so it falls",
        "plane: 144 vertices, 242 triangles, 726 springs, 1 × 0 × 1 m, 0.2 kg, 100 frames of 0.02 s → plane.json",
    ]
    scene = load("plane.json")
    (cloth,) = scene.cloths
    sheet, springs = mesh.plane(10, 1.0), mesh.springs(mesh.plane(10, 1.0), 50.0)
    for own, expected in ((cloth.positions, sheet.positions), (cloth.springs, springs.ends),
                          (cloth.stiffness, springs.stiffness)):  # fmt: skip
        np.testing.assert_array_equal(own, expected)
    assert (cloth.settings, cloth.damping, cloth.drag, scene.method, scene.tolerance) == ("nF", 0.1, 0.1, 3, 1e-8)


def test_the_options_of_a_plane_and_of_springs():
    (cloth,) = made("plane --size 2x1 --divisions 3 --upright --density 0.5").cloths
    np.testing.assert_array_equal(cloth.positions, mesh.plane(3, 2.0, 1.0, upright=True).positions)
    assert cloth.mass.sum() == pytest.approx(1.0, rel=1e-13)  # kg, 0.5 kg/m² of 2 m²
    (cloth,) = made("plane --stiffness 80 --bending 0.5 --damping 0.3 --drag 2").cloths
    np.testing.assert_array_equal(cloth.stiffness, mesh.springs(mesh.plane(10, 1.0), 80.0, 0.5).stiffness)
    assert (cloth.damping, cloth.drag) == (0.3, 2.0)
    assert len(made("plane --no-bending").cloths[0].springs) == len(mesh.edges(mesh.plane(10, 1.0).triangles))


def test_the_drag_of_air_goes_with_the_wind():
    (still,), (windy,) = (made(f"plane --drag air {wind}").cloths for wind in ("", "--wind 0,3,4"))
    assert windy.drag == pytest.approx(5 * still.drag, rel=1e-14)
    assert still.drag == pytest.approx(1.2 / (8 * (1 / 242) ** 2), rel=1e-9)  # faces of 1/242 m²
    drags = [made(f"plane --fit wind {given}").cloths[0].drag for given in ("", "--drag air", "--drag 2")]
    assert drags == pytest.approx([5 * still.drag, 5 * still.drag, 2.0], rel=1e-14)  # a wind to be found is of 5 m/s
    assert made("plane --fit damping").cloths[0].drag == 0.1


@pytest.mark.parametrize(
    ("options", "drag", "fits"),
    [("", 1.2, {}), ("--drag air --wind 0,3,4", 1.2, {}), ("--drag 0.5", 0.5, {}), ("--fit wind", 1.2, {"drag": "G"}),
     ("--fit wind --drag 2", 2.0, {})],
)  # fmt: skip
def test_in_the_law_air_the_drag_is_that_of_a_plate(options, drag, fits):
    (cloth,) = made(f"plane --drag-law air {options}").cloths
    assert (cloth.drag_law, cloth.drag, cloth.fits) == ("air", drag, fits)


def test_the_options_of_a_scene():
    scene = made("plane --sphere 0,-1,0,0.5 --sphere 1,-1,0,0.25 --wind -1,0,2 --integrator symplectic --fps 500 "
                 "--frames 30 --tolerance 1e-6 --title 'my cloth' -o x.txt", name="x.txt")  # fmt: skip
    assert [(*each.centre, each.radius) for each in scene.spheres] == [(0, -1, 0, 0.5), (1, -1, 0, 0.25)]
    assert scene.wind.tolist() == [-1, 0, 2]
    assert (scene.method, scene.delta, scene.frames, scene.tolerance) == (1, 0.002, 30, 1e-6)
    assert scene.title == "my cloth"
    assert made("plane --delta 0.01").delta == 0.01


@pytest.mark.parametrize(
    ("options", "settings", "fits"),
    [("", "nF", {}), ("--fit Ln", "Ln", {}), ("--fit wind", "nn", {"drag": "G"}), ("--fit wind --drag 50", "nn", {}),
     ("--fit wind --fit drag", "nn", {"drag": "G"}),
     ("--fit gl --fit damping --fit rest=l", "GL", {"damping": "G", "rest": "L"})],
)  # fmt: skip
def test_what_to_fit(options, settings, fits):
    scene = made(f"plane {options}")
    assert (scene.cloths[0].settings, scene.cloths[0].fits) == (settings, fits)
    assert scene.fits == ({"wind": "G"} if "wind" in options else {})


@pytest.mark.parametrize(
    ("options", "expected", "named"),
    [("--fix-vertices '0,3-5, 9'", [0, 3, 4, 5, 9], "0, 3-5, 9"),
     ("--fix-side left --fix-side back", [0, 1, 2, 3, 4, 8, 12], "0-4, 8, 12"),
     ("--fix-side front=0.34", [*range(8, 16)], "8-15"), ("--fix-vertices 5,6,14,15", [5, 6, 14, 15], "5, 6, 14, 15"),
     ("--fix-box -1,-1,-1:-0.4,1,-0.4 --fix-box 0.4,0,0.4:1,1,1", [0, 15], "0, 15")],
)  # fmt: skip
def test_what_is_held_and_told(options, expected, named, said):
    code, _, err = said(f"new plane --divisions 2 {options}")
    assert (code, f"fixed: {len(expected)} vertices ({named})" in err.splitlines()) == (0, True)
    assert np.flatnonzero(load("plane.json").cloths[0].fixed).tolist() == expected


def test_it_is_turned_then_moved_then_held():
    turned = made("plane --divisions 1 --rotate 90,0,0 --move 0,2,1 --fix-side top")
    (cloth,) = turned.cloths
    # about x, y goes to z and z to -y: the row at the back is the top
    assert np.flatnonzero(cloth.fixed).tolist() == [0, 1, 2]
    np.testing.assert_allclose(cloth.positions[0], [-0.5, 2.5, 1.0], atol=1e-15)


def test_a_scene_goes_into_the_working_folder_with_the_files_numbers():
    sheet = mesh.plane(3, 1.0)
    Path("sub").mkdir()
    shape = trimesh.Trimesh(sheet.positions * [-1, 1, 1], sheet.triangles[:, ::-1], process=False)
    shape.export("sub/cloth.ply", vertex_normal=False)
    scene = made("sub/cloth.ply --scale 2 --fix-vertices 0", name="cloth.json")
    (cloth,) = scene.cloths
    np.testing.assert_allclose(cloth.positions, 2 * sheet.positions, atol=2e-7)  # single precision
    np.testing.assert_array_equal(cloth.triangles, sheet.triangles)
    np.testing.assert_array_equal(cloth.springs, mesh.springs(sheet, 1.0).ends)
    assert (np.flatnonzero(cloth.fixed).tolist(), scene.title) == ([0], "cloth")


def test_a_sequence_gives_its_first_frame(said):
    torn_box("shot_0007.obj")
    torn_box("shot_0008.obj")
    assert "→ shot.json" in said("new 'shot_*.obj'")[2]
    assert len(load("shot.json").cloths[0].mass) == 36


def test_a_sequence_is_a_shot_with_its_frames_and_what_keeps_still_in_it(said, summary):
    """Frame 3 is missing: it counts, as it does in a target; a scan has neither frames nor vertices that keep still."""
    sheet = mesh.plane(3, 1.0)
    faces = "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in sheet.triangles.tolist())
    for frame in (0, 1, 2, 4, 5):
        moved = sheet.positions + 0.01 * frame * np.sin(np.arange(75)).reshape(25, 3) * (np.arange(25) >= 5)[:, None]
        text = "".join(f"v {x} {y} {z}\n" for x, y, z in moved.tolist())
        Path(f"shot_{frame}.obj").write_text(text + faces)
        Path(f"scan_{frame}.obj").write_text("v 0 0 0\n" * frame + text + (faces if not frame else ""))
    scene = made("'shot_*.obj' --fps 24", name="shot.json")
    assert (np.flatnonzero(scene.cloths[0].fixed).tolist(), scene.frames) == ([0, 1, 2, 3, 4], 6)
    assert np.flatnonzero(made("'shot_*.obj' --fix-vertices 20", name="shot.json").cloths[0].fixed).tolist() == [20]
    (own,) = summary("info 'shot_*.obj'")["meshes"]
    assert (own["frames"], own["held"]) == (6, [{"vertices": "0-4", "moves": False}])
    assert "25 vertices, 32 faces, 6 frames, moves, held? 0-4 (still)" in said("info 'shot_*.obj'")[1]
    scene = made("'scan_*.obj'", name="scan.json")
    assert (scene.cloths[0].fixed.any(), scene.frames, summary("info 'scan_*.obj'")["meshes"]) == (False, 100, [])


# --- problems and welding


def test_seams_are_told_and_the_scene_is_made(told):
    torn_box()
    summary, err = told("new box.obj")
    assert set(summary) == KEYS
    assert [(each["kind"], each["count"]) for each in summary["problems"]] == [("parts", 12), ("seam", 28)]
    assert "warning: box.obj: 28 vertices are at the place of another" in err
    assert "--weld joins them" in err


@pytest.mark.parametrize("options", ["box.obj --weld", "--weld box.obj", "box.obj --weld 1e-3"])
def test_welding_gives_the_cube_its_8_vertices_and_keeps_the_meshs_numbers(options, summary):
    points = torn_box()
    found = summary(f"new {options} --fix-vertices 35 --region first=0-3")
    assert (found["vertices"], found["problems"], found["renumbered"]) == (8, [], True)
    scene = load("box.json")
    (numbering,) = numberings(scene)
    np.testing.assert_array_equal(scene.cloths[0].positions[numbering], points)
    assert np.flatnonzero(scene.cloths[0].fixed).tolist() == [numbering[35]] == found["fixed"]
    assert scene.cloths[0].layout.regions[0].vertices.tolist() == sorted(set(numbering[:4].tolist()))
    assert scene.cloths[0].mass.sum() == pytest.approx(0.2 * 6, rel=1e-12)  # six faces of 1 m²


def test_a_mesh_that_needs_no_welding_stays_as_it_is():
    found = mesh.plane(2, 1.0)
    trimesh.Trimesh(found.positions, found.triangles, process=False).export("p.obj")
    scene = made("p.obj --weld", name="p.json")
    assert "meshVertices" not in scene.source.text
    np.testing.assert_array_equal(scene.cloths[0].positions, read_mesh("p.obj")[0].positions)


def test_a_mesh_of_which_no_cloth_can_be_made_is_refused_with_all_that_is_wrong(said):
    Path("bad.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 9 9 9\nf 1 2 3\nf 1 2 2\nf 3 2 1\n")
    code, _, text = said("new bad.obj")
    err = text.splitlines()
    assert err[-1].startswith("error: bad.obj: no cloth can be made of this mesh: 1 vertex is in no triangle (3)")
    assert err[-1].endswith("; --weld removes them (and 2 more problems)")
    assert [line.split(": ")[1][:20] for line in err[-3:-1]] == ["1 triangle names a v", "1 triangle has the c"]
    assert (code, names()) == (3, ["bad.obj"])
    assert len(made("bad.obj --weld", name="bad.json").cloths[0].mass) == 3


# --- where it goes


def test_a_file_that_is_there_is_replaced_and_steps_that_will_not_stay_stable_are_told(said):
    Path("plane.json").write_text("old")
    code, _, err = said("new plane --integrator explicit")
    assert (code, "will not stay stable" in err) == (0, True)
    assert load("plane.json").method == 0


PAGE = (DOCS / "new.md").read_text("utf-8")


def test_the_page_of_the_command_names_every_option():
    common = {"--help-all", "--json", "--quiet", "--verbose", "--version", "--output", "--set"}
    made = group.get_command(None, "new")
    options = {name for option in made.params for name in option.opts if name[:2] == "--"}
    assert {name for name in options - common if f"`{name}" not in PAGE} == set()
    assert {name for name in made.settings if f"`--set {name}=" not in PAGE} == set()


def test_what_the_page_shows_runs(said):
    lines = [line for line in PAGE.splitlines() if line.startswith("clothfit new plane")]
    assert len(lines) == 4
    for line in lines:
        assert said(line.partition(" ")[2].partition("#")[0])[0] == 0


def test_regions_and_the_warp_are_written_and_said(said, told):
    """By a side, by numbers twice and by a box; the scene's own order of families, counts by hand."""
    places = ["hem=front=0.2", "patch=0-3", "patch=12", "corner=-1,-1,-1:-0.45,0,-0.45"]
    found, err = told(f"new plane --warp z {' '.join(f'--region {each}' for each in places)}")
    counts = {name: own["vertices"] for name, own in found["regions"].items()}
    assert counts == {"hem": 36, "patch": 5, "elsewhere": 103}
    assert list(found["families"].values()) == [132, 132, 121, 110, 110, 121]
    assert "regions: hem (36 vertices, 132 springs), patch (5 vertices, 5 springs)" in err
    own = load("plane.json").cloths[0].layout
    assert [region.name for region in own.regions] == ["hem", "patch", "corner"]
    assert own.warp.tolist() == [0.0, 0.0, 1.0]
    assert "objects[0]: regions: hem (36 vertices, 132 springs)" in said("info plane.json")[1]


def test_the_page_names_every_problem():
    import clothfit.meshes.problems as found

    source = Path(found.__file__).read_text("utf-8")
    kinds = set(re.findall(r'Problem\("([\w-]+)"|_problem\("([\w-]+)"', source))
    assert {a or b for a, b in kinds} == {"unused", "collapsed", "flat", "massless", "repeated", "non-manifold",
                                          "no-length", "orientation", "parts", "seam", "empty"}  # fmt: skip
    assert all(f"`{a or b}`" in PAGE for a, b in kinds)


@pytest.mark.parametrize(("option", "thickness"), [("--layers", 0.005), ("--layers 0.01", 0.01)])
def test_layers_touch_themselves_and_each_other(here, said, option, thickness):
    assert said(f"new plane {option} -o layers.json")[0] == 0
    law = load("layers.json").self_contact
    assert (law.thickness, law.between) == (thickness, True)


@pytest.mark.parametrize(("kind", "held"), [("drape", 61), ("cantilever", 9), ("strip", 3)])
def test_specimens_are_at_rest_and_show_their_fabric(kind, held, capsys):
    """A specimen is held as in its test, and a fit of a shape of its own finds what it was made with."""
    own = made(f"{kind} --fabric denim --divisions 12", f"{kind}.json")
    assert (own.method, own.frames, int(own.cloths[0].fixed.sum())) == (4, 2, held)
    assert run(["target", f"{kind}.json", "-o", f"{kind}.target.npz", "-q"]) == 0
    assert run(["estimate", f"{kind}.json", "--target", f"{kind}.target.npz", "-q"]) == 0
    assert load(f"{kind}.fitted.json").cloths[0].stiffness == pytest.approx(own.cloths[0].stiffness, rel=1e-6)


def test_shadows_of_a_drape_are_targets(capsys):
    made("drape --fabric denim --divisions 8", "drape.json")
    Path("round.csv").write_text("".join(f"{0.12 * np.cos(a)},{0.12 * np.sin(a)}\n" for a in np.arange(0, 6.28, 0.1)))
    assert run(["new", "drape", "--size", "0.3"]) == 3
    assert "0.3x0.18" in capsys.readouterr().err
    for target, error in (("coefficient=250%", "between 0 and 1"), ("coefficient=much", "is a number"),
                          ("outline=drape.json", "is no outline")):  # fmt: skip
        assert run(["estimate", "drape.json", "--target", target]) == 3
        assert error in capsys.readouterr().err
    assert run(["estimate", "drape.json", "--target", "coefficient=50%", "--target", "outline=round.csv"]) == 3
    assert run(["estimate", "drape.json", "--target", "coefficient=50%", "--report", "drape.html"]) == 2
    for target in ("coefficient=50%", "outline=round.csv"):
        assert run(["estimate", "drape.json", "--target", target, "--max-evaluations", "3", "-q"]) in (0, 5)
