"""`clothfit check`: what it says and ends with where the gradient is right, wrong, or cannot be judged."""

import json

import numba
import pytest
from helpers.scenes import cloth, document, sphere, trial, write_scene

from clothfit.cli.program import run
from clothfit.objective.objective import Objective

pytestmark = [
    pytest.mark.slow,  # starts processes
    pytest.mark.skipif(numba.config.DISABLE_JIT, reason="hundreds of motions are slow without compilation"),
]

KEYS = {
    "schema_version", "command", "scene", "verdict", "frames", "target", "flagged", "parameters", "tests",
    "longest_step", "left_out", "unseen", "seconds",
}  # fmt: skip
NAMES = ["Taylor", "difference", "dot product"]


@pytest.fixture
def path(tmp_path, monkeypatch):
    """A small scene with contact, in a folder of its own, which is the current one."""
    monkeypatch.chdir(tmp_path)
    made = trial("LL", 30, 3, 3, colliders=[sphere(0.7, pos={"x": 1.0, "y": -0.75, "z": 1.0})])
    return write_scene(tmp_path, made)


def said(capsys, *arguments):
    """Exit code, standard output and standard error of a check."""
    code = run(["check", *arguments])
    return code, *capsys.readouterr()


def test_a_right_gradient_is_told_line_by_line(path, capsys, tmp_path):
    code, out, err = said(capsys, path)
    assert code == 0
    assert "gradient" not in err
    lines = [line for line in out.splitlines() if not line.startswith("steps above")]
    what, header, *tests, last = lines
    assert what == (
        "gradient by objects[0] mass (L, 9 values), objects[0] stiffness (L, 16 values); 30 frames, against the motion "
        "of values up to 10 % off"
    )
    assert header.split() == ["test", "measured", "bar", "verdict"]
    assert [line.split("  ")[0] for line in tests] == NAMES
    assert all(line.endswith("passed") for line in tests)
    assert last == "scene.json: the gradient is right"
    assert [file.name for file in tmp_path.iterdir()] == ["scene.json"]  # nothing is written


def test_the_summary(path, capsys):
    code, out, err = said(capsys, path, "--json", "-q")
    told = json.loads(out)
    assert (code, err, set(told)) == (0, "", KEYS)
    assert (told["command"], told["verdict"], told["frames"], told["flagged"]) == ("check", "passed", 30, True)
    assert [test["name"] for test in told["tests"]] == NAMES
    assert [test["verdict"] for test in told["tests"]] == ["passed"] * 3
    assert told["tests"][0]["measured"] > told["tests"][0]["bar"] == 1.9
    assert told["tests"][1]["measured"] < told["tests"][1]["bar"] == 1e-6
    assert told["parameters"][0] == {"object": 0, "name": "mass", "mode": "L", "count": 9}


def test_a_wrong_gradient_is_a_fault_of_the_program(path, capsys, monkeypatch):
    right = Objective.add_pullback

    def wrong(objective, run, p, system, memory, by_position, gradient):
        right(objective, run, p, system, memory, by_position, gradient)
        gradient[5] *= 1.01

    monkeypatch.setattr(Objective, "add_pullback", wrong)
    code, out, err = said(capsys, path, "--json")
    assert (code, json.loads(out)["verdict"]) == (1, "failed")
    assert err.splitlines()[-1] == (
        "error: scene.json: the gradient is wrong (Taylor, difference, dot product): a fault of the program; please "
        "report it with the scene"
    )


def test_what_cannot_be_judged_is_neither_right_nor_wrong(path, capsys, tmp_path):
    held = write_scene(tmp_path, document(cloth(3, 3, vertIsFixed=[True] * 9), optimizationIterations=10), "held.json")
    code, out, err = said(capsys, held, "--json")
    assert (code, json.loads(out)["verdict"]) == (3, "unclear")
    assert "whether the gradient is right cannot be seen here" in err.splitlines()[-1]
    assert "try fewer or more --steps" in err


def test_a_scene_that_flags_nothing_is_checked_by_masses_and_stiffnesses(path, capsys, tmp_path):
    plain = write_scene(tmp_path, trial("nn", 10, 3, 3), "plain.json")
    code, out, err = said(capsys, plain, "--json")
    told = json.loads(out)
    assert (code, told["flagged"], [b["name"] for b in told["parameters"]]) == (0, False, ["mass", "stiffness"])
    assert "plain.json flags nothing to fit: checked by all masses and stiffnesses\n" in err


def test_a_large_cloth_is_looked_at_over_fewer_steps_and_that_is_said(path, capsys, monkeypatch):
    monkeypatch.setattr("clothfit.inspection.gradient_check.CHECKED_VERTEX_STEPS", 90)
    code, _, err = said(capsys, path)
    assert code == 0
    assert "the first 10 of 29 steps; --steps checks others\n" in err
    assert json.loads(said(capsys, path, "--json", "--steps", "20")[1])["frames"] == 21


def test_self_contact_that_does_not_act_is_told(path, capsys, tmp_path):
    apart = {"selfCollision": {"thickness": 0.01}}
    for made, unseen in ((trial("nG", 4, 3, 3, **apart), ["self-contact"]), (trial("nG", 4, 3, 3), [])):
        scene = write_scene(tmp_path, made, "apart.json")
        assert json.loads(said(capsys, scene, "--json")[1])["unseen"] == unseen
        told = "self-contact did not act in these frames" in said(capsys, scene)[1]
        assert told == bool(unseen)


def test_a_target_of_ones_own(path, capsys):
    assert run(["target", path, "--noise", "0.001", "--every", "2", "-q", "-o", "capture.npz"]) == 0
    code, out, err = said(capsys, path, "--target", "capture.npz", "--json")
    assert (code, json.loads(out)["target"]) == (0, "capture.npz")
    assert "against capture.npz" in err


def test_a_target_that_shows_nothing_in_time(path, capsys):
    assert run(["target", path, "--every", "20", "-q", "-o", "late.npz"]) == 0
    code, _, err = said(capsys, path, "--target", "late.npz", "--steps", "5")
    assert code == 3
    assert err.splitlines()[-1] == (
        "error: late.npz: shows nothing after the start that can move, within 6 frames, so there is nothing to check "
        "the gradient with; ask for more --steps"
    )


def test_a_scene_that_diverges_is_code_4(path, capsys, tmp_path):
    wild = write_scene(tmp_path, trial("LL", 50, integrationMethod=0, springStiffness=[1e4] * 33), "wild.json")
    code, out, err = said(capsys, wild)
    assert (code, out) == (4, "")
    assert "diverged at step" in err.splitlines()[-1]


def test_from_standard_input(path, capsys, standard_input):
    standard_input(path)
    code, out, _ = said(capsys, "-")
    assert (code, out.splitlines()[-1]) == (0, "standard input: the gradient is right")
    assert said(capsys, "-", "--target", "-")[0] == 3
