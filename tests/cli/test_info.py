"""`clothfit info` and `clothfit validate`; files that are recognised, and which option or command takes them."""

import re
import sys

import numpy as np
import pytest
from helpers.paths import EXAMPLES
from helpers.scenes import MISSING, changed, cloth, document, even, sphere, trial, write_scene

from clothfit import Motion, save_motion
from clothfit.base.checkpoint import encoded
from clothfit.base.limits import doubts, doubts_of_time
from clothfit.cli.common.motions import split
from clothfit.export.tools import exported
from clothfit.formats.registry import kind_of
from clothfit.scene.scene import WAY_OUT, load

SIDE = str(EXAMPLES / "side.json")
INFO = {"schema_version", "command", "scene", "title", "integrator", "of_the_editor", "delta", "frames", "duration",
        "tolerance", "newton_iterations", "wind", "gravity", "spheres", "objects", "flagged", "stability", "memory",
        "unknown_fields", "warnings", "kind", "doubts", "inputs", "colliders",
        "self_collision", "subspace"}  # fmt: skip


def test_the_text_of_info_is_its_result(said):
    code, out, err = said(f"info '{SIDE}'")
    assert (code, err) == (0, "")
    for told in ("side.json: 'side': implicit steps of 0.02 s, 1 Newton iteration, tolerance 1e-05",
                 "100 frames to compare, 1.98 s", "144, 12 fixed", "726: 385 along edges, 341 bending, 0 others",
                 "1 (144 vertices)", "7 × 0 × 7 m", "stiffness (L, 726)", "symplectic  0.00538 s            not stable",
                 "implicit    any                  stable", "a frame in a subspace of 64 vectors about"):  # fmt: skip
        assert told in out


def test_info_of_several_objects_and_all_that_a_scene_may_have(here, said):
    objects = [cloth(3, 3, optimizationSettings="Ln", mine=1), cloth(2, 2, vertVel=[{"x": 1, "y": 0, "z": 0}] * 4),
               *[cloth(2, 2, springRestLength=[1.5] * 5, meshVertices=[0, 1, 2, 3, -1, 0])] * 3]  # fmt: skip
    balls = [sphere(0.1 * k) for k in range(1, 8)]
    write_scene(here, document(*objects, colliders=balls, integrationMethod=1, fit={"windVel": "G"}))
    _, out, _ = said("info scene.json")
    for told in ("objects[3]", "objects[4]", "and 2 more spheres", "at the start", "(not those at the start)",
                 "to fit: scene wind", "objects[2] was welded from a mesh of 6 vertices",
                 "fields that are kept and not used: objects[0].mine", "symplectic steps of"):  # fmt: skip
        assert told in out


def test_a_step_that_the_editor_does_not_have_is_said(here, said):
    for k in (2, 3):
        write_scene(here, trial("nL", 5, integrationMethod=k), f"{k}.json")
    _, out, _ = said("info 3.json")
    assert "bdf2 steps of 0.02 s, 1 Newton iteration, tolerance" in out
    assert "Unity" not in out + said("validate 3.json")[1]  # only where it is asked for
    first, second = said("validate 2.json 3.json --for unity")[1].splitlines()
    assert first == "2.json: valid"
    assert "3.json: valid; the editor in Unity cannot play its step (bdf2, integrationMethod 3)" in second


def test_a_law_of_the_air_that_the_editor_does_not_have_is_said(here, said):
    write_scene(here, document(cloth(3, 3, dragLaw="air", dragCoefficient=1.2), integrationMethod=2))
    _, out, _ = said("info scene.json")
    assert "1.2 (law air)" in out
    assert "the front end in Unity does not know of dragLaw" in said("validate scene.json --for unity")[1]


def test_what_a_fit_chooses_among_is_said(here, said):
    write_scene(here, even("nn", fit="auto"))
    _, text, _ = said("info scene.json")
    assert "a fit chooses by itself (auto) among what is to fit\n" in text
    assert re.search(r"^to fit +stiffness \(M, \d+\), damping \(G, 1\), drag \(G, 1\)$", text, re.MULTILINE)


def test_the_summary_of_a_scene_through_a_pipe(told, standard_input):
    standard_input(EXAMPLES / "drape.json")
    found, err = told("info - -q")
    assert (err, set(found), found["scene"], found["of_the_editor"]) == ("", INFO, "standard input", True)
    assert found["spheres"] == [{"centre": [0.0, -4.1, 0.0], "radius": 4.0}]
    assert found["flagged"] == [{"object": 0, "name": "mass", "mode": "G", "count": 1}]
    assert found["objects"][0]["mass"]["total"] == pytest.approx(4.9, rel=1e-11)  # 0.1 kg/m² of 7 m by 7 m
    assert found["memory"]["motion"] == 100 * 144 * 24
    assert found["subspace"]["full_us"] < found["subspace"]["physics_us"]  # 144 vertices
    assert found["subspace"]["vertices_from"] > 144
    assert found["stability"][2] == {"integrator": "implicit", "limit": None, "stable": True}


