"""`clothfit simulate`: names, streams, summaries, and every kind of scene that cannot be."""

import io
import json
import re
import sys

import numpy as np
import pytest
from helpers.scenes import even, names, sphere, started, trial, write_scene

from clothfit.cli.program import run
from clothfit.engine.fallbacks import Fallbacks
from clothfit.motion.motion import load_motion
from clothfit.motion.simulate import simulate
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow  # starts processes

NAMED = ("schema_version", "command", "scene", "frames", "vertices", "seconds", "output", "diverged", "dump")
KEYS = {*NAMED, *Fallbacks._fields}
SCENE = trial("nG", 6, 3, 3)


@pytest.fixture
def path(tmp_path, monkeypatch):
    """A small scene in a folder of its own, which is the current one."""
    monkeypatch.chdir(tmp_path)
    return write_scene(tmp_path, SCENE, "my scene.v1.txt")


def refuse(constant):
    raise AssertionError(f"{constant} is not JSON")


def test_the_motion_goes_beside_the_scene(path, tmp_path, capsys):
    assert run(["simulate", path, "--json"]) == 0
    assert names(tmp_path) == ["my scene.v1.motion.npz", "my scene.v1.txt"]
    scene = load(path)
    found = load_motion(tmp_path / "my scene.v1.motion.npz", scene)
    np.testing.assert_array_equal(found.positions, simulate(scene).positions)
    np.testing.assert_array_equal(found.times, np.arange(6) * 0.02)
    with np.load(tmp_path / "my scene.v1.motion.npz", allow_pickle=False) as kept:
        assert {key: (kept[key].shape, kept[key].dtype.str) for key in kept.files} == {
            "positions": ((6, 9, 3), "<f8"),
            "times": ((6,), "<f8"),
            "vertex_counts": ((1,), "<i8"),
        }
    out, err = capsys.readouterr()
    assert "my scene.v1.txt: 5 steps of 0.02 s" in err
    summary = json.loads(out, parse_constant=refuse)
    assert set(summary) == KEYS
    assert (summary["schema_version"], summary["command"]) == (1, "simulate")
    assert (summary["frames"], summary["vertices"]) == (6, 9)
    assert (summary["diverged"], summary["dump"]) == (None, None)


def test_with_the_motion_on_standard_output_the_summary_goes_to_standard_error(path, tmp_path, capsysbinary):
    assert run(["simulate", path, "-q", "--json", "--steps", "3", "-o", "-"]) == 0
    out, err = capsysbinary.readouterr()
    assert set(json.loads(err)) == KEYS
    scene = load(path)
    np.testing.assert_array_equal(load_motion(io.BytesIO(out), scene).positions, simulate(scene, 4).positions)
    assert names(tmp_path) == ["my scene.v1.txt"]


def test_the_tolerance_is_the_scenes_unless_given(path, tmp_path):
    run(["simulate", path, "-o", "x.npz", "--tolerance", "1e-9"])
    scene = load(path)
    found = load_motion(tmp_path / "x.npz", scene)
    np.testing.assert_array_equal(found.positions, simulate(scene, tolerance=1e-9).positions)
    assert (found.positions != simulate(scene).positions).any()


def test_quiet_says_nothing_and_verbose_more(path, capsys):
    lines = []
    for option in ("-q", "--no", "-v"):
        assert run(["simulate", path, *[option] * (option != "--no")]) == 0
        lines.append(len(capsys.readouterr().err.splitlines()))
    assert lines[0] == 0 < lines[1] < lines[2]


def test_from_standard_input_to_standard_output(path):
    with open(path, "rb") as scene:
        done = started("simulate", "-", stdin=scene)
    assert done.returncode == 0
    assert b"standard input: 5 steps" in done.stderr
    assert b"\x1b" not in done.stderr
    found = load_motion(io.BytesIO(done.stdout), load(path))
    np.testing.assert_array_equal(found.positions, simulate(load(path)).positions)


