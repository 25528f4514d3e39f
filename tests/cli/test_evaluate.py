"""`clothfit evaluate`, also with --speed: the tables, the summaries, the advice, what it is given."""

import json
import re
from dataclasses import replace

import numba
import numpy as np
import pytest
from helpers.scenes import even, trial, write_scene

from clothfit.cli.common.console import COMPILING
from clothfit.cli.program import run
from clothfit.evaluation import work_precision as precision
from clothfit.evaluation.evaluate import evaluate
from clothfit.evaluation.work_precision import grid
from clothfit.fit.estimate import record_target
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import save_motion
from clothfit.scene.scene import load

pytestmark = [
    pytest.mark.slow,  # starts processes
    pytest.mark.skipif(numba.config.DISABLE_JIT, reason="hundreds of simulations need compilation"),
]

KEYS = {"schema_version", "command", "diverged", "frames", "rmse", "max_error", "horizon", "parameters"}
PARAMETER_KEYS = {"object", "name", "mode", "count", "median_relative_deviation", "max_relative_deviation"}


def refuse(constant):
    raise AssertionError(f"{constant} is not JSON")


@pytest.fixture
def paths(tmp_path):
    """A scene, and one that is 10 % stiffer."""
    truth = write_scene(tmp_path, even("LG"))
    return truth, write_scene(tmp_path, even("LG", springStiffness=[33.0] * 33), "fitted.json")


