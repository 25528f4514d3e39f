"""`clothfit control`, and `simulate --forces`: files, messages, exit codes."""

import json

import numpy as np
import pytest
from helpers.scenes import cloth, document, write_scene

from clothfit.base.errors import InvalidInput

pytestmark = pytest.mark.slow  # compiles motions with inputs

CONTROL = "control scene.json --keyframes keys.json"


@pytest.fixture(autouse=True)
def place(here):
    """The folder has a scene of six vertices, and keys for it."""
    own = cloth(3, 2, springStiffness=[20.0] * 9, damping=0.5, optimizationSettings="nG")
    write_scene(here, document(own, optimizationIterations=12))
    wanted = [[0.0, 0.1, 1.0], [1.0, 0.2, 1.0], [2.0, 0.1, 1.0]]
    write_scene(here, {"keys": [{"time": 0.2, "vertices": [3, 4, 5], "positions": wanted}]}, "keys.json")


def positions(*names):
    """What those files hold."""
    return [np.load(name)["positions"] for name in names]


def test_from_keys_to_forces_and_back(said, summary, here):
    """Also from their table, to the same bits; with all that is drawn of them."""
    shows = "--table f.csv --plot p.png --gif p.gif --report r.html"
    found = summary(f"{CONTROL} {shows} -q")
    (key,) = found["keys"]
    assert key["time"] == pytest.approx(0.2)
    assert key["rmse"] < 1e-3 < 0.05 < key["free"]
    assert found["effort"] > 0
    assert found["status"] in ("converged", "stalled")
    assert {"optimality", "evaluations", "seconds"} <= found.keys()
    assert (found["forces"], found["output"], found["scene"]) == ("scene.forces.npz", "scene.controlled.npz", None)
    for forces, out in (("scene.forces.npz", "a.npz"), ("f.csv", "b.npz"), ("scene.forces.npz --feedback", "c.npz")):
        assert said(f"simulate scene.json --forces {forces} -o {out} -q")[0] == 0
    first, again, table, back = positions("scene.controlled.npz", "a.npz", "b.npz", "c.npz")
    np.testing.assert_array_equal(again, first)
    np.testing.assert_array_equal(table, first)
    np.testing.assert_allclose(back, first, atol=1e-3)  # velocities are solved for to 1e-5
    assert (here / "p.png").read_bytes()[:4] == b"\x89PNG"
    assert (here / "p.gif").read_bytes()[:3] == b"GIF"
    assert "clothfit simulate scene.json --forces scene.forces.npz" in (here / "r.html").read_text("utf-8")


def test_a_motion_is_keys_too(said):
    assert said("simulate scene.json --steps 1 -o one.npz -q")[0] == 0
    code, _, err = said("control scene.json --keyframes one.npz --forces f.npz -o m.npz")
    assert code == 0
    assert "effort 0 N² s" in err or np.abs(np.load("f.npz")["forces"]).max() < 1e-3


def test_where_one_file_cannot_be_written_the_others_are(said, here, monkeypatch):
    """As on a disk that is full by then."""

    def full(*_):
        """A writer of data."""
        raise InvalidInput("cannot write scene.forces.npz: No space left on device")

    monkeypatch.setattr("clothfit.scene.forces.archive", lambda _: full)
    code, _, err = said(CONTROL)
    assert (code, "No space left" in err, (here / "scene.controlled.npz").exists()) == (3, True, True)


def test_forces_that_are_too_weak_miss_the_key(said):
    code, _, err = said(f"{CONTROL} --most 0.001")
    assert (code, "not all keys are reached" in err) == (5, True)


def test_forces_wherever_a_scene_is_simulated(said, summary, here):
    """A fit, its check, its figures and its page under known forces; and keys for a fitted scene."""
    forces, times = np.zeros((11, 6, 3)), 0.02 * np.arange(11)
    forces[:, 5] = [0.3, 0.5, -0.2]
    np.savez("f.npz", forces=forces, times=times)
    guess = json.loads((here / "scene.json").read_text())
    guess["objects"][0]["springStiffness"] = [30.0] * 9
    write_scene(here, guess, "guess.json")
    under = "--forces f.npz -q"
    assert said(f"target scene.json {under} -o t.npz")[0] == 0
    assert said(f"estimate guess.json --target t.npz {under} -o fitted.json")[0] == 0
    fitted = json.loads((here / "fitted.json").read_text())["objects"][0]["springStiffness"]
    assert fitted == pytest.approx([20.0] * 9, rel=1e-5)
    wrong = summary(f"evaluate scene.json guess.json {under}")["rmse"]
    assert summary(f"evaluate scene.json fitted.json --target t.npz {under}")["rmse"] < 1e-5 * wrong
    assert said(f"check scene.json {under}")[0] == 0
    assert said(f"report scene.json fitted.json --target t.npz {under} -o p.html")[0] == 0
    assert "--forces f.npz" in (here / "p.html").read_text()
    assert said(f"{CONTROL.replace('scene', 'fitted')} --budget 5s -q")[0] in (0, 5)