# --- validate

TWO_WRONG = changed(changed(trial("nG", 5), ("objects", 0, "vertMass", 3), -1), ("objects", 0, "springs", 3), 144)


def test_a_single_problem_is_in_the_result_and_in_the_error(here, said, summary, monkeypatch):
    wrong = [(("objects", 0, "meshVertices"), [0], "objects[0].meshVertices: must be a list"),
             (("delta",), MISSING, "delta: is missing, and it has no default"),
             (("delta",), 0, "delta: 0 is too small; it must be above 0")]  # fmt: skip
    for place, value, problem in wrong:
        write_scene(here, changed(trial("nG", 5), place, value))
        found = summary("validate scene.json", code=3)["problems"][0]
        assert f"{found['place']}: {found['message']}".startswith(problem)
    error = f"error: scene.json: {problem}\n"
    assert said("validate scene.json") == (3, f"scene.json: {problem}\n", error)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)  # where both are read, once is enough
    assert said("validate scene.json") == (3, "", error)


def test_every_problem_is_told_and_one_of_several_scenes_is_enough(here, said, told):
    write_scene(here, TWO_WRONG)
    springs = "scene.json: objects[0].springs[3]: vertex 144 does not exist (the object has 16 vertices)"
    mass = "scene.json: objects[0].vertMass[3]: the mass -1.0 kg must be above 0"
    code, out, _ = said(f"validate '{SIDE}' scene.json")
    assert (code, set(out.splitlines())) == (3, {f"{SIDE}: valid", springs, mass})
    _, _, err = said("validate scene.json -q")
    assert re.fullmatch(r"error: scene\.json: objects\[0\]\..* \(and 1 more problem\)\n", err)
    found, err = told(f"validate '{SIDE}' scene.json absent.json -q", code=3)
    assert ([each["valid"] for each in found["scenes"]], found["valid"]) == ([True, False, False], False)
    assert len(found["scenes"][1]["problems"]) == 2
    assert found["scenes"][2]["problems"][0]["place"] is None
    assert err == "error: 2 of 3 scenes are not valid: scene.json, absent.json\n"


def test_the_summary_of_one_scene(here, summary):
    plane = {"type": 0, "pos": {"x": 0, "y": 0, "z": 0}, "scale": {"x": 1, "y": 1, "z": 1}}
    write_scene(here, document(colliders=[plane]))
    found = summary("validate scene.json")
    assert (found["valid"], found["problems"]) == (True, [])
    message = f"planes are ignored, as in the editor; {WAY_OUT}"
    assert found["warnings"] == [{"place": "colliders[0]", "message": message}]


@pytest.mark.parametrize(
    ("sentence", "place"),
    [("objects[0].springs[3]: vertex 144 does not exist", "objects[0].springs[3]"), ("delta: is missing", "delta"),
     ("line 3, column 7: not JSON: no", "line 3, column 7"), ("top level: [] is not an object", "top level"),
     ('"my: field".x: appears twice', '"my: field".x'), ("cannot be read: Is a directory", None),
     ("the file is empty; a scene is a JSON object", None), ("byte 5 (0xe9) is not UTF-8 text; save", None)],
)  # fmt: skip
def test_problems_are_split_into_place_and_message(sentence, place):
    found = split(sentence)
    assert found["place"] == place
    assert sentence == (found["message"] if place is None else f"{place}: {found['message']}")


