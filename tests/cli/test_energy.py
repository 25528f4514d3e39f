"""`clothfit simulate --energy`: the table, what the motion file keeps, the summary."""

import json

import numpy as np
import pytest
from helpers.scenes import cloth, document, even, sphere, write_scene

from clothfit.cli.program import run
from clothfit.motion.energy import energies
from clothfit.motion.motion import load_motion
from clothfit.motion.simulate import simulate
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow  # compiles a fit

NAMES = ("kinetic", "elastic", "gravity", "contact", "wind", "damping", "drag", "total", "dissipated", "numerical")
STORED = {"kinetic", "elastic", "gravity", "contact", "total"}
FLOWS = {"wind", "damping", "drag", "numerical", "dissipated"}
PLAIN = {"dragCoefficient": 0.0, "damping": 0.0}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def made(folder, *objects, **fields):
    return write_scene(folder, document(*objects, optimizationIterations=31, **fields))


def table(text):
    """Header and rows of the table, split into cells."""
    lines = [line.split() for line in text.splitlines()]
    start = next(i for i, cells in enumerate(lines) if cells[:2] == ["frame", "time"])
    return lines[start], [cells for cells in lines[start + 1 :] if cells[0].isdigit()]


def test_the_table_has_what_there_is_and_the_file_keeps_every_frame(folder, capsys):
    path = made(folder, windVel={"x": 1.0, "y": 0.0, "z": 0.5}, colliders=[sphere(0.3)])
    assert run(["simulate", path, "--energy", "--json"]) == 0
    out, err = capsys.readouterr()
    header, rows = table(err)
    assert header == [
        "frame", "time", "kinetic", "elastic", "gravity", "contact", "total", "wind", "damping", "drag", "numerical",
    ]  # fmt: skip
    assert [row[0] for row in rows] == [str(3 * i) for i in range(11)]
    expected = energies(load(path), simulate(load(path)))
    assert float(rows[-1][header.index("total") + 1]) == float(f"{expected.total[-1]:.4g}")  # the time is two cells
    with np.load("scene.motion.npz", allow_pickle=False) as kept:
        assert {name.removeprefix("energy_") for name in kept.files if name.startswith("energy_")} == set(NAMES)
        for name in NAMES:
            np.testing.assert_array_equal(kept[f"energy_{name}"], getattr(expected, name))
    assert load_motion("scene.motion.npz", load(path)).positions.shape == (31, 12, 3)  # a target like any other
    told = json.loads(out)["energy"]
    assert set(told) == {"start", "end", *FLOWS, "largest_rise", "largest_rise_frame", "scale"}
    assert set(told["start"]) == set(told["end"]) == STORED
    assert (told["end"]["total"], told["numerical"]) == (expected.total[-1], expected.numerical[-1])
    assert (told["largest_rise"], told["largest_rise_frame"]) == expected.largest_rise


def test_what_is_nothing_throughout_has_no_column(folder, capsys):
    assert run(["simulate", made(folder, cloth(**PLAIN)), "--energy"]) == 0
    header, rows = table(capsys.readouterr().out)
    assert header == ["frame", "time", "kinetic", "elastic", "gravity", "total", "numerical"]
    assert rows[0] == ["0", "0", "s", "0", "0", "0", "0", "0"]


def test_the_last_line_tells_of_gain(folder, capsys):
    pair = cloth(2, 2, **PLAIN, springStiffness=[100.0] * 5)
    found = {}
    for method in (0, 2):
        assert run(["simulate", made(folder, pair, integrationMethod=method, delta=0.005), "--energy"]) == 0
        found[method] = capsys.readouterr().out.splitlines()[-1]
    assert found[2] == "the total never rises in a step by more than the wind's work"
    assert found[0].startswith("the total rises by up to ")


def test_a_motion_that_diverges_shows_its_energy_until_then(folder, capsys):
    path = write_scene(folder, even("nn", 50, integrationMethod=0, springStiffness=[1e4] * 33))
    assert run(["simulate", path, "--energy"]) == 4
    out, err = capsys.readouterr()
    assert err.splitlines()[-1].startswith("error: scene.json: the simulation diverged at step ")
    _, rows = table(out)
    with np.load("scene.motion.npz", allow_pickle=False) as kept:
        assert len(kept["energy_total"]) == len(kept["positions"]) == int(rows[-1][0]) + 1
        assert kept["energy_kinetic"][-1] > 1e6  # what ended it


def falling(speed, step, method=2, drag=0.0, **fields):
    """A light cloth of 8 x 8 vertices, 10 cm over a sphere of 1 m, at a speed in m/s."""
    n = 64
    vertices = [{"x": 0.2 * i - 0.7, "y": 0.6, "z": 0.2 * j - 0.7} for j in range(8) for i in range(8)]
    own = {"vertPos": vertices, "vertIsFixed": [False] * n, "vertMass": [0.0014] * n, "damping": 0.0}
    moving = {"vertVel": [{"x": 0.0, "y": -speed, "z": 0.0}] * n, "dragCoefficient": drag}
    one = cloth(8, 8, 0.2, **own, **moving)
    made = {"delta": step, "optimizationIterations": 12, "integrationMethod": method, **fields}
    return document(one, colliders=[sphere()], **made)


@pytest.mark.parametrize("command", ["simulate", "target"])
def test_energy_that_contacts_add_is_said_unasked(tmp_path, capsys, command):
    """At 31 m/s a vertex is 0.6 m deep in the sphere after a step of 20 ms, and comes out as fast as it went in while
    its neighbours still fall: the springs between them are stretched by what nothing gave. Without wind such a step is
    taken anew with these contacts in its equations.
    """
    for air in {"drag": 1e-6, "windVel": {"x": 0.1, "y": 0.0, "z": 0.0}}, {}:
        scene = write_scene(tmp_path, falling(31.0, 0.02, **air))
        assert run([command, scene, "-o", str(tmp_path / "x.npz")]) == 0
        warned = "warning: scene.json: contacts have added energy: at frame " in capsys.readouterr().err
        assert warned == bool(air)


def test_steps_with_early_contacts_are_counted(tmp_path, capsys):
    scene = write_scene(tmp_path, falling(31.0, 0.02))
    assert run(["simulate", scene, "-o", str(tmp_path / "x.npz"), "--json"]) == 0
    shown = capsys.readouterr()
    count = json.loads(shown.out)["early_contacts"]
    assert count > 0
    assert f"in {count} of 11 steps contacts began so deep that they would have added energy" in shown.err


@pytest.mark.parametrize(
    ("speed", "step", "method"), [(31.0, 0.001, 2), (31.0, 0.02, 3), (1.0, 0.02, 3), (4.4, 0.005, 2)]
)
def test_where_contacts_add_little_nothing_is_said(tmp_path, capsys, speed, step, method):
    scene = write_scene(tmp_path, falling(speed, step, method))
    assert run(["simulate", scene, "-o", str(tmp_path / "x.npz")]) == 0
    assert "contacts have added" not in capsys.readouterr().err
