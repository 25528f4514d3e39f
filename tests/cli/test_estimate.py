"""`clothfit estimate`: the file it writes, the exit codes, interrupts, pipes, the live bar, the reference scene."""

import io
import json
import os
import pty
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
from helpers.paths import SIDE
from helpers.scenes import cloth, document, environment, even, names, started, tokens, trial, write_scene
from helpers.strangers import small, with_finer_steps

from clothfit.cli.program import run
from clothfit.fit.estimate import record_target
from clothfit.fit.options import FitOptions
from clothfit.motion.motion import load_motion, save_motion
from clothfit.scene.scene import load, save

pytestmark = [
    pytest.mark.slow,  # starts processes
    pytest.mark.skipif(numba.config.DISABLE_JIT, reason="hundreds of simulations need compilation"),
]

KEYS = {
    "schema_version", "command", "scene", "status", "method", "cost", "rmse", "frames", "evaluations", "seconds",
    "ladder", "step", "parameters", "output", "warnings", "rank", "sigma", "prior", "holdout", "memory", "windows",
    "samples", "objective", "correlations", "travel", "relative_rmse", "verdict", "hints", "registration", "markers",
}  # fmt: skip
DOWNHILL = ["--method", "l-bfgs-b"]  # begins at the start, and takes its time
LONG = trial("LL", 60, 8, 8)  # takes minutes to fit to the last digit


def refuse(constant):
    raise AssertionError(f"{constant} is not JSON")


@pytest.fixture
def path(tmp_path):
    """A small scene whose masses are flagged."""
    return write_scene(tmp_path, trial("Ln"))


def estimated(capsys, *arguments):
    """Exit code, summary and messages of a fit in this process."""
    code = run(["estimate", *arguments, "--json"])
    out, err = capsys.readouterr()
    return code, json.loads(out, parse_constant=refuse), err


def differing(old, new):
    """Indices of the tokens in which two texts differ; the texts have equally many."""
    a, b = tokens(old), tokens(new)
    assert len(a) == len(b)
    return [i for i, (one, other) in enumerate(zip(a, b, strict=True)) if one != other]


def span(text, key, occurrence=0):
    """Indices of the tokens of the list after an occurrence of a key."""
    listed = tokens(text)
    start = [i for i, token in enumerate(listed) if token == f'"{key}"'][occurrence]
    return range(start, listed.index("]", start))


# --- the result


def test_the_fitted_scene_goes_beside_the_scene_and_is_described(path, tmp_path, capsys):
    code, summary, err = estimated(capsys, path)
    assert (code, names(tmp_path)) == (0, ["scene.fitted.json", "scene.json"])
    assert set(summary) == KEYS
    assert (summary["schema_version"], summary["status"], summary["method"]) == (1, "converged", "auto")
    assert summary["output"] == str(tmp_path / "scene.fitted.json")
    (block,) = summary["parameters"]
    told = {"object": 0, "name": "mass", "mode": "L", "count": 16, "at_bound": [], "unidentifiable": [0, 3]}
    none = {"groups": None, "modes": None, "values": None}  # they are of factors
    ends = {name: block[name] for name in ("start", "interval")}
    assert block == {**told, **none, "unmoved": [], "bounds": [], **ends}
    assert block["start"][0] == load(path).cloths[0].mass[0]  # of a held vertex
    assert [i for i, ends in enumerate(block["interval"]) if ends is None] == [0, 3]
    assert all(len(ends) == 2 and 0 < ends[0] <= ends[1] for ends in block["interval"] if ends)
    assert (summary["rank"], summary["prior"], summary["holdout"], summary["ladder"]) == (14, None, None, [])
    assert "values        RMSE" not in err
    assert summary["sigma"] < 1e-8  # m, without noise
    fitted, truth = (load(name).cloths[0].mass for name in (summary["output"], path))
    np.testing.assert_allclose(np.delete(fitted, [0, 3]), np.delete(truth, [0, 3]), rtol=1e-4)  # RMSE below 1e-8 m
    first, second = err.splitlines()[-2:]
    outcome = r"converged: RMSE [\d.]+ nm over 20 frames, \d+ evaluations? in [\d.]+ s → .*scene.fitted.json"
    assert re.fullmatch(outcome, first)
    told = r"objects\[0\] mass: 16 values, ±[\d.e+-]+ % \(median 95 % interval\), 2 not shown by the motion: 0, 3"
    assert re.fullmatch(told, second)