def test_forces(here, said, summary):
    """Two vertices of three, over two rows of 0.1 s: effort is Σ |u|² h."""
    forces = np.zeros((2, 3, 3))
    forces[0, 1], forces[1, 2] = [3.0, 0.0, 4.0], [0.0, -2.0, 0.0]
    arrays = {"times": np.array([0.0, 0.1]), "forces": forces}
    np.savez("plan.npz", **arrays)
    found = summary("info plan.npz")
    assert [found[key] for key in ("kind", "steps", "vertices", "actuated")] == ["forces", 2, 3, 2]
    assert found["duration"] == pytest.approx(0.2)
    assert found["largest"] == {"force": 5.0, "vertex": 1, "time": 0.0}
    assert found["effort"] == pytest.approx(0.1 * (25.0 + 4.0))
    assert found["springs"] is found["regulator"] is None
    gain = np.zeros((2, 3))
    gain[:, 1] = 7.0
    feedback = {"measure": np.eye(3), "push": np.ones((3, 1)), "gains": np.ones((1, 2, 3, 18))}
    feedback |= {"reference": np.zeros((1, 2, 18)), "bound": np.array(6.0)}
    np.savez("both.npz", **arrays, gain=gain, places=forces, **feedback)
    _, text, _ = said("info both.npz")
    assert "springs of up to 7 N/m on 1 vertex" in text
    assert "a regulator in 3 modes, 1 shape of forces, no force above 6 N" in text
    np.savez("bad.npz", **{**arrays, "times": np.zeros(2)})
    assert "times[1]: is not later than the one before it" in said("info bad.npz")[2]
    (here / "t.csv").write_text("time,vertex,fx,fy,fz\n0,1,0,0,2\n")
    assert summary("info t.csv")["largest"]["force"] == 2.0
    error = "plan.npz is a file of forces; did you mean clothfit info, or simulate --forces?"
    assert error in said("validate plan.npz")[2]


# --- files of other kinds

SCENE_PLACES = ["simulate", "target", "estimate", "evaluate", "validate", "report", "check", "export"]


@pytest.fixture
def files(here):
    """A file of each kind, made without a simulation."""
    scene = load(write_scene(here, even("nG", 5, 3, 3)))
    start = scene.cloths[0].positions
    times = 0.02 * np.arange(4)
    x = start + np.array([0.0, -1.0, 0.0]) * times[:, None, None]
    observed = np.ones(x.shape[:2], bool)
    observed[1:, 2] = False
    save_motion(Motion(x, times, (9,)), "curtain.pc2", scene)
    save_motion(Motion(x, times, (9,)), "flag.glb", scene)
    save_motion(Motion(x, times, (9,), observed), "seen.npz", scene)
    (here / "quad.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 0 1\nv 1 0 1\nf 1 2 4 3\n")
    (here / "fit.jsonl").write_text(
        '{"iteration": 0, "evaluations": 1, "seconds": 0.1, "cost": 1.0, "rmse": 0.5}\n'
        '{"summary": {"status": "converged", "rmse": 0.25, "scene": "scene.json"}}\n'
    )
    (here / "page.html").write_text("<!doctype html><title>fit</title>")
    for name, content in exported(scene, "blender").items():
        (here / name).write_bytes(content)
    (here / "map.csv").write_text("marker,object,vertex\nm1,0,3\n")
    (here / "f.checkpoint").write_bytes(encoded("fit", {}, {}))


KINDS = {"scene.json": "scene", "curtain.pc2": "motion", "seen.npz": "motion", "flag.glb": "mesh or motion",
         "quad.obj": "mesh", "fit.jsonl": "log", "page.html": "page", "map.csv": "map", "f.checkpoint": "checkpoint",
         "blender.json": "export", "blender.py": "export",
         "a_*.obj": "mesh or motion", "absent.json": None, ".": None}  # fmt: skip


@pytest.mark.usefixtures("files")
def test_a_file_is_known_by_its_content_and_its_name():
    assert {name: kind_of(name) for name in KINDS} == KINDS


@pytest.mark.usefixtures("files")
def test_info_of_a_motion_with_gaps(said, summary):
    found = summary("info seen.npz -q")
    assert (found["kind"], found["frames"], found["points"], found["timed"]) == ("motion", 4, 9, True)
    assert found["fps"] == pytest.approx(50.0, rel=1e-12)
    assert found["observed"] == pytest.approx(1 - 3 / 36, rel=1e-12)
    assert found["never_observed"] == 0
    assert found["last"]["time"] == pytest.approx(0.06, rel=1e-12)
    assert (found["first"]["observed"], found["last"]["observed"]) == (9, 8)
    # the root mean square of 0, 0.02, 0.04, 0.06 m over 9 points in the first frame and 8 in each of the others
    assert found["travel"] == pytest.approx(np.sqrt(8 * (0.02**2 + 0.04**2 + 0.06**2) / 33), rel=1e-9)
    code, out, err = said("info seen.npz")
    assert (code, err) == (0, "")
    assert "4, 50 a second, 0.06 s" in out
    assert "8.33 % of the positions" in out


