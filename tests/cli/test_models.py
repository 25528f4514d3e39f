"""`clothfit estimate --model`, `--substeps` and `--keep-step`: the files, summaries and messages of fits from coarse to
fine.
"""

import json
import re

import numba
import pytest
from helpers.scenes import trial, write_scene
from helpers.strangers import small, with_finer_steps

from clothfit.cli.program import run
from clothfit.fit.estimate import record_target
from clothfit.many.job import EXIT_CODES
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import save_motion
from clothfit.scene.scene import load, save

pytestmark = [
    pytest.mark.slow,  # compiles a fit
    pytest.mark.skipif(numba.config.DISABLE_JIT, reason="hundreds of simulations need compilation"),
]

LADDER_KEYS = {"model", "values", "rmse", "holdout_rmse", "seconds"}
STEP_KEYS = {"delta", "integrator", "substeps", "tried"}
TRIED_KEYS = {"substeps", "integrator", "rmse", "seconds"}


def refuse(constant):
    raise AssertionError(f"{constant} is not JSON")


def estimated(capsys, *arguments):
    """Exit code, summary and messages of a fit in this process."""
    code = run(["estimate", *arguments, "--no-intervals", "--json"])
    out, err = capsys.readouterr()
    return code, json.loads(out, parse_constant=refuse), err


@pytest.fixture
def given(tmp_path):
    """What writes a scene and a motion of it by finer steps, and gives the paths."""

    def write(letters="nL", method=2):
        scene = small(letters, 24, method=method)
        save(scene, tmp_path / "scene.json")
        save_motion(with_finer_steps(scene, 8), tmp_path / "t.npz")
        return str(tmp_path / "scene.json"), "--target", str(tmp_path / "t.npz")

    return write


# --- models


@pytest.mark.parametrize("model", ["M", "G"])
def test_a_model_takes_the_place_of_the_flags(given, capsys, model):
    path, *target = given("nR")
    code, summary, _ = estimated(capsys, path, *target, "--model", model)
    (block,) = summary["parameters"]
    assert (code, block["name"], block["mode"]) == (0, "stiffness", model)
    letters = [cloth.settings for cloth in load(summary["output"]).cloths]
    assert letters == ["nR"]  # the flags of the file are not what was fitted


def test_the_ladder_is_in_the_summary_and_printed(given, capsys):
    path, *target = given()
    code, summary, said = estimated(capsys, path, *target)
    found = summary["ladder"]
    assert code == 0
    assert [each["model"] for each in found] == ["F", "R", "M", "L"]
    assert all(set(each) == LADDER_KEYS and each["holdout_rmse"] is None for each in found)
    errors, counts = ([each[key] for each in found] for key in ("rmse", "values"))
    assert errors == sorted(errors, reverse=True)
    assert counts == sorted(counts)
    assert counts[-1] == 33
    assert summary["rmse"] == pytest.approx(errors[-1])
    begin = said.splitlines().index(f"{'model':<18}{'values':>8}{'RMSE':>12}{'':>12}{'seconds':>10}".rstrip())
    rows = said.splitlines()[begin + 1 : begin + 5]
    assert [row.split()[0] for row in rows] == ["F", "R", "M", "L"]
    assert re.match(r"F one factor +1 +[\d.]+ mm +[\d.]+$", rows[0])


def test_what_is_kept_out_is_in_the_ladder(given, capsys):
    path, *target = given()
    code, summary, said = estimated(capsys, path, *target, "--model", "auto")
    assert code == 0
    assert all(each["holdout_rmse"] > 0 for each in summary["ladder"])
    assert summary["parameters"][0]["mode"] in [each["model"] for each in summary["ladder"]]
    assert re.search(r"^model +values +RMSE +kept out +seconds$", said, re.MULTILINE)


def test_one_factor_is_enough_for_a_truth_by_one_factor(tmp_path, capsys):
    truth = small("nL", 24, springStiffness=[40.0] * 33)
    save(small("nL", 24), tmp_path / "scene.json")
    save_motion(degrade(record_target(truth), noise=1e-3, seed=1), tmp_path / "t.npz")
    arguments = str(tmp_path / "scene.json"), "--target", str(tmp_path / "t.npz")
    code, summary, _ = estimated(capsys, *arguments, "--model", "auto")
    assert (code, summary["parameters"][0]["mode"]) == (0, "F")
    # 360 positions with noise of 1 mm, of a motion of decimetres that follows the stiffness
    assert summary["parameters"][0]["values"] == [pytest.approx(2.0, rel=0.02)]


def test_the_ladder_of_a_fit_that_needs_none_is_empty(tmp_path, capsys):
    path = write_scene(tmp_path, trial("nG", 5))
    code, summary, err = estimated(capsys, path)
    assert (code, summary["ladder"]) == (0, [])
    assert "values        RMSE" not in err


# --- the time step


def test_the_step_that_is_chosen_is_in_the_summary_and_in_the_file(given, capsys):
    path, *target = given("nF", method=3)
    code, summary, err = estimated(capsys, path, *target)
    step = summary["step"]
    assert code == 0
    assert set(step) == STEP_KEYS
    assert all(set(each) == TRIED_KEYS for each in step["tried"])
    assert step["substeps"] > 1
    assert (step["integrator"], step["delta"]) == ("bdf2", 0.02 / step["substeps"])
    fitted = load(summary["output"])
    assert (fitted.delta, fitted.method) == (step["delta"], 3)
    assert [each["substeps"] for each in step["tried"]] == [2**i for i in range(len(step["tried"]))]
    said = f"time step: {1000 * step['delta']:g} ms by bdf2, {step['substeps']} steps to a frame of the target"
    assert said in err


def test_the_step_is_kept_where_that_is_asked(given, capsys):
    path, *target = given("nF", method=3)
    code, summary, _ = estimated(capsys, path, *target, "--keep-step")
    assert code == 0
    assert summary["step"] == {"delta": 0.02, "integrator": "bdf2", "substeps": None, "tried": []}
    assert load(summary["output"]).delta == 0.02


def test_the_editors_step_is_kept_unless_another_is_asked_for(given, capsys):
    path, *target = given("nF", method=2)
    code, summary, _ = estimated(capsys, path, *target)
    assert (code, summary["step"]["tried"], load(summary["output"]).method) == (0, [], 2)
    assert "time_step" in [hint["code"] for hint in summary["hints"]]
    code, finer, _ = estimated(capsys, path, *target, "--substeps", "auto")
    assert (code, finer["step"]["integrator"], load(finer["output"]).method) == (0, "bdf2", 3)
    assert finer["rmse"] < 0.1 * summary["rmse"]  # second order
    code, four, _ = estimated(capsys, path, *target, "--substeps", "4")
    assert (code, four["step"]["substeps"], four["step"]["delta"]) == (0, 4, 0.005)
    # the guard of steps of 10 ms makes the cost jump at its lowest point, which then is no minimum by the gradient
    code, two, _ = estimated(capsys, path, *target, "--substeps", "2")
    assert (code, two["step"]["substeps"], two["step"]["delta"]) == (EXIT_CODES[two["status"]], 2, 0.01)
    assert finer["rmse"] < four["rmse"] < two["rmse"] < summary["rmse"]