def test_a_noisy_fit_tells_intervals_prior_and_holdout(path, tmp_path, capsys):
    target = str(tmp_path / "noisy.npz")
    assert run(["target", path, "--noise", "0.001", "-o", target, "-q"]) == 0
    options = ["--target", target, "--holdout", "0.25", "--prior", "0.3"]
    code, summary, err = estimated(capsys, path, *options)
    assert (code, summary["frames"]) == (0, 15)
    assert summary["prior"] == [{"object": 0, "name": "mass", "tau": 0.3}]
    held = summary["holdout"]
    assert (held["of"], held["fraction"], held["observations"]) == ("frames", 0.25, 80)
    assert 1e-3 < held["rmse"] < 3e-3  # noise of 1 mm in three directions
    assert summary["sigma"] == pytest.approx(1e-3, rel=0.2)  # of some 600 residuals: 3 % is one standard error
    assert re.search(r"\nholdout: RMSE [\d.]+ mm over 80 positions kept out of the fit\n", err)
    assert re.search(r"\nobjects\[0\] mass: 16 values, ±[\d.]+ % \(median 95 % interval\), ", err)


def test_a_value_at_a_bound_is_a_warning(tmp_path, capsys):
    bounds = {"bounds": {"stiffness": [1, 1e4]}}
    made = write_scene(tmp_path, even("nG", springStiffness=[3e4] * 33, fit=bounds))
    run(["estimate", made, "--start", "10"])
    err = capsys.readouterr().err
    assert "warning: objects[0] stiffness: 1 of 1 at a bound, " in err
    widen = "--bounds stiffness=:1e+07 widens it"
    assert f"hint: objects[0] stiffness: values lie at the upper bound of the fit; {widen}\n" in err


def test_a_spent_budget_is_code_5_and_the_best_is_written(path, tmp_path, capsys):
    code, summary, _ = estimated(capsys, path, "--max-evaluations", "3", "--start", "1", *DOWNHILL)
    assert (code, summary["status"], summary["evaluations"]) == (5, "limit", 3)
    assert load(summary["output"]).cloths[0].mass.tolist() != load(path).cloths[0].mass.tolist()


def test_where_no_evaluation_ends_in_time_the_start_is_written(path, tmp_path, capsys):
    out = tmp_path / "fitted.json"
    assert run(["estimate", path, "--budget", "1e-9", "-o", str(out)]) == 5
    err = capsys.readouterr().err
    assert "limit: nothing fitted, no evaluation ended in time; the start, as it was → " in err
    assert not re.search(r"\binf\b", err)
    assert load(out).cloths[0].stiffness.tolist() == load(path).cloths[0].stiffness.tolist()


# --- without a fit: a recorder stands in its place

