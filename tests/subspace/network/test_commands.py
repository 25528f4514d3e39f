"""Networks by the commands: trained, gone on with, played and compared."""

import dataclasses
import json

import numpy as np
import pytest
from helpers.scenes import cloth, document, write_scene

from clothfit.cli.program import run
from clothfit.subspace.model import load_model
from clothfit.subspace.network import learn
from clothfit.subspace.network.layers import OWN

pytestmark = pytest.mark.slow  # compiles motions with inputs


def test_the_commands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path, document(cloth(4, 4, damping=0.5), optimizationIterations=30))
    assert run(["subspace", "record", "scene.json", "--episodes", "4", "--frames", "40", "--wind", "4", "-q"]) == 0
    own = ["subspace", "build", "scene.data.npz", "--method", "network", "--basis", "6", "--seed", "3"]
    assert run([*own, "--rounds", "40", "-o", "a.npz", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["training"][0]["rounds"] == 40
    missed = said["objects"][0]["sampled"]["relative_rmse"]
    assert missed > 0.02
    assert said["objects"][0]["floor"] > 0.0
    assert run([*own, "--rounds", "2", "-o", "b.npz"]) == 0
    assert " %: the full simulation itself is so far off" in capsys.readouterr().out
    assert run([*own, "--rounds", "60", "-o", "a.npz", "--resume", "-q"]) == 0
    assert load_model("a.npz").built["training"][0]["rounds"] == 60
    assert run([*own, "--rounds", "60", "-o", "a.npz", "--resume"]) == 0
    assert "60 rounds already; ask for more" in capsys.readouterr().err
    assert run(["evaluate", "scene.json", "a.npz", "--json", "-q"]) == 0
    assert json.loads(capsys.readouterr().out)["clamped"] == []
    assert run(["subspace", "play", "a.npz", "--frames", "25", "-o", "m.npz", "-q"]) == 0
    assert np.load("m.npz")["positions"].shape == (25, 16, 3)
    assert run([*own, "--rounds", "60", "--seed", "4", "-o", "a.npz", "--resume", "-q"]) == 3
    assert "belongs to another training: another data, basis, recipe or seed" in capsys.readouterr().err
    changed = dataclasses.replace(OWN, least=0.5)  # as of another version of this program
    monkeypatch.setattr(learn, "OWN", changed)
    assert run([*own, "--rounds", "70", "-o", "a.npz", "--resume", "-q"]) == 3
    assert "belongs to another training: another data, basis, recipe or seed" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (["--rounds", "5"], "--rounds goes with --method network"),
        (["--method", "network", "--cubature", "0.1"], "--cubature does not go with"),
        (["--method", "network", "--minutes", "1", "--rounds", "5"], "give one of them"),
        (["--method", "network", "--minutes", "nan"], "--minutes must be above 0"),
        (["--method", "network", "--rounds", "0"], "--rounds must be at least 1"),
    ],
)
def test_options_that_do_not_fit_are_refused(tmp_path, capsys, wrong, why):
    write_scene(tmp_path, document(cloth(3, 3)))
    assert run(["subspace", "build", str(tmp_path / "scene.json"), *wrong]) in (2, 3)
    assert why in capsys.readouterr().err
