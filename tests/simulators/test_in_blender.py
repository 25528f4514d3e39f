"""Fits with Blender in the loop, and its law of bending, where a Python with Blender (bpy) is at hand: CLOTHFIT_BPY."""

import io
import json
import os

import numpy as np
import pytest

from clothfit import InvalidInput, load, new_scene, save, simulate
from clothfit.cli.program import run
from clothfit.export.blender import TIME_UNIT
from clothfit.export.tools import exported
from clothfit.formats.axes import to_scene
from clothfit.meshes.mesh import plane
from clothfit.simulators.blender import AXES, Blender, program, tool_of

pytestmark = [
    pytest.mark.slow,  # starts a process
    pytest.mark.skipif("CLOTHFIT_BPY" not in os.environ, reason="CLOTHFIT_BPY names no Python with Blender"),
]

FRAMES = 21


@pytest.fixture(scope="module")
def blender():
    """A running Blender."""
    with Blender(program(None)) as running:
        yield running


def sheet():
    """A sheet of 4 × 4 vertices that hangs at two corners, in implicit steps."""
    mesh = plane(2, 1.0)
    held = np.zeros(len(mesh.positions), bool)
    held[[0, 3]] = True
    return new_scene(mesh, held, density=0.2, stiffness=20.0, drag=0.0, frames=FRAMES, integrator="implicit")


def test_the_script_that_is_written_moves_as_the_fit_says(blender, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    save(sheet(), "sheet.json")
    assert run(["estimate", "sheet.json", "--simulator", "blender", "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)["objects"]
    assert told["rmse"] <= told["mapped_rmse"] < 0.2 * told["travel"]
    scene = load("sheet.json")
    tool = tool_of(scene, 0, FRAMES, blender)  # which leaves the mesh there
    mesh, script = f"{blender.folder.name}/mesh0.npz", str(tmp_path / "sheet-blender" / "blender.py")
    job = {"mesh": mesh, "script": script, "fps": 50.0, "frames": FRAMES}
    played = to_scene(blender.play(job), AXES)
    target = simulate(scene, tolerance=1e-10).positions
    apart = np.sqrt(((played - target) ** 2).sum(axis=2).mean())
    # the numbers of the file and those of the fit are the same
    assert apart == pytest.approx(told["rmse"], rel=1e-6)
    assert [value["name"] for value in told["values"]] == [value.name for value in tool.values]


@pytest.mark.parametrize(("stiffness", "length", "away"), [(1e-3, 0.1, 0.1), (2e-3, 0.1, 0.2), (1e-3, 0.2, 0.1)])
def test_a_hinge_of_blenders_pushes_a_third_of_its_law(blender, stiffness, length, away):
    """A vertex across a hinge hangs where its weight's part across the face is 0.1 B ℓ θ/(3 τ²)."""
    mass, numbers = 1e-3, io.BytesIO()
    points = [[0, 0, 0], [0, length, 0], [-away, length / 2, 0], [away, length / 2, 0]]
    np.savez(numbers, positions=np.array(points, float), triangles=np.array([[0, 1, 2], [1, 0, 3]]))
    stiff = {"stiffness": 10.0, "stiffness_max": 10.0, "weights": [0.0] * 4}
    bending = {"stiffness": stiffness, "stiffness_max": stiffness, "weights": [0.0] * 4}
    values = {
        "object": 0, "vertices": 4, "mass": mass, "air_damping": 0.01, "spring_damping": 0.0, "structural": stiff,
        "bending": bending, "pin": [0, 1, 2],
    }  # fmt: skip
    script = exported(sheet(), "blender")["blender.py"].replace(b'DATA["step"]', b"0.0005")
    job = {
        "mesh": blender.file("hinge.npz", numbers.getvalue()), "script": blender.file("hinge.py", script),
        "values": values, "fps": 50.0, "frames": 400,
    }  # fmt: skip
    x = blender.play(job)[-1, 3]
    theta, reach = np.arctan2(-x[2], x[0]), np.hypot(x[0], x[2])
    force = mass * 9.81 * x[0] / reach
    # it still swings by a thousandth after 8 s
    assert force == pytest.approx(0.1 * stiffness * length * theta / 3 / TIME_UNIT**2, rel=5e-3)


def test_what_blender_refuses_is_said(blender):
    with pytest.raises(InvalidInput, match="no-such"):
        blender.play({"mesh": "no-such.npz", "script": "", "fps": 50.0, "frames": 2})