ASKED = [
    ("--method l-bfgs-b", {"method": "l-bfgs-b"}),
    ("--max-evaluations 7", {"max_evaluations": 7}),
    ("--rmse 1e-3", {"rmse": 1e-3}),
    ("--tolerance 1e-9", {"tolerance": 1e-9}),
    ("--objective position --objective velocity=0.01", {"objective": {"position": 1.0, "velocity": 0.01}}),
    ("--loss huber --loss-scale 0.02", {"loss": "huber", "loss_scale": 0.02}),
    ("--prior 0.3", {"prior": "0.3"}),
    ("--holdout 0.25 --holdout-of vertices", {"holdout": 0.25, "holdout_of": "vertices"}),
    ("--no-intervals", {"intervals": False}),
    ("--memory 200MB", {"memory": "200MB"}),
    ("--budget 2m", {"budget": 120.0}),
    ("--bounds stiffness=1:1e6 --bounds mass=:2", {"bounds": {"stiffness": (1.0, 1e6), "mass": (None, 2.0)}}),
    ("--model R", {"model": "R"}),
    ("--substeps 4", {"substeps": 4}),
    ("--substeps auto", {"substeps": "auto"}),
    ("--keep-step", {"keep_step": True}),
    ("--windows 9", {"windows": 9}),
    ("--fit-time", {"fit_time": True}),
    ("--fit-placement", {"fit_placement": True}),
    ("--fit-scale", {"fit_scale": True}),
    ("--keep-markers", {"keep_markers": True}),
]


@pytest.mark.parametrize(("options", "expected"), ASKED, ids=[options for options, _ in ASKED])
def test_an_option_is_that_of_the_fit_and_no_other(folder, fits, options, expected):
    (folder / "t.npz").write_bytes(still(load("scene.json")))
    assert run(["estimate", "scene.json", "--target", "t.npz", *options.split(), "-q"]) == 0
    (asked,) = fits
    plain = {name: value for name, value in vars(FitOptions()).items() if name[:3] != "on_" and name != "checkpoint"}
    plain["objective"] = {"position": 1.0}
    assert {name: value for name, value in vars(asked.options).items() if plain.get(name, value) != value} == expected
    assert len(asked.targets[0].times) == 5


def still(scene):
    """The file of a motion in which nothing moves."""
    file = io.BytesIO()
    x = np.repeat(scene.cloths[0].positions[None], 5, axis=0)
    np.savez(file, positions=x, times=0.02 * np.arange(5))
    return file.getvalue()


@pytest.mark.parametrize(
    ("name", "fitted"),
    [("a.txt", "a.fitted.txt"), ("a.v2.json", "a.v2.fitted.json"), ("plain", "plain.fitted"),
     ("ä b.json", "ä b.fitted.json")],
)  # fmt: skip
@pytest.mark.usefixtures("fits")
def test_the_default_name_keeps_stem_and_suffix_and_quiet_is_quiet(tmp_path, monkeypatch, capsys, name, fitted):
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path, even("nG", 5, 3, 3), name)
    assert run(["estimate", name, "-q"]) == 0
    assert names(tmp_path) == sorted([name, fitted])
    assert (tmp_path / name).read_bytes() == (tmp_path / fitted).read_bytes()
    assert capsys.readouterr() == ("", "")


# --- the round trip


@pytest.mark.parametrize(
    ("layout", "settings"), [({}, "Ln"), ({"indent": 2}, "nL"), ({"separators": (",", ":")}, "Gn"), ({}, "lG")]
)
def test_only_flagged_numbers_differ_in_the_text(tmp_path, layout, settings):
    strange = [1e-7, -0.0, 12345678901234567890, None, {"vertMass": [1.5]}]
    extra = {"note": "3.0e1 [1, 2] \"vertMass\": {", "x": strange}
    flagged = cloth(3, 3, optimizationSettings=settings, **extra)
    made = document(cloth(3, 3, **extra), flagged, optimizationIterations=5, unknown=extra)
    path = write_scene(tmp_path, made, **layout)
    run(["estimate", path, "-q", "--max-evaluations", "2", "--start", "7"])
    old, new = ((tmp_path / name).read_bytes().decode() for name in ("scene.json", "scene.fitted.json"))
    places = {"vertMass": span(old, "vertMass", 2), "springStiffness": span(old, "springStiffness", 1)}
    allowed = [set(part) for part, letter in zip(places.values(), settings, strict=True) if letter != "n"]
    found = differing(old, new)
    assert found
    assert set(found) <= set().union(*allowed)