def test_a_motion_is_not_written_to_a_terminal(path, capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert run(["simulate", path, "-o", "-"]) == 3
    out, err = capsys.readouterr()
    assert out == ""
    assert err == "error: a motion is not text, so it is not written to a terminal; name a file with -o\n"


def test_a_plane_is_a_warning(tmp_path, capsys):
    made = write_scene(tmp_path, {**SCENE, "colliders": [sphere(), sphere(type=0)]})
    assert run(["simulate", made]) == 0
    assert "warning: scene.json: colliders[1]: planes are ignored, as in the editor; " in capsys.readouterr().err


# --- places that cannot be written


def test_a_read_only_folder_is_refused_before_the_work(path, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("clothfit.base.writing.os.access", lambda *_: False)  # root may write everywhere
    monkeypatch.setattr("clothfit.simulate", None, raising=False)  # a call of it would be a fault, code 1
    assert run(["simulate", path]) == 3
    assert f"the folder {tmp_path} is not writable" in capsys.readouterr().err


# --- scenes that diverge


def test_a_scene_that_diverges_is_code_4_and_keeps_the_good_frames(tmp_path, capsys):
    made = write_scene(tmp_path, even("nn", 50, integrationMethod=0, springStiffness=[1e4] * 33))
    assert run(["simulate", made]) == 4
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines()[-1].startswith("error: scene.json: the simulation diverged at step ")
    kept = load_motion(tmp_path / "scene.motion.npz", load(made))
    assert 1 <= len(kept.times) < 50
    assert np.isfinite(kept.positions).all()
    assert f"the {len(kept.times)} frames before it are in" in err


WILD = even("nG", 50, integrationMethod=1, springStiffness=[1e4] * 33, damping=0.0)


def test_a_dump_holds_the_last_states(tmp_path, capsys):
    made = write_scene(tmp_path, WILD)
    dump = tmp_path / "last.npz"
    assert run(["simulate", made, "--json", "--dump", str(dump)]) == 4
    out, err = capsys.readouterr()
    assert f"the last states and the first bad one of objects[0] are in {dump}\n" in err
    kept = load_motion(tmp_path / "scene.motion.npz", load(made))
    with np.load(dump, allow_pickle=False) as found:
        steps, x = found["steps"], found["positions"]
    assert steps[-1] == len(kept.times)
    np.testing.assert_array_equal(x[:-1], kept.positions[steps[:-1]])
    assert not (np.abs(x[-1]).sum(axis=1) < 1e12).all()
    assert f"diverged at step {steps[-1]} " in err
    summary = json.loads(out, parse_constant=refuse)
    found = summary["diverged"]
    when = f"at step {found['step']} (t = {found['time']:.4g} s)"
    assert f"{when}, objects[{found['object']}], vertex {found['vertex']} of 16;" in err
    assert (set(summary), summary["frames"], summary["dump"]) == (KEYS, found["step"], str(dump))


def test_a_motion_that_stays_finite_leaves_no_dump(path, tmp_path, capsys):
    assert run(["simulate", path, "--dump", "last.npz"]) == 0
    assert "it stayed finite, so nothing is written to last.npz\n" in capsys.readouterr().err
    assert names(tmp_path) == ["my scene.v1.motion.npz", "my scene.v1.txt"]


@pytest.mark.parametrize("command", ["simulate", "target", "estimate", "evaluate"])
def test_steps_beyond_the_stability_limit_are_told_before_they_are_taken(tmp_path, capsys, command):
    made = write_scene(tmp_path, WILD)
    code = run([command, made, *[made] * (command == "evaluate")])
    assert code == 4
    first, *_, last = capsys.readouterr().err.splitlines()
    assert first.startswith("warning: scene.json: objects[0]: symplectic steps of 0.02 s will not stay stable (the ")
    assert "try a smaller delta (symplectic steps: the limit is 0.00" in last
    assert last.startswith("error: scene.json: the simulation diverged at step ")


def test_a_finite_motion_that_cannot_be_believed_is_told(tmp_path, capsys):
    made = write_scene(tmp_path, {**WILD, "optimizationIterations": 5})
    assert run(["simulate", made]) == 0
    err = capsys.readouterr().err
    assert re.search(r"warning: scene.json: objects\[0\]: from step \d on springs are more than 10 times as long", err)


# --- scenes that cannot be
