"""Subspaces by the commands: recorded, built by physics and by networks, played, compared; and what is refused."""

import dataclasses
import json

import numpy as np
import pytest
from helpers.scenes import cloth, document, sphere, write_scene

from clothfit.cli.program import run
from clothfit.scene.scene import load
from clothfit.subspace.model import load_model
from clothfit.subspace.network import learn
from clothfit.subspace.network.layers import OWN
from clothfit.subspace.recording import Data

pytestmark = pytest.mark.slow  # compiles motions with inputs

RECORDED = ["--episodes", "4", "--frames", "40", "--wind", "4"]
GUST = [{"acts": "wind", "times": [0, 0.3], "values": [[0, 0, 0], [2, 0, 2]]}]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with scene.json, its data and inputs w.json."""
    folder = tmp_path_factory.mktemp("commands")
    ball = sphere(0.1, pos={"x": 500.0, "y": 0.0, "z": 0.0}, friction=0.1)  # which nothing touches
    made = document(cloth(4, 4, damping=0.5), colliders=[ball], optimizationIterations=30)
    scene = write_scene(folder, made)
    (folder / "w.json").write_text(json.dumps({"inputs": GUST}))
    assert run(["subspace", "record", str(scene), *RECORDED, "-o", str(folder / "scene.data.npz"), "-q"]) == 0
    return folder


@pytest.fixture
def said(place, monkeypatch, capsys):
    """A function that runs the command there, and gives its exit code, what it prints as JSON, and its messages."""
    monkeypatch.chdir(place)

    def found(*arguments, code=0):
        assert run(list(arguments)) == code
        out, err = capsys.readouterr()
        return json.loads(out) if "--json" in arguments else out + err

    return found


def test_physics(place, said):
    said("subspace", "build", "scene.data.npz", "--basis", "12", "-o", "a.npz")
    built = said("subspace", "build", "scene.json", *RECORDED, "--basis", "12", "--normals", "-o", "b.npz", "--json")
    assert built["objects"][0]["vectors"] == 12
    a, b = load_model("a.npz").parts[0], load_model("b.npz").parts[0]
    np.testing.assert_array_equal(a.basis, b.basis)
    assert (a.normals, b.normals.shape) == (None, (16, 3, 13))
    said("subspace", "play", "a.npz", "--inputs", "w.json", "--frames", "25", "-o", "m.npz")
    assert np.load("m.npz")["positions"].shape == (25, 16, 3)
    crowd = ["--instances", "3", "--frames", "8", "-o", "c.npz", "--seed", "1"]
    played = said("subspace", "play", "b.npz", *crowd, "--json")
    assert played["outputs"] == ["c-1.npz", "c-2.npz", "c-3.npz"]
    assert set(played["us_per_frame"]) == {"state", "decode", "normals"}
    first, second = (np.load(name)["positions"] for name in played["outputs"][:2])
    assert first.shape == (8, 16, 3)
    assert np.abs(first - second).max() > 1e-6
    pushed = said("subspace", "play", "b.npz", "--inputs", "w.json", "--push-out", "2mm", "--frames", "5", "--json")
    assert set(pushed["us_per_frame"]) == {"state", "decode", "push_out"}
    asked = ["--instances", "2", "--push-out", "0"]
    assert "--push-out does not go with --instances" in said("subspace", "play", "b.npz", *asked, code=2)
    found = said("evaluate", "scene.json", "a.npz", "--inputs", "w.json", "--json")
    assert found["relative_rmse"] < 0.1
    assert set(found["us_per_frame"]) == {"state", "decode", "normals"}
    assert {"drift", "energy", "energy_gain", "normals"} <= set(found)
    assert found["full_us_per_step"] > 0
    shown = ["--plot", "p.png", "--report", "p.html", "--steps", "20"]
    said("evaluate", "scene.json", "b.npz", "--inputs", "w.json", *shown)
    assert {"p.png", "p.html"} <= {each.name for each in place.iterdir()}
    assert "with a subspace only" in said("evaluate", "scene.json", "scene.json", "--report", "q.html", code=2)
    assert "input or another output" in said("evaluate", "scene.json", "b.npz", "--report", "b.npz", code=3)
    assert "clothfit subspace play" in said("info", "a.npz", code=3)


def test_networks(said, monkeypatch):
    own = ["subspace", "build", "scene.data.npz", "--method", "network", "--basis", "6", "--seed", "3"]
    built = said(*own, "--rounds", "40", "-o", "n.npz", "--json")
    assert built["training"][0]["rounds"] == 40
    assert built["objects"][0]["sampled"]["relative_rmse"] > 0.02
    assert built["objects"][0]["floor"] > 0.0
    assert " %: the full simulation itself is so far off" in said(*own, "--rounds", "2", "-o", "few.npz")
    said(*own, "--rounds", "60", "-o", "n.npz", "--resume")
    assert load_model("n.npz").built["training"][0]["rounds"] == 60
    assert "60 rounds already; ask for more" in said(*own, "--rounds", "60", "-o", "n.npz", "--resume")
    assert said("evaluate", "scene.json", "n.npz", "--json")["clamped"] == []
    said("subspace", "play", "n.npz", "--frames", "25", "-o", "m.npz")
    assert np.load("m.npz")["positions"].shape == (25, 16, 3)
    other = "belongs to another training: another data, basis, recipe or seed"
    assert other in said(*own, "--rounds", "60", "--seed", "4", "-o", "n.npz", "--resume", code=3)
    monkeypatch.setattr(learn, "OWN", dataclasses.replace(OWN, least=0.5))  # as of another version of this program
    assert other in said(*own, "--rounds", "70", "-o", "n.npz", "--resume", code=3)


def test_motions_of_other_programs_are_recorded(place, said):
    times = 0.02 * np.arange(20)
    x = load(place / "scene.json").cloths[0].positions
    np.savez("x.npz", positions=x + np.sin(times)[:, None, None], times=times)
    named = ["subspace", "record", "scene.json", "-o", "x.data.npz", "--motion", "x.npz@w.json"]
    said(*named, "--motion", "x.npz@w.json")
    data = Data("x.data.npz")
    assert [each.items[0]["acts"] for each in data.episodes] == ["wind", "wind"]
    assert data.scene_of(0).wind_keys is not None
    assert "name two motions at least" in said(*named, code=3)
    assert "--wind makes motions at random" in said(*named, "--motion", "x.npz@w.json", "--wind", "3", code=2)


NETWORK = ["build", "scene.json", "--method", "network"]


@pytest.mark.parametrize(
    ("arguments", "code", "why"),
    [
        (["play", "scene.json"], 3, "no model of clothfit subspace build"),
        (["build", "scene.json", "--inputs", "w.json"], 2, "--inputs does not go with build"),
        (["play", "scene.json", "--normals"], 2, "--normals does not go with play"),
        (["build", "scene.json", "--error", "soft"], 3, "'soft' is no length"),
        (["play", "scene.json", "--instances", "0"], 3, "--instances must be at least 1"),
        (["build", "scene.json", "--basis", "0"], 3, "--basis must be between 1 and 512"),
        (["record", "scene.json", "--episodes", "1"], 3, "--episodes must be at least 2"),
        (["record", "scene.json", "--wind", "-1"], 3, "--wind must be at least 0"),
        (["record", "none.json"], 3, "none.json: there is no such file"),
        (["build", "scene.json", "--rounds", "5"], 2, "--rounds goes with --method network"),
        ([*NETWORK, "--cubature", "0.1"], 2, "--cubature does not go with"),
        ([*NETWORK, "--minutes", "1", "--rounds", "5"], 2, "give one of them"),
        ([*NETWORK, "--minutes", "nan"], 3, "--minutes must be above 0"),
        ([*NETWORK, "--rounds", "0"], 3, "--rounds must be at least 1"),
    ],
)
def test_bad_input_costs_one_sentence(said, arguments, code, why):
    assert why in said("subspace", *arguments, code=code)