def test_bytes_that_are_not_numbers_stay_too(tmp_path):
    text = json.dumps(trial("nG", 5, 3, 3), indent=1).replace("\n", "\r\n")
    text = text.replace('"delta": 0.02', '"delta":\t2.00e-2').replace("0.011", "0.0110000")
    (tmp_path / "scene.txt").write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert run(["estimate", str(tmp_path / "scene.txt"), "-q", "--start", "3", "--max-evaluations", "2"]) == 5
    new = (tmp_path / "scene.fitted.txt").read_bytes()
    assert new.startswith(b"\xef\xbb\xbf{\r\n")
    found = differing(text, new[3:].decode())
    assert found
    assert set(found) <= set(span(text, "springStiffness"))


# --- inputs


def test_start_and_target_from_files(path, tmp_path, capsys):
    save_motion(record_target(load(path)), str(tmp_path / "t.npz"))
    other = write_scene(tmp_path, trial("nn", vertMass=[0.03] * 16), "start.json")
    guess = write_scene(tmp_path, trial("Ln", vertMass=[0.02] * 16), "guess.json")
    results = []
    for options in (["--start", other], ["--start", "0.03"], []):
        code, summary, _ = estimated(capsys, guess, "--target", str(tmp_path / "t.npz"), *options)
        fixed = load(summary["output"]).cloths[0].mass[[0, 3]].tolist()
        results.append((code, summary["status"], fixed))
    assert results == [(0, "converged", [0.03] * 2)] * 2 + [(0, "converged", [0.02] * 2)]


def test_several_targets_each_with_its_scene(tmp_path, monkeypatch, capsys):
    guess = write_scene(tmp_path, even("GG", vertMass=[0.03] * 16, springStiffness=[20.0] * 33), "guess.json")
    windy = write_scene(tmp_path, even("nn", windVel={"x": 2.0, "y": 0.0, "z": 0.0}), "windy.json")
    save_motion(record_target(load(even("nn"))), str(tmp_path / "still@1.npz"))
    save_motion(record_target(load(windy)), str(tmp_path / "wind.npz"))
    still, wind = str(tmp_path / "still@1.npz"), f"{tmp_path / 'wind.npz'}@{windy}"
    code, summary, _ = estimated(capsys, guess, "--target", still, "--target", wind)
    assert (code, summary["frames"]) == (0, 40)
    np.testing.assert_allclose(load(summary["output"]).cloths[0].stiffness, 30.0, rtol=1e-4)  # RMSE below 1e-8 m
    (tmp_path / "wind.npz").rename(tmp_path / "wind@1.npz")
    monkeypatch.chdir(tmp_path)
    assert run(["estimate", guess, "--target", "wind@1.npz@windy.json", "--max-evaluations", "1", "-q"]) in (0, 5)


def test_in_place_writes_into_the_scene(path, tmp_path, capsys):
    old = Path(path).read_text()
    code, summary, _ = estimated(capsys, path, "--in-place", "--max-evaluations", "2", *DOWNHILL)
    assert (code, summary["output"], names(tmp_path)) == (5, path, ["scene.json"])
    found = differing(old, Path(path).read_text())
    assert found
    assert set(found) <= set(span(old, "vertMass"))


# --- divergence


def test_a_truth_that_diverges_is_code_4(tmp_path, capsys):
    path = write_scene(tmp_path, even("nG", 60, integrationMethod=0, delta=0.004, springStiffness=[1e3] * 33))
    assert run(["estimate", path]) == 4
    assert "diverged at step" in capsys.readouterr().err.splitlines()[-1]
    assert names(tmp_path) == ["scene.json"]


