"""`clothfit check`: what it says and ends with where the gradient is right, wrong, or cannot be judged."""

import json

import numba
import pytest
from helpers.scenes import cloth, document, sphere, trial, write_scene

from clothfit.cli.program import run

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


def test_a_right_gradient_is_told_line_by_line_and_in_the_summary(path, capsys, tmp_path):
    code, out, err = said(capsys, path, "--json")
    lines = [line for line in err.splitlines() if not line.startswith("steps above")][-6:]
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
    told = json.loads(out)
    assert (code, set(told)) == (0, KEYS)
    assert (told["command"], told["verdict"], told["frames"], told["flagged"]) == ("check", "passed", 30, True)
    assert [(test["name"], test["verdict"]) for test in told["tests"]] == [(name, "passed") for name in NAMES]
    assert told["tests"][0]["measured"] > told["tests"][0]["bar"] == 1.9
    assert told["tests"][1]["measured"] < told["tests"][1]["bar"] == 1e-6
    assert told["parameters"][0] == {"object": 0, "name": "mass", "mode": "L", "count": 9}
    assert told["unseen"] == []


def test_what_is_not_flagged_and_what_does_not_act_is_told(path, capsys, tmp_path):
    """Masses and stiffnesses are checked where nothing is flagged; a flat cloth does not touch itself."""
    plain = trial("nn", 4, 3, 3, selfCollision={"thickness": 0.01})
    code, out, err = said(capsys, write_scene(tmp_path, plain, "plain.json"), "--json")
    told = json.loads(out)
    assert (code, told["flagged"], [b["name"] for b in told["parameters"]]) == (0, False, ["mass", "stiffness"])
    assert "plain.json flags nothing to fit: checked by all masses and stiffnesses\n" in err
    assert told["unseen"] == ["self-contact"]
    assert "self-contact did not act in these frames" in err


def test_what_cannot_be_judged_is_neither_right_nor_wrong(path, capsys, tmp_path):
    held = write_scene(tmp_path, document(cloth(3, 3, vertIsFixed=[True] * 9), optimizationIterations=10), "held.json")
    code, out, err = said(capsys, held, "--json")
    assert (code, json.loads(out)["verdict"]) == (3, "unclear")
    assert "whether the gradient is right cannot be seen here" in err.splitlines()[-1]
    assert "try fewer or more --steps" in err


def test_a_large_cloth_is_looked_at_over_fewer_steps_and_that_is_said(path, capsys, monkeypatch):
    monkeypatch.setattr("clothfit.evaluation.gradient_check.CHECKED_VERTEX_STEPS", 90)
    code, _, err = said(capsys, path)
    assert code == 0
    assert "the first 10 of 29 steps; --steps checks others\n" in err
    assert json.loads(said(capsys, path, "--json", "--steps", "20")[1])["frames"] == 21


def test_a_target_of_ones_own(path, capsys):
    assert run(["target", path, "--noise", "0.001", "--every", "2", "-q", "-o", "capture.npz"]) == 0
    code, out, err = said(capsys, path, "--target", "capture.npz", "--json")
    assert (code, json.loads(out)["target"]) == (0, "capture.npz")
    assert "against capture.npz" in err


def test_from_standard_input(path, capsys, standard_input):
    standard_input(path)
    code, out, _ = said(capsys, "-")
    assert (code, out.splitlines()[-1]) == (0, "standard input: the gradient is right")
    assert said(capsys, "-", "--target", "-")[0] == 3
