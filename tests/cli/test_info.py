"""`clothfit info` and `clothfit validate`: what they print, and for whom."""

import json
import sys

import numpy as np
import pytest
from helpers.paths import EXAMPLES
from helpers.scenes import MISSING, changed, cloth, document, sphere, trial, write_scene

from clothfit.cli.program import run
from clothfit.cli.validate import split
from clothfit.scene.scene import WAY_OUT

pytestmark = pytest.mark.slow  # starts processes

SIDE = str(EXAMPLES / "side.json")
INFO = {"schema_version", "command", "scene", "title", "integrator", "of_the_editor", "delta", "frames", "duration",
        "tolerance", "newton_iterations", "wind", "gravity", "spheres", "objects", "flagged", "stability", "memory",
        "unknown_fields", "warnings", "kind", "doubts", "inputs", "colliders",
        "self_collision", "subspace"}  # fmt: skip


def test_the_text_of_info_is_its_result(capsys):
    assert run(["info", SIDE]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    for told in ("side.json: 'side': implicit steps of 0.02 s, 1 Newton iteration, tolerance 1e-05",
                 "100 frames to compare, 1.98 s", "144, 12 fixed", "726: 385 along edges, 341 bending, 0 others",
                 "1 (144 vertices)", "7 × 0 × 7 m", "stiffness (L, 726)", "symplectic  0.00538 s            not stable",
                 "implicit    any                  stable", "a frame in a subspace of 64 vectors about"):  # fmt: skip
        assert told in out


def test_info_of_several_objects_and_all_that_a_scene_may_have(tmp_path, capsys):
    objects = [cloth(3, 3, optimizationSettings="Ln", mine=1), cloth(2, 2, vertVel=[{"x": 1, "y": 0, "z": 0}] * 4),
               *[cloth(2, 2, springRestLength=[1.5] * 5, meshVertices=[0, 1, 2, 3, -1, 0])] * 3]  # fmt: skip
    balls = [sphere(0.1 * k) for k in range(1, 8)]
    path = write_scene(tmp_path, document(*objects, colliders=balls, integrationMethod=1, fit={"windVel": "G"}))
    assert run(["info", path]) == 0
    out = capsys.readouterr().out
    for told in ("objects[3]", "objects[4]", "and 2 more spheres", "at the start", "(not those at the start)",
                 "to fit: scene wind", "objects[2] was welded from a mesh of 6 vertices",
                 "fields that are kept and not used: objects[0].mine", "symplectic steps of"):  # fmt: skip
        assert told in out


def test_a_step_that_the_editor_does_not_have_is_said(tmp_path, capsys):
    own, foreign = (write_scene(tmp_path, trial("nL", 5, integrationMethod=k), f"{k}.json") for k in (2, 3))
    assert run(["info", foreign]) == 0
    told = capsys.readouterr().out
    assert "bdf2 steps of 0.02 s, 1 Newton iteration, tolerance" in told
    assert "the editor in Unity cannot play its step (bdf2, integrationMethod 3)" in told
    assert run(["validate", own, foreign]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.endswith("2.json: valid")
    assert "3.json: valid; the editor in Unity cannot play its step (bdf2, integrationMethod 3)" in second


def test_the_summary_of_a_scene_through_a_pipe(capsys, standard_input):
    standard_input(EXAMPLES / "drape.json")
    assert run(["info", "-", "--json", "-q"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
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


def test_a_single_problem_is_in_the_result_and_in_the_error(tmp_path, capsys, monkeypatch):
    wrong = [(("objects", 0, "meshVertices"), [0], "objects[0].meshVertices: must be a list"),
             (("delta",), MISSING, "delta: is missing, and it has no default"),
             (("delta",), 0, "delta: 0 is too small; it must be above 0")]  # fmt: skip
    for place, value, problem in wrong:
        path = write_scene(tmp_path, changed(trial("nG", 5), place, value))
        assert run(["validate", path, "--json"]) == 3
        found = json.loads(capsys.readouterr().out)["problems"][0]
        assert f"{found['place']}: {found['message']}".startswith(problem)
    assert run(["validate", path]) == 3
    out, err = capsys.readouterr()
    assert (out, err) == (f"{path}: {problem}\n", f"error: scene.json: {problem}\n")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)  # where both are read, once is enough
    assert run(["validate", path]) == 3
    assert capsys.readouterr() == ("", err)


def test_every_problem_is_told_and_one_of_several_scenes_is_enough(tmp_path, capsys):
    path = write_scene(tmp_path, TWO_WRONG)
    assert run(["validate", SIDE, path]) == 3
    springs = "objects[0].springs[3]: vertex 144 does not exist (the object has 16 vertices)"
    mass = "objects[0].vertMass[3]: the mass -1.0 kg must be above 0"
    assert set(capsys.readouterr().out.splitlines()) == {f"{SIDE}: valid", f"{path}: {springs}", f"{path}: {mass}"}
    assert run(["validate", path, "-q"]) == 3
    last = capsys.readouterr().err
    assert last.startswith("error: scene.json: objects[0].")
    assert last.endswith(" (and 1 more problem)\n")
    assert run(["validate", SIDE, path, "absent.json", "-q", "--json"]) == 3
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert [each["valid"] for each in found["scenes"]] == [True, False, False]
    assert found["valid"] is False
    assert len(found["scenes"][1]["problems"]) == 2
    assert found["scenes"][2]["problems"][0]["place"] is None
    assert err == f"error: 2 of 3 scenes are not valid: {path}, absent.json\n"


def test_the_summary_of_one_scene(tmp_path, capsys):
    plane = {"type": 0, "pos": {"x": 0, "y": 0, "z": 0}, "scale": {"x": 1, "y": 1, "z": 1}}
    path = write_scene(tmp_path, document(colliders=[plane]))
    assert run(["validate", path, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
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


def test_a_scene_without_flags_and_springs(tmp_path, capsys):
    point = {"vertPos": [{"x": 0, "y": 0, "z": 0}], "vertIsFixed": [False], "vertMass": [1.0], "springs": [],
             "springStiffness": []}  # fmt: skip
    assert run(["info", write_scene(tmp_path, document(point)), "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["memory"]["fit"] is None
    assert "1 without springs" in err
    assert np.isfinite(json.loads(out)["objects"][0]["mass"]["total"])


def test_forces(tmp_path, capsys, monkeypatch):
    """Two vertices of three, over two rows of 0.1 s: effort is Σ |u|² h."""
    monkeypatch.chdir(tmp_path)
    forces = np.zeros((2, 3, 3))
    forces[0, 1], forces[1, 2] = [3.0, 0.0, 4.0], [0.0, -2.0, 0.0]
    arrays = {"times": np.array([0.0, 0.1]), "forces": forces}
    np.savez("plan.npz", **arrays)
    assert run(["info", "plan.npz", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["kind"] == "forces"
    assert (said["steps"], said["vertices"], said["actuated"]) == (2, 3, 2)
    assert said["duration"] == pytest.approx(0.2)
    assert said["largest"] == {"force": 5.0, "vertex": 1, "time": 0.0}
    assert said["effort"] == pytest.approx(0.1 * (25.0 + 4.0))
    assert said["springs"] is said["regulator"] is None
    gain = np.zeros((2, 3))
    gain[:, 1] = 7.0
    feedback = {"measure": np.eye(3), "push": np.ones((3, 1)), "gains": np.ones((1, 2, 3, 18))}
    feedback |= {"reference": np.zeros((1, 2, 18)), "bound": np.array(6.0)}
    np.savez("both.npz", **arrays, gain=gain, places=forces, **feedback)
    assert run(["info", "both.npz"]) == 0
    text = capsys.readouterr().out
    assert "springs of up to 7 N/m on 1 vertex" in text
    assert "a regulator in 3 modes, 1 shape of forces, no force above 6 N" in text
    np.savez("bad.npz", **{**arrays, "times": np.zeros(2)})
    assert run(["info", "bad.npz"]) == 3
    assert "times[1]: is not later than the one before it" in capsys.readouterr().err
    (tmp_path / "t.csv").write_text("time,vertex,fx,fy,fz\n0,1,0,0,2\n")
    assert run(["info", "t.csv", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["largest"]["force"] == 2.0
    assert run(["validate", "plan.npz"]) == 3
    assert "plan.npz is a file of forces; did you mean clothfit info, or simulate --forces?" in capsys.readouterr().err