def test_values_that_all_diverge_are_code_4_and_no_file(tmp_path, capsys):
    path = write_scene(tmp_path, even("nG", 40, integrationMethod=0, delta=1.0, damping=1e3))
    still = np.broadcast_to(load(path).cloths[0].positions, (40, 16, 3))
    np.savez(tmp_path / "t.npz", positions=still, times=np.arange(40.0))
    code, summary, err = estimated(capsys, path, "--target", str(tmp_path / "t.npz"))
    assert (code, summary["status"]) == (4, "diverged")
    assert "no values that were tried gave a simulation that stays finite; nothing is written" in err.splitlines()[-1]
    assert names(tmp_path) == ["scene.json", "t.npz"]


# --- processes


def test_a_chain_of_pipes(path):
    scene = Path(path).read_bytes()
    motion = started("target", "-", "-q", input=scene)
    target = Path(path).parent / "t.npz"
    target.write_bytes(motion.stdout)
    fitted = started("estimate", "-", "-q", "--json", "--target", str(target), "--start", "0.02", input=scene)
    report = started("evaluate", path, "-", "--json", "--steps", "30", input=fitted.stdout)
    assert [done.returncode for done in (motion, fitted, report)] == [0, 0, 0]
    assert [done.stderr for done in (motion, report)] == [b"", b""]
    assert json.loads(report.stdout)["rmse"] < 1e-7  # the fit ends below 1e-8
    assert b"\x1b" not in fitted.stderr
    assert set(json.loads(fitted.stderr)) == KEYS  # the scene goes to standard output
    assert set(differing(scene.decode(), fitted.stdout.decode())) <= set(span(scene.decode(), "vertMass"))


def on_a_terminal(arguments, until=None, number=None):
    """Run a fit with a terminal as standard error, and send it a signal once something is shown.

    Returns the exit code, the standard output and what the terminal showed.
    """
    leader, follower = pty.openpty()
    changes = {"TERM": "xterm-256color", "COLUMNS": "120"}
    call = [sys.executable, "-m", "clothfit", *arguments]
    process = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=follower, env=environment(**changes))
    os.close(follower)
    shown = b""
    while chunk := read(leader):
        shown += chunk
        if until is not None and until in shown:
            process.send_signal(number)
            until = None
    os.close(leader)
    out = process.stdout.read()
    process.stdout.close()
    return process.wait(timeout=50), out, shown.decode()


def read(leader):
    """What a terminal shows next; nothing at its end."""
    try:
        return os.read(leader, 4096)
    except OSError:
        return b""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_is_code_130_and_the_best_so_far_is_written_whole(tmp_path, number):
    path = write_scene(tmp_path, LONG)
    options = ["--start", "1", "--rmse", "0", "--max-evaluations", "1000000", "--json", *DOWNHILL]
    code, out, shown = on_a_terminal(["estimate", path, *options], b"evaluation 5", number)
    assert code == 130
    summary = json.loads(out, parse_constant=refuse)
    assert summary["status"] == "interrupted"
    assert summary["evaluations"] >= 5
    assert names(tmp_path) == ["scene.fitted.json", "scene.json"]
    stiffness = load(str(tmp_path / "scene.fitted.json")).cloths[0].stiffness
    assert (stiffness != 1.0).all()
    assert "Traceback" not in shown
    assert "fitting" in shown  # a live bar
    assert re.search(r"cost \d\.\d+e[+-]\d\d  RMSE [\d.]+ .?m  evaluation \d+", shown)
    assert "\x1b[?25h" in shown  # the cursor is back


# --- the reference scene


@pytest.mark.skipif(not SIDE.is_file(), reason="the reference scene is not beside the checkout")
def test_the_reference_scene_changes_in_flagged_stiffnesses_only(tmp_path, capsys):
    path = shutil.copyfile(SIDE, tmp_path / "side.txt")
    code, summary, _ = estimated(capsys, str(path))
    old, new = path.read_text(encoding="utf-8"), (tmp_path / "side.fitted.txt").read_text(encoding="utf-8")
    settings = [cloth.settings for cloth in load(str(path)).cloths]
    assert (settings, code, summary["status"]) == (["nL", "nn"], 0, "converged")
    found = differing(old, new)
    assert len(found) > 700
    assert set(found) <= set(span(old, "springStiffness"))
    assert run(["simulate", summary["output"], "-q"]) == 0
    assert load_motion(tmp_path / "side.fitted.motion.npz", load(str(path))).positions.shape == (100, 288, 3)


