"""Files that are recognised: what `info` prints of them, and which option or command takes them."""

import json

import numpy as np
import pytest
from helpers.scenes import even, write_scene

from clothfit.base.checkpoint import encoded
from clothfit.cli.program import run
from clothfit.export.tools import exported
from clothfit.formats.registry import kind_of
from clothfit.motion.files import save_motion
from clothfit.motion.motion import Motion
from clothfit.scene.scene import load

SCENE_PLACES = ["simulate", "target", "estimate", "evaluate", "validate", "report", "check", "export"]


@pytest.fixture
def files(tmp_path, monkeypatch, capsys):
    """A file of each kind, made without a simulation, in the current folder."""
    monkeypatch.chdir(tmp_path)
    scene = load(write_scene(tmp_path, even("nG", 5, 3, 3)))
    start = scene.cloths[0].positions
    times = 0.02 * np.arange(4)
    x = start + np.array([0.0, -1.0, 0.0]) * times[:, None, None]
    observed = np.ones(x.shape[:2], bool)
    observed[1:, 2] = False
    save_motion(Motion(x, times, (9,)), "curtain.pc2", scene)
    save_motion(Motion(x, times, (9,)), "flag.glb", scene)
    save_motion(Motion(x, times, (9,), observed), "seen.npz", scene)
    (tmp_path / "quad.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 0 1\nv 1 0 1\nf 1 2 4 3\n")
    (tmp_path / "fit.jsonl").write_text(
        '{"iteration": 0, "evaluations": 1, "seconds": 0.1, "cost": 1.0, "rmse": 0.5}\n'
        '{"summary": {"status": "converged", "rmse": 0.25, "scene": "scene.json"}}\n'
    )
    (tmp_path / "page.html").write_text("<!doctype html><title>fit</title>")
    for name, content in exported(scene, "blender").items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "map.csv").write_text("marker,object,vertex\nm1,0,3\n")
    (tmp_path / "f.checkpoint").write_bytes(encoded("fit", {}, {}))
    capsys.readouterr()


KINDS = {"scene.json": "scene", "curtain.pc2": "motion", "seen.npz": "motion", "flag.glb": "mesh or motion",
         "quad.obj": "mesh", "fit.jsonl": "log", "page.html": "page", "map.csv": "map", "f.checkpoint": "checkpoint",
         "blender.json": "export", "blender.py": "export",
         "a_*.obj": "mesh or motion", "absent.json": None, ".": None}  # fmt: skip


@pytest.mark.usefixtures("files")
def test_a_file_is_known_by_its_content_and_its_name():
    assert {name: kind_of(name) for name in KINDS} == KINDS