@pytest.mark.usefixtures("files")
def test_info_of_a_cache_a_mesh_a_log_and_what_can_be_both(said, summary):
    for name, told in (("quad.obj", "triangles      2"), ("flag.glb", "frames         4"),
                       ("fit.jsonl", "converged, RMSE 250 mm"), ("curtain.pc2", "right-handed, 1 m per unit"),
                       ("curtain.pc2", "motion\nformat         PC2 point cache\nframes         4, no times (--fps)")):
        assert told in said(f"info {name}")[1]
    found = summary("info quad.obj")
    assert (found["kind"], found["vertices"], found["size"]) == ("mesh", 4, [1.0, 0.0, 1.0])


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize("command", SCENE_PLACES)
@pytest.mark.parametrize("name", ["curtain.pc2", "seen.npz", "flag.glb", "quad.obj", "fit.jsonl", "f.checkpoint"])
def test_no_command_takes_another_file_for_a_scene(said, command, name):
    more = {"evaluate": "scene.json", "report": "scene.json", "export": "--to csv"}
    code, out, err = said(f"{command} {name} {more.get(command, '')}")
    assert (code, out, err.count("\n")) == (3, "", 1)
    assert err.startswith(f"error: {name} is a {KINDS[name]}; did you mean ")


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("estimate scene.json curtain.pc2", "curtain.pc2 is a motion; did you mean --target?"),
        ("estimate scene.json --target map.csv", "map.csv is a map; did you mean --map?"),
        ("estimate scene.json --target scene.json", "scene.json is a scene; did you mean SCENE"),
        ("estimate scene.json --target f.checkpoint", "f.checkpoint is a checkpoint; did you mean --check"),
        ("report scene.json scene.json --log curtain.pc2", "curtain.pc2 is a motion; "),
        ("new curtain.pc2", "curtain.pc2 is a motion; it has no faces; did you mean estimate --target?"),
        ("new scene.json", "scene.json is a scene; did you mean clothfit info?"),
        ("convert page.html x.pc2", "page.html is a page; open it in a browser"),
        ("info f.checkpoint", "f.checkpoint"),
        ("info blender.json", "blender.json is an export for another tool; name the scene that it was made of"),
        ("simulate blender.json", "blender.json is an export; name the scene that it was made of"),
        ("info map.csv", "map.csv is a map of markers to vertices; it goes with --map"),
    ],
)
def test_the_right_place_is_named(said, line, message):
    code, out, err = said(line)
    assert (code, out, err.count("\n")) == (3, "", 1)
    assert err.startswith(f"error: {message}")


@pytest.mark.parametrize(
    ("size", "doubt", "scale"),
    [("700", "it is 700 m across", "0.001"),
     ("0.0001", "it is 100 µm across", "1000"), ("2", "", ""),
     ("60", "it is 60 m across", "0.01")],
)  # fmt: skip
def test_unlikely_units_are_doubted_once_in_every_command_and_the_remedy_works(said, size, doubt, scale):
    assert said(f"new plane --size {size} --divisions 1")[0] == 0
    assert said("simulate plane.json --steps 1 -o plane.glb -q")[0] == 0
    for line in ("new plane.glb --scale 1", "info plane.json", "validate plane.json", "simulate plane.json --steps 1",
                 "info plane.glb", "convert plane.glb x.pc2 --fps 30"):
        code, _, err = said(line)
        assert (code, err.count("across")) == (0, bool(doubt))
        assert ".glb" in line or doubt in err  # which has single precision
        assert scale == "" or f"--scale {scale}" in err
    if doubt:
        assert "across" not in said(f"new plane.glb --scale {scale}")[2]


def test_millimetres_are_told_from_centimetres_and_odd_steps_and_gravity_are_doubted():
    for factor, unit in ((100.0, "centimetres, add --scale 0.01"), (1000.0, "millimetres, add --scale 0.001")):
        (doubt,) = doubts([0.5 * factor, 0.6 * factor, 0.1 * factor])
        assert doubt.endswith(f"if the file is in {unit}")
    assert doubts([0.5, 0.6, 0.1], 0.2) == doubts_of_time(0.02, (0, -9.81, 0)) == []
    assert len(doubts_of_time(20.0, (0, -981.0, 0))) == 2


NO_SCENES = {
    "a.fbx": (b"Kaydara FBX Binary  \0\x1a\0\xe8", "it is an FBX file; export it as .glb, .usd, .abc or .obj"),
    "a.m3": (b"\xfe\0\1", "it is no scene, which is a JSON object, and .m3 is no format that is read; export it as "
             "another"),
    "e.obj": (b"", "it is empty; export it again"),
    "e.json": (b"", "the file is empty; a scene is a JSON object"),
    "f.json": (b"[1", "line 1, column 3: the text ends inside a value; is the file complete?"),
}  # fmt: skip


@pytest.mark.parametrize(("name", "content", "message"), [(name, *rest) for name, rest in NO_SCENES.items()])
def test_what_is_no_scene_is_called_what_it_is(name, content, message, here, said):
    (here / name).write_bytes(content)
    assert said(f"info {name}") == (3, "", f"error: {name}: {message}\n")
    assert said(f"validate {name}")[0] == 3
