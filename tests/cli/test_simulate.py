"""`clothfit simulate` and `clothfit target`: files, streams, summaries, energies, and scenes that diverge."""

import io
import json
import re
import sys

import numpy as np
import pytest
from helpers.scenes import cloth, document, even, names, sphere, trial, write_scene

from clothfit import degrade, energies, load, simulate
from clothfit.cli.program import run
from clothfit.engine.fallbacks import Fallbacks
from clothfit.fit.estimate import record_target
from clothfit.motion.motion import load_motion

pytestmark = pytest.mark.slow  # compiles motions

NAMED = ("schema_version", "command", "scene", "frames", "vertices", "seconds", "output", "diverged", "dump")
KEYS = {*NAMED, *Fallbacks._fields, "first_order", "touching"}
SCENE = trial("nG", 6, 3, 3)
WILD = even("nG", 50, integrationMethod=1, springStiffness=[1e4] * 33, damping=0.0)


@pytest.fixture
def path(here):
    """A small scene, alone in the current folder."""
    return write_scene(here, SCENE, "my scene.v1.txt")


def test_the_motion_goes_beside_the_scene(path, here, told):
    summary, err = told(f"simulate '{path}'")
    assert names() == ["my scene.v1.motion.npz", "my scene.v1.txt"]
    found, scene = load_motion("my scene.v1.motion.npz", load(path)), load(path)
    np.testing.assert_array_equal(found.positions, simulate(scene).positions)
    np.testing.assert_array_equal(found.times, np.arange(6) * 0.02)
    with np.load("my scene.v1.motion.npz", allow_pickle=False) as kept:
        assert {key: (kept[key].shape, kept[key].dtype.str) for key in kept.files} == {
            "positions": ((6, 9, 3), "<f8"), "times": ((6,), "<f8"), "vertex_counts": ((1,), "<i8"),
        }  # fmt: skip
    assert "my scene.v1.txt: 5 steps of 0.02 s" in err
    assert set(summary) == KEYS
    assert (summary["schema_version"], summary["command"]) == (1, "simulate")
    assert (summary["frames"], summary["vertices"], summary["diverged"], summary["dump"]) == (6, 9, None, None)


def test_with_the_motion_on_standard_output_the_summary_goes_to_standard_error(path, capsysbinary):
    assert run(["simulate", path, "-q", "--json", "--steps", "3", "-o", "-"]) == 0
    out, err = capsysbinary.readouterr()
    assert set(json.loads(err)) == KEYS
    found = load_motion(io.BytesIO(out), load(path))
    np.testing.assert_array_equal(found.positions, simulate(load(path), 4).positions)
    assert names() == ["my scene.v1.txt"]


def test_the_tolerance_is_the_scenes_unless_given(path, said):
    said(f"simulate '{path}' -o x.npz --tolerance 1e-9")
    scene = load(path)
    found = load_motion("x.npz", scene)
    np.testing.assert_array_equal(found.positions, simulate(scene, tolerance=1e-9).positions)
    assert (found.positions != simulate(scene).positions).any()


def test_quiet_says_nothing_and_verbose_more(path, said):
    quiet, plain, verbose = (len(said(f"simulate '{path}' {option}")[2].splitlines()) for option in ("-q", "", "-v"))
    assert quiet == 0 < plain < verbose


