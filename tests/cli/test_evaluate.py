"""`clothfit evaluate`: the tables, the summary, what it is given."""

import json

import numba
import numpy as np
import pytest
from helpers.scenes import even, write_scene

from clothfit.cli.common.console import COMPILING
from clothfit.cli.program import run
from clothfit.evaluation.evaluate import evaluate
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