def test_json_has_the_keys_and_the_numbers_of_the_library(paths, capsys):
    assert run(["evaluate", *paths, "--json"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out, parse_constant=refuse)
    report = evaluate(*map(load, paths))
    assert (set(found), err.replace(f"{COMPILING}\n", "")) == (KEYS, "")  # the line of a first use
    assert (found["frames"], found["rmse"], found["max_error"]) == (20, report.fitted.rmse, report.fitted.max_error)
    assert found["horizon"] == {"frames": 500, "rmse": report.horizon.rmse, "max_error": report.horizon.max_error}
    assert [set(p) for p in found["parameters"]] == [PARAMETER_KEYS] * 2
    assert found["parameters"][1]["max_relative_deviation"] == pytest.approx(0.1, rel=1e-12)  # rounding


def test_the_table_is_on_standard_output(paths, capsys):
    assert run(["evaluate", *paths]) == 0
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert err == ""
    assert [line.split()[0] for line in lines if line] == [
        "motion",
        "fitted",
        "horizon",
        "parameters",
        "objects[0]",
        "objects[0]",
    ]
    assert lines[-1].split()[1:] == ["stiffness", "(G)", "1", "0.1", "0.1"]
    assert run(["evaluate", *paths, "-q"]) == 0
    assert capsys.readouterr() == ("", "")


def test_what_nothing_reveals_is_null_and_said(tmp_path, capsys):
    path = write_scene(tmp_path, even("LG", vertIsFixed=[True] * 16))
    assert run(["evaluate", path, path, "--json", "--steps", "20"]) == 0
    deviations = json.loads(capsys.readouterr().out)["parameters"]
    assert [d["max_relative_deviation"] for d in deviations] == [None, None]
    assert run(["evaluate", path, path, "--steps", "20"]) == 0
    assert capsys.readouterr().out.count("not identifiable") == 4


def test_steps_are_those_of_the_longer_run(paths, capsys):
    assert run(["evaluate", *paths, "--json", "--steps", "60"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["frames"], found["horizon"]["frames"]) == (20, 61)


def test_a_target_takes_the_place_of_the_truth(paths, tmp_path, capsys):
    noise = 0.01
    target = degrade(record_target(load(paths[1])), noise, 0.5, 2)
    save_motion(target, str(tmp_path / "t.npz"))
    assert run(["evaluate", *paths, "--json", "--target", str(tmp_path / "t.npz")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["frames"], found["horizon"]["frames"]) == (10, 10)
    # 80 positions seen, 240 coordinates: the root mean square scatters by 1 / sqrt(480) = 4.6 %; three times that.
    assert found["rmse"] == pytest.approx(noise * np.sqrt(3), rel=0.14)


def test_a_scene_from_standard_input(paths, capsys, standard_input):
    standard_input(paths[1])
    assert run(["evaluate", paths[0], "-", "--json", "--steps", "20"]) == 0
    out, err = capsys.readouterr()
    assert (err, json.loads(out)["frames"]) == ("", 20)


def test_a_longer_run_that_diverges_does_not_hide_the_fitted_frames(tmp_path, capsys):
    path = write_scene(tmp_path, even("nG", 5, integrationMethod=0, delta=0.004, springStiffness=[100.0] * 33))
    run(["evaluate", path, path, "--json"])
    assert json.loads(capsys.readouterr().out)["rmse"] == 0.0



SPEED_KEYS = {
    "schema_version", "command", "scene", "delta", "frames", "simulated_frames", "vertices", "reference", "rows", "own",
    "requested_error", "recommended", "plot",
}  # fmt: skip
ROW_KEYS = {
    "integrator", "step", "ratio", "tolerance", "newton_iterations", "status", "runs", "ms_per_step",
    "seconds_per_simulated_second", "error", "max_error", "own", "pareto",
}  # fmt: skip
QUICK = ("--speed", "--steps", "10", "--budget", "1")


@pytest.fixture(scope="module")
def measured():
    """What is measured of the scene, once for all tests."""
    return precision.work_precision(load(even("nG", 20)), 11, 1.0)


@pytest.fixture
def path(tmp_path, monkeypatch, measured):
    """A scene that flags a stiffness, in the folder that is worked in; it was measured before."""

    def work_precision(scene, frames, seconds, report):
        assert (frames, seconds) == (11, 1.0)
        return replace(measured, scene=scene.name)

    monkeypatch.setattr(precision, "work_precision", work_precision)
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path, even("nG", 20))
    return "scene.json"


def test_json_has_the_keys_of_speed_and_says_nothing_else(path, capsys):
    assert run(["evaluate", path, *QUICK, "--error", "0.5", "--json"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out, parse_constant=refuse)
    assert (set(found), err.replace(f"{COMPILING}\n", "")) == (SPEED_KEYS, "")  # the line of a first use
    assert {frozenset(row) for row in found["rows"]} == {frozenset(ROW_KEYS)}
    assert set(found["reference"]) == {"integrator", "step", "order", "error"}
    assert (found["frames"], found["simulated_frames"], found["vertices"], found["delta"]) == (11, 11, 16, 0.02)
    assert len(found["rows"]) == len(grid(load(path)))
    assert [row for row in found["rows"] if row["own"]] == [found["own"]]
    assert [found["own"][key] for key in ("integrator", "newton_iterations", "step")] == ["implicit", 1, 0.02]
    near = [row for row in found["rows"] if row["status"] == "done" and row["error"] <= 0.5]
    assert found["recommended"] == min(near, key=lambda row: row["seconds_per_simulated_second"])
    assert (found["requested_error"], found["plot"]) == (0.5, None)


def test_the_table_marks_rows_and_says_what_a_fit_must_use(path, capsys):
    assert run(["evaluate", path, *QUICK, "--error", "0.5"]) == 0
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert err.replace(f"{COMPILING}\n", "") == ""
    assert lines[0].split()[:2] == ["integrator", "step"]
    assert [line for line in lines if line.startswith("symplectic  h/4 = 5 ms")]
    assert out.count("the scene's own") == 1
    assert "Pareto-best" in out
    assert re.search(r"^\d+ more, with other tolerances", out, re.MULTILINE)
    assert run(["evaluate", path, *QUICK, "-v"]) == 0
    verbose = capsys.readouterr().out
    assert ("more, with other tolerances" in verbose, "1e-08" in verbose) == (False, True)
    assert run(["evaluate", path, *QUICK, "-q"]) == 0
    assert capsys.readouterr() == ("", "")
    assert "root mean square over all vertices and 11 frames; that motion is known to" in out
    assert "cheapest within 500 mm: " in out
    assert "the editor plays this scene with implicit steps of h = 20 ms, tolerance 1e-05, 1 Newton iteration" in out
    assert "a fit must use the same (integrationMethod 2, delta 0.02)" in out


def test_an_error_that_none_reaches_is_said(path, capsys):
    assert run(["evaluate", path, *QUICK, "--error", "1e-12"]) == 0
    assert "warning: no setting comes within 0.001 nm; the nearest is " in capsys.readouterr().err
    assert run(["evaluate", path, *QUICK, "--error", "1e-12", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["recommended"] is None


def test_what_diverged_is_listed(tmp_path, capsys):
    stiff = write_scene(tmp_path, trial("nn", 10, springStiffness=[2e3] * 33))
    assert run(["evaluate", stiff, *QUICK]) == 0
    assert re.search(r"^diverged: explicit h, h/2", capsys.readouterr().out, re.MULTILINE)


def test_a_reference_that_is_not_known_to_the_end_is_said(path, capsys, monkeypatch, measured):
    less = replace(measured, scene="scene.json", reference=measured.reference.upto(6))
    monkeypatch.setattr(precision, "work_precision", lambda *_: less)
    assert run(["evaluate", path, *QUICK]) == 0
    assert "frames from 6 on (t = 0.12 s) are not judged" in capsys.readouterr().err
    assert run(["evaluate", path, *QUICK, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["frames"], found["simulated_frames"]) == (6, 11)


def test_a_picture_is_written(path, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed; no picture is drawn")
    assert run(["evaluate", path, *QUICK, "--plot", "speed.svg", "--error", "0.01"]) == 0
    assert capsys.readouterr().err.endswith("diagram → speed.svg\n")
    assert (tmp_path / "speed.svg").read_bytes().startswith(b"<?xml")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["scene.json", "speed.svg"]