def test_a_motion_is_not_written_to_a_terminal(path, said, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    error = "error: a motion is not text, so it is not written to a terminal; name a file with -o\n"
    assert said(f"simulate '{path}' -o -") == (3, "", error)


@pytest.mark.parametrize(
    ("scene", "warning"),
    [({**SCENE, "colliders": [sphere(), sphere(type=0)]}, r"colliders\[1\]: planes are ignored, as in the editor; "),
     ({**WILD, "optimizationIterations": 5}, r"objects\[0\]: from step \d on springs are more than 10 times as long")],
)  # fmt: skip
def test_a_plane_and_a_finite_motion_that_cannot_be_believed_are_warnings(here, said, scene, warning):
    write_scene(here, scene)
    code, _, err = said("simulate scene.json")
    assert code == 0
    assert re.search(f"warning: scene.json: {warning}", err)


# --- scenes that diverge


def test_a_scene_that_diverges_is_code_4_and_keeps_the_good_frames_and_their_energy(here, said):
    scene = load(write_scene(here, even("nn", 50, integrationMethod=0, springStiffness=[1e4] * 33)))
    code, out, err = said("simulate scene.json --energy")
    assert code == 4
    assert err.splitlines()[-1].startswith("error: scene.json: the simulation diverged at step ")
    kept = load_motion("scene.motion.npz", scene)
    assert 1 <= len(kept.times) < 50
    assert np.isfinite(kept.positions).all()
    assert f"the {len(kept.times)} frames before it are in" in err
    _, rows = table(out)
    with np.load("scene.motion.npz", allow_pickle=False) as arrays:
        assert len(arrays["energy_total"]) == len(kept.times) == int(rows[-1][0]) + 1
        assert arrays["energy_kinetic"][-1] > 1e6  # what ended it


def test_a_dump_holds_the_last_states(here, told):
    scene = load(write_scene(here, WILD))
    summary, err = told("simulate scene.json --dump last.npz", code=4)
    assert "the last states and the first bad one of objects[0] are in last.npz\n" in err
    kept = load_motion("scene.motion.npz", scene)
    with np.load("last.npz", allow_pickle=False) as found:
        steps, x = found["steps"], found["positions"]
    assert steps[-1] == len(kept.times)
    np.testing.assert_array_equal(x[:-1], kept.positions[steps[:-1]])
    assert not (np.abs(x[-1]).sum(axis=1) < 1e12).all()
    assert f"diverged at step {steps[-1]} " in err
    found = summary["diverged"]
    when = f"at step {found['step']} (t = {found['time']:.4g} s)"
    assert f"{when}, objects[{found['object']}], vertex {found['vertex']} of 16;" in err
    assert (set(summary), summary["frames"], summary["dump"]) == (KEYS, found["step"], "last.npz")


def test_a_motion_that_stays_finite_leaves_no_dump(path, said):
    code, _, err = said(f"simulate '{path}' --dump last.npz")
    assert (code, "it stayed finite, so nothing is written to last.npz\n" in err) == (0, True)
    assert names() == ["my scene.v1.motion.npz", "my scene.v1.txt"]


@pytest.mark.parametrize("command", ["simulate", "target", "estimate", "evaluate scene.json"])
def test_steps_beyond_the_stability_limit_are_told_before_they_are_taken(here, said, command):
    write_scene(here, WILD)
    code, _, err = said(f"{command} scene.json")
    first, *_, last = err.splitlines()
    assert code == 4
    assert first.startswith("warning: scene.json: objects[0]: symplectic steps of 0.02 s will not stay stable (the ")
    assert "try a smaller delta (symplectic steps: the limit is 0.00" in last
    assert last.startswith("error: scene.json: the simulation diverged at step ")


# --- simulate --energy: the table, what the motion file keeps, the summary

STORED = {"kinetic", "elastic", "gravity", "contact", "total"}
FLOWS = {"wind", "moved", "damping", "drag", "numerical", "dissipated"}
ENERGIES = STORED | FLOWS
PLAIN = {"dragCoefficient": 0.0, "damping": 0.0}


def made(here, *objects, **fields):
    return load(write_scene(here, document(*objects, optimizationIterations=31, **fields)))


def table(text):
    """Header and rows of the table, split into cells."""
    lines = [line.split() for line in text.splitlines()]
    start = next(i for i, cells in enumerate(lines) if cells[:2] == ["frame", "time"])
    return lines[start], [cells for cells in lines[start + 1 :] if cells[0].isdigit()]


def test_the_table_has_what_there_is_and_the_file_keeps_every_frame(here, told):
    scene = made(here, windVel={"x": 1.0, "y": 0.0, "z": 0.5}, colliders=[sphere(0.3)])
    summary, err = told("simulate scene.json --energy")
    header, rows = table(err)
    assert " ".join(header) == "frame time kinetic elastic gravity contact total wind damping drag numerical"
    assert [row[0] for row in rows] == [str(3 * i) for i in range(11)]
    expected = energies(scene, simulate(scene))
    assert float(rows[-1][header.index("total") + 1]) == float(f"{expected.total[-1]:.4g}")  # the time is two cells
    with np.load("scene.motion.npz", allow_pickle=False) as kept:
        assert {name.removeprefix("energy_") for name in kept.files if name.startswith("energy_")} == set(ENERGIES)
        for name in ENERGIES:
            np.testing.assert_array_equal(kept[f"energy_{name}"], getattr(expected, name))
    assert load_motion("scene.motion.npz", scene).positions.shape == (31, 12, 3)  # a target like any other
    own = summary["energy"]
    assert set(own) == {"start", "end", *FLOWS, "largest_rise", "largest_rise_frame", "excess", "scale"}
    assert set(own["start"]) == set(own["end"]) == STORED
    assert (own["end"]["total"], own["numerical"]) == (expected.total[-1], expected.numerical[-1])
    assert (own["largest_rise"], own["largest_rise_frame"]) == expected.largest_rise


def test_what_is_nothing_throughout_has_no_column_and_the_last_line_tells_of_gain(here, said):
    found = {}
    for method in (0, 2):
        made(here, cloth(2, 2, **PLAIN, springStiffness=[100.0] * 5), integrationMethod=method, delta=0.005)
        code, out, _ = said("simulate scene.json --energy")
        header, rows = table(out)
        assert (code, header) == (0, ["frame", "time", "kinetic", "elastic", "gravity", "total", "numerical"])
        assert rows[0] == ["0", "0", "s", "0", "0", "0", "0", "0"]
        found[method] = out.splitlines()[-1]
    assert found[2] == "the total never rises in a step by more than the work of wind and what moves"
    assert found[0].startswith("the total rises by up to ")


def falling(speed, step, method=2, drag=0.0, **fields):
    """A light cloth of 8 x 8 vertices, 10 cm over a sphere of 1 m, at a speed in m/s."""
    n = 64
    vertices = [{"x": 0.2 * i - 0.7, "y": 0.6, "z": 0.2 * j - 0.7} for j in range(8) for i in range(8)]
    own = {"vertPos": vertices, "vertIsFixed": [False] * n, "vertMass": [0.0014] * n, "damping": 0.0}
    moving = {"vertVel": [{"x": 0.0, "y": -speed, "z": 0.0}] * n, "dragCoefficient": drag}
    made = {"delta": step, "optimizationIterations": 12, "integrationMethod": method, **fields}
    return document(cloth(8, 8, 0.2, **own, **moving), colliders=[sphere()], **made)


AIR = {"drag": 1e-6, "windVel": {"x": 0.1, "y": 0.0, "z": 0.0}}


@pytest.mark.parametrize(
    ("command", "scene", "warned"),
    [("simulate", falling(31.0, 0.02, **AIR), True), ("target", falling(31.0, 0.02, **AIR), True),
     ("target", falling(31.0, 0.02), False), ("simulate", falling(31.0, 0.001), False),
     ("simulate", falling(31.0, 0.02, 3), False), ("simulate", falling(1.0, 0.02, 3), False),
     ("simulate", falling(4.4, 0.005), False)],
)  # fmt: skip
def test_energy_that_contacts_add_is_said_unasked(here, said, command, scene, warned):
    """At 31 m/s a vertex is 0.6 m deep in the sphere after a step of 20 ms, and comes out as fast as it went in while
    its neighbours still fall: the springs between them are stretched by what nothing gave. Without wind such a step is
    taken anew with these contacts in its equations.
    """
    write_scene(here, scene)
    code, _, err = said(f"{command} scene.json")
    assert (code, "warning: scene.json: contacts have added energy: at frame " in err) == (0, warned)


def test_steps_with_early_contacts_are_counted(here, told):
    write_scene(here, falling(31.0, 0.02))
    summary, err = told("simulate scene.json")
    count = summary["early_contacts"]
    assert count > 0
    assert f"{count} of 11 steps were stabilised (deep in a sphere at once)" in err


# --- target

TARGET_KEYS = {"schema_version", "command", "scene", "frames", "observed", "noise", "output"}


@pytest.fixture
def two(here):
    """A small scene of two objects."""
    objects = (cloth(4, 4, optimizationSettings="nG"), cloth(2, 2))
    return load(write_scene(here, document(*objects, optimizationIterations=9)))


def test_the_perfect_motion_of_all_objects_goes_beside_the_scene(two, said):
    code, _, err = said("target scene.json")
    assert (code, "9 frames, 100% seen, no noise → " in err) == (0, True)
    found, true = load_motion("scene.target.npz", two), record_target(two)
    np.testing.assert_array_equal(found.positions, true.positions)
    np.testing.assert_array_equal(found.times, true.times)
    assert found.observed is None
    assert names() == ["scene.json", "scene.target.npz"]


def test_the_options_are_those_of_the_library(two, told):
    summary, _ = told("target scene.json --noise 0.001 --observed 0.25 --every 2 --seed 4 --steps 12")
    found = load_motion("scene.target.npz", two)
    assert set(summary) == TARGET_KEYS
    assert (summary["frames"], summary["observed"], summary["noise"]) == (7, 0.25, 1e-3)
    same = degrade(record_target(two, 13), 0.001, 0.25, 2, 4)
    assert len(found.times) == 7
    for name in ("positions", "observed", "times"):
        np.testing.assert_array_equal(getattr(found, name), getattr(same, name))
    assert [int(found.seen(i)[0].sum()) for i in range(2)] == [4, 1]


def test_a_suffix_that_nothing_has_is_refused_before_anything_is_computed(here, said):
    write_scene(here, document())
    for command in ("simulate scene.json --steps 100000000 -o x.fbx", "target scene.json --steps 100000000 -o x.fbx"):
        code, _, err = said(command)
        assert code == 3
        assert err.startswith("error: x.fbx: no motion format has that suffix; known are .npz, .obj, .pc2")