@pytest.mark.usefixtures("files")
def test_info_of_a_motion_with_gaps(capsys):
    assert run(["info", "seen.npz", "--json", "-q"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["kind"], found["frames"], found["points"], found["timed"]) == ("motion", 4, 9, True)
    assert found["fps"] == pytest.approx(50.0, rel=1e-12)
    assert found["observed"] == pytest.approx(1 - 3 / 36, rel=1e-12)
    assert found["never_observed"] == 0
    assert found["last"]["time"] == pytest.approx(0.06, rel=1e-12)
    assert (found["first"]["observed"], found["last"]["observed"]) == (9, 8)
    # the root mean square of 0, 0.02, 0.04, 0.06 m over 9 points in the first frame and 8 in each of the others
    assert found["travel"] == pytest.approx(np.sqrt(8 * (0.02**2 + 0.04**2 + 0.06**2) / 33), rel=1e-9)
    assert run(["info", "seen.npz"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "4, 50 a second, 0.06 s" in out
    assert "8.33 % of the positions" in out


@pytest.mark.usefixtures("files")
def test_info_of_what_has_no_times_says_so(capsys):
    assert run(["info", "curtain.pc2"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("curtain.pc2: motion\nformat         PC2 point cache\nframes         4, no times (--fps)\n")
    assert "right-handed, 1 m per unit" in out


@pytest.mark.usefixtures("files")
def test_info_of_a_mesh_a_log_and_what_can_be_both(capsys):
    for name, told in (("quad.obj", "triangles      2"), ("flag.glb", "frames         4"),
                       ("fit.jsonl", "converged, RMSE 250 mm")):  # fmt: skip
        assert run(["info", name]) == 0
        assert told in capsys.readouterr().out
    assert run(["info", "quad.obj", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["kind"], found["vertices"], found["size"]) == ("mesh", 4, [1.0, 0.0, 1.0])


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize("command", SCENE_PLACES)
@pytest.mark.parametrize("name", ["curtain.pc2", "seen.npz", "flag.glb", "quad.obj", "fit.jsonl", "f.checkpoint"])
def test_no_command_takes_another_file_for_a_scene(capsys, command, name):
    more = {"evaluate": ["scene.json"], "report": ["scene.json"], "export": ["--to", "csv"]}
    assert run([command, name, *more.get(command, [])]) == 3
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith(f"error: {name} is a {KINDS[name]}; did you mean ")


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["estimate", "scene.json", "curtain.pc2"], "curtain.pc2 is a motion; did you mean --target?"),
        (["estimate", "scene.json", "--target", "map.csv"], "map.csv is a map; did you mean --map?"),
        (["estimate", "scene.json", "--target", "scene.json"], "scene.json is a scene; did you mean SCENE"),
        (["estimate", "scene.json", "--target", "f.checkpoint"], "f.checkpoint is a checkpoint; did you mean --check"),
        (["report", "scene.json", "scene.json", "--log", "curtain.pc2"], "curtain.pc2 is a motion; "),
        (["new", "curtain.pc2"], "curtain.pc2 is a motion; it has no faces; did you mean estimate --target?"),
        (["new", "scene.json"], "scene.json is a scene; did you mean clothfit info?"),
        (["convert", "page.html", "x.pc2"], "page.html is a page; open it in a browser"),
        (["info", "f.checkpoint"], "f.checkpoint"),
        (["info", "blender.json"], "blender.json is an export for another tool; name the scene that it was made of"),
        (["simulate", "blender.json"], "blender.json is an export; name the scene that it was made of"),
        (["info", "map.csv"], "map.csv is a map of markers to vertices; it goes with --map"),
    ],
)
def test_the_right_place_is_named(capsys, arguments, message):
    assert run(arguments) == 3
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith(f"error: {message}")


@pytest.mark.parametrize(
    ("size", "doubt"), [("700", "it is 700 m across"), ("0.0001", "it weighs 2 µg"), ("2", "")]
)
def test_unlikely_units_are_doubted(capsys, tmp_path, monkeypatch, size, doubt):
    monkeypatch.chdir(tmp_path)
    for command in (["new", "plane", "--size", size, "--divisions", "1"], ["info", "plane.json"]):
        assert run(command) == 0
        err = capsys.readouterr().err
        assert doubt in err
        assert ("warning" in err) == bool(doubt)


NO_SCENES = {
    "a.vtk": (b"# vtk DataFile Version 3.0\nASCII\n", "it is a VTK file; export it as .ply, .stl or .obj"),
    "a.off": (b"OFF\n3 1 0\n", "it is an OFF mesh; export it as .ply, .stl or .obj"),
    "a.msh": (b"$MeshFormat\n4.1 0 8\n", "it is a Gmsh mesh; export it as .ply, .stl or .obj"),
    "a.fbx": (b"Kaydara FBX Binary  \0\x1a\0\xe8", "it is an FBX file; export it as .glb, .usd, .abc or .obj"),
    "a.blend": (b"BLENDER-v402\xff", "it is a Blender file; export it as .glb, .usd, .abc or .obj"),
    "a.dae": (b'<?xml version="1.0"?><COLLADA/>', "it is an XML file, as COLLADA's and VTK's are; export it as .glb, "
              ".usd, .abc or .obj"),
    "a.jpg": (b"\xff\xd8\xff\xe0", "it is a picture; name another file"),
    "a.m3": (b"\xfe\0\1", "it is no scene, which is a JSON object, and .m3 is no format that is read; export it as "
             "another"),
    "e.obj": (b"", "it is empty; export it again"),
    "e.glb": (b" \n", "it is empty; export it again"),
    "e.trc": (b"", "it is empty; export it again"),
    "e.json": (b"", "the file is empty; a scene is a JSON object"),
    "f.json": (b"[1", "line 1, column 3: the text ends inside a value; is the file complete?"),
}  # fmt: skip


@pytest.mark.parametrize(("name", "content", "message"), [(name, *rest) for name, rest in NO_SCENES.items()])
def test_what_is_no_scene_is_called_what_it_is(name, content, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_bytes(content)
    assert run(["info", name]) == 3
    assert capsys.readouterr().err == f"error: {name}: {message}\n"
    assert run(["validate", name]) == 3
