"""`clothfit control`, and `simulate --forces`: files, messages, exit codes."""

import json

import numpy as np
import pytest
from helpers.scenes import cloth, document, write_scene

from clothfit.base.errors import InvalidInput
from clothfit.cli.program import run

pytestmark = pytest.mark.slow  # compiles motions with inputs


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with a scene of six vertices, and keys for it."""
    monkeypatch.chdir(tmp_path)
    own = document(cloth(3, 2, springStiffness=[20.0] * 9, damping=0.5), optimizationIterations=12)
    write_scene(tmp_path, own)
    free = [3, 4, 5]
    wanted = [[0.0, 0.1, 1.0], [1.0, 0.2, 1.0], [2.0, 0.1, 1.0]]
    key = {"time": 0.2, "vertices": free, "positions": wanted}
    (tmp_path / "keys.json").write_text(json.dumps({"keys": [key]}))
    return tmp_path


def test_from_keys_to_forces_and_back(place, capsys):
    arguments = ["control", "scene.json", "--keyframes", "keys.json", "--json", "-q"]
    assert run(arguments) == 0
    said = json.loads(capsys.readouterr().out)
    (key,) = said["keys"]
    assert key["time"] == pytest.approx(0.2)
    assert key["rmse"] < 1e-3 < 0.05 < key["free"]
    assert said["effort"] > 0
    assert said["status"] in ("converged", "stalled")
    assert {"optimality", "evaluations", "seconds"} <= said.keys()
    assert (said["forces"], said["output"]) == ("scene.forces.npz", "scene.controlled.npz")
    assert run(["simulate", "scene.json", "--forces", "scene.forces.npz", "-o", "again.npz", "-q"]) == 0
    motions = [np.load(name)["positions"] for name in ("scene.controlled.npz", "again.npz")]
    np.testing.assert_array_equal(*motions)
    assert run(["simulate", "scene.json", "--forces", "scene.forces.npz", "--feedback", "-o", "back.npz", "-q"]) == 0
    back = np.load("back.npz")["positions"]
    np.testing.assert_allclose(back, motions[0], atol=1e-3)  # velocities are solved for to 1e-5


def test_a_motion_is_keys_too(place, capsys):
    assert run(["simulate", "scene.json", "--steps", "1", "-o", "one.npz", "-q"]) == 0
    assert run(["control", "scene.json", "--keyframes", "one.npz", "--forces", "f.npz", "-o", "m.npz"]) == 0
    assert "effort 0 N² s" in capsys.readouterr().err or np.abs(np.load("f.npz")["forces"]).max() < 1e-3


def test_a_table_plays_back_to_the_same_bits(place, capsys):
    asked = ["--table", "f.csv", "--plot", "p.png", "--gif", "p.gif", "--report", "r.html", "--budget", "2s"]
    assert run(["control", "scene.json", "--keyframes", "keys.json", *asked, "-q"]) in (0, 5)
    assert run(["simulate", "scene.json", "--forces", "f.csv", "-o", "again.npz", "-q"]) == 0
    np.testing.assert_array_equal(*(np.load(each)["positions"] for each in ("scene.controlled.npz", "again.npz")))
    assert (place / "p.png").read_bytes()[:4] == b"\x89PNG"
    assert (place / "p.gif").read_bytes()[:3] == b"GIF"
    page = (place / "r.html").read_text("utf-8")
    assert "clothfit simulate scene.json --forces scene.forces.npz" in page


def test_where_one_file_cannot_be_written_the_others_are(place, capsys, monkeypatch):
    """As on a disk that is full by then."""

    def full(*_):
        """A writer of data."""
        raise InvalidInput("cannot write scene.forces.npz: No space left on device")

    monkeypatch.setattr("clothfit.scene.forces.archive", lambda _: full)
    assert run(["control", "scene.json", "--keyframes", "keys.json"]) == 3
    assert "No space left" in capsys.readouterr().err
    assert (place / "scene.controlled.npz").exists()


def test_forces_that_are_too_weak_miss_the_key(place, capsys):
    assert run(["control", "scene.json", "--keyframes", "keys.json", "--most", "0.001"]) == 5
    assert "not all keys are reached" in capsys.readouterr().err


def test_forces_wherever_a_scene_is_simulated(place, capsys):
    """A fit, its check, its figures and its page under known forces; and keys for a fitted scene."""
    flagged = document(cloth(3, 2, springStiffness=[20.0] * 9, damping=0.5, optimizationSettings="nG"))
    write_scene(place, {**flagged, "optimizationIterations": 12})
    forces, times = np.zeros((11, 6, 3)), 0.02 * np.arange(11)
    forces[:, 5] = [0.3, 0.5, -0.2]
    np.savez("f.npz", forces=forces, times=times)
    under = ["--forces", "f.npz", "-q"]
    assert run(["target", "scene.json", *under, "-o", "t.npz"]) == 0
    guess = json.loads((place / "scene.json").read_text())
    guess["objects"][0]["springStiffness"] = [30.0] * 9
    (place / "guess.json").write_text(json.dumps(guess))
    assert run(["estimate", "guess.json", "--target", "t.npz", *under, "-o", "fitted.json"]) == 0
    fitted = json.loads((place / "fitted.json").read_text())["objects"][0]["springStiffness"]
    assert fitted == pytest.approx([20.0] * 9, rel=1e-5)
    capsys.readouterr()
    assert run(["evaluate", "scene.json", "guess.json", *under, "--json"]) == 0
    wrong = json.loads(capsys.readouterr().out)["rmse"]
    assert run(["evaluate", "scene.json", "fitted.json", "--target", "t.npz", *under, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rmse"] < 1e-5 * wrong
    assert run(["check", "scene.json", *under]) == 0
    assert run(["report", "scene.json", "fitted.json", "--target", "t.npz", *under, "-o", "p.html"]) == 0
    assert "--forces f.npz" in (place / "p.html").read_text()
    assert run(["control", "fitted.json", "--keyframes", "keys.json", "--budget", "5s", "-q"]) in (0, 5)
    assert run(["estimate", "scene.json", "guess.json", "--forces", "f.npz"]) == 2
    assert "--forces" in capsys.readouterr().err