def test_the_options_have_the_defaults_of_the_library():
    from clothfit.base.limits import FIT_TOLERANCE
    from clothfit.cli.estimate import command
    from clothfit.fit import options as fit

    defaults = {option.name: option.default for option in command.params}
    assert (defaults["max_evaluations"], fit.FitOptions().rmse) == (fit.BUDGET, None)
    helps = {option.name: option.help for option in command.params if option.name in ("tolerance", "rmse")}
    assert f"[default: {FIT_TOLERANCE:g}]" in helps["tolerance"]
    assert f"[default: {fit.RMSE_TOLERANCE:g}, ".replace("1e-08", "1e-8") in helps["rmse"]


def test_the_clock_of_a_target_is_found_and_said(path, tmp_path, capsys):
    motion = record_target(load(path))
    save_motion(replace(motion, times=1.25 * motion.times + 0.01), tmp_path / "slow.npz")
    page = tmp_path / "page.html"
    code, summary, _ = estimated(
        capsys, path, "--target", str(tmp_path / "slow.npz"), "--fit-time", "--start", "0.02", "--report", str(page)
    )
    (clock,) = summary["registration"]
    assert code == 0
    assert clock["rate"] == pytest.approx(1.25, rel=1e-4)
    assert clock["offset"] == pytest.approx(0.01, abs=1e-4)
    assert clock["rotation"] == clock["translation"] == [0.0, 0.0, 0.0]
    told = page.read_text("utf-8").replace("\\u00b1", "±")  # as its table has it
    assert re.search(r'clock, rate","1\.250* ± ', told)



LADDER_KEYS = {"model", "values", "rmse", "holdout_rmse", "seconds"}
STEP_KEYS = {"delta", "integrator", "substeps", "tried"}
TRIED_KEYS = {"substeps", "integrator", "rmse", "seconds"}


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


def test_the_editors_step_is_kept_unless_another_is_asked_for(given, capsys):
    path, *target = given("nF", method=2)
    code, summary, _ = estimated(capsys, path, *target)
    assert (code, summary["step"]["tried"], load(summary["output"]).method) == (0, [], 2)
    assert "time_step" in [hint["code"] for hint in summary["hints"]]
    code, four, _ = estimated(capsys, path, *target, "--substeps", "4")
    assert (code, four["step"]["substeps"], four["step"]["delta"]) == (0, 4, 0.005)
    assert four["rmse"] < summary["rmse"]


SECONDS = 100


def test_a_fit_ends_with_its_input_and_keeps_the_best(tmp_path):
    path, log = write_scene(tmp_path, trial("LL", 60, 8, 8)), tmp_path / "log.jsonl"
    call = ["estimate", path, "--start", "1", "--rmse", "0", "--max-evaluations", "1000000", "--method", "l-bfgs-b",
            "--prior", "none", "--json", "--log", str(log), "--end-with-input"]  # fmt: skip
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-m", "clothfit", *call], **pipes, env=environment()) as process:
        process.stdin.write(b"what comes on its input is ignored\n")
        process.stdin.flush()
        while not log.exists() or log.read_text("utf-8").count("\n") < 3:
            assert process.poll() is None
        out, err = process.communicate(timeout=SECONDS)  # closes its input
    assert process.returncode == 130, err.decode()
    assert json.loads(out)["status"] == "interrupted"
    assert (load(str(tmp_path / "scene.fitted.json")).cloths[0].stiffness != 1.0).all()
