"""`clothfit estimate`: the file it writes, what it says, exit codes, interrupts, pipes, the log."""

import io
import json
import math
import re
import signal
import subprocess
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import DOCS
from helpers.scenes import (
    cloth,
    document,
    environment,
    even,
    names,
    needs_full_disk,
    started,
    tokens,
    trial,
    write_scene,
)
from helpers.strangers import small, with_finer_steps

from clothfit.cli.common.console import Console
from clothfit.cli.parts.estimate_results import KEYS as LOGGED
from clothfit.cli.parts.estimate_results import FitLog, earlier
from clothfit.fit.holdout import Judged
from clothfit.fit.options import Request
from clothfit.motion.motion import save_motion
from clothfit.optimise.progress import Progress
from clothfit.scene.scene import load, save

pytestmark = pytest.mark.slow

KEYS = {
    "schema_version", "command", "scene", "status", "method", "cost", "rmse", "frames", "evaluations", "seconds",
    "ladder", "step", "parameters", "output", "warnings", "rank", "sigma", "prior", "holdout", "memory", "windows",
    "samples", "objective", "correlations", "travel", "relative_rmse", "verdict", "single_steps", "baselines", "pins",
    "hints", "registration", "markers", "correspondence", "fabric",
}  # fmt: skip
DOWNHILL = "--method l-bfgs-b --start 1"  # begins at the start, and takes its time
ENDLESS = f"{DOWNHILL} --rmse 0 --max-evaluations 1000000 --prior none --json"
LONG = trial("LL", 60, 8, 8)  # takes minutes to fit to the last digit


@pytest.fixture
def scene(here):
    """A small scene whose masses are flagged."""
    return load(write_scene(here, trial("Ln")))


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


def test_the_fitted_scene_goes_beside_the_scene_and_is_described(scene, told):
    summary, err = told("estimate scene.json")
    assert names() == ["scene.fitted.json", "scene.json"]
    assert set(summary) == KEYS
    assert (summary["schema_version"], summary["status"], summary["method"]) == (1, "converged", "auto")
    assert summary["output"] == "scene.fitted.json"
    (block,) = summary["parameters"]
    own = {"object": 0, "name": "mass", "mode": "L", "count": 16, "at_bound": [], "unidentifiable": [0, 3]}
    none = {"groups": None, "modes": None, "values": None, "hardly_shown": []}  # the first three are of factors
    ends = {name: block[name] for name in ("start", "interval")}
    assert block == {**own, **none, "unmoved": [], "bounds": [], "at_least": False, "least": [], **ends}
    assert block["start"][0] == scene.cloths[0].mass[0]  # of a held vertex
    assert [i for i, ends in enumerate(block["interval"]) if ends is None] == [0, 3]
    assert all(len(ends) == 2 and 0 < ends[0] <= ends[1] for ends in block["interval"] if ends)
    assert (summary["rank"], summary["prior"], summary["holdout"], summary["ladder"]) == (14, None, None, [])
    assert not re.search("values +RMSE", err)
    assert summary["sigma"] < 1e-8  # m, without noise
    fitted, truth = (found.cloths[0].mass for found in (load("scene.fitted.json"), scene))
    np.testing.assert_allclose(np.delete(fitted, [0, 3]), np.delete(truth, [0, 3]), rtol=1e-4)  # RMSE below 1e-8 m
    first, second = err.splitlines()[-2:]
    outcome = r"converged: RMSE [\d.]+ nm over 20 frames, \d+ evaluations? in [\d.]+ s → scene.fitted.json"
    assert re.fullmatch(outcome, first)
    known = (
        r"objects\[0\] mass: 16 values, ±[\d.e+-]+ % \(median 95 % interval, for this model only\), "
        "2 not shown by the motion: 0, 3"
    )
    assert re.fullmatch(known, second)


@pytest.mark.usefixtures("scene")
def test_a_noisy_fit_tells_intervals_prior_and_holdout(said, told):
    assert said("target scene.json --noise 0.001 -o noisy.npz -q")[0] == 0
    summary, err = told("estimate scene.json --target noisy.npz --holdout 0.25 --prior 0.3")
    assert (summary["frames"], summary["prior"]) == (15, [{"object": 0, "name": "mass", "tau": 0.3}])
    held = summary["holdout"]
    assert (held["of"], held["fraction"], held["observations"]) == ("frames", 0.25, 80)
    assert 1e-3 < held["rmse"] < 3e-3  # noise of 1 mm in three directions
    assert summary["sigma"] == pytest.approx(1e-3, rel=0.2)  # of some 600 residuals: 3 % is one standard error
    kept = r"\nholdout: RMSE [\d.]+ mm over 80 positions kept out of the fit, [\d.]+ m?m by the best still picture"
    assert re.search(kept, err)
    assert re.search(r"\nobjects\[0\] mass: 16 values, ±[\d.]+ % \(median 95 % interval, for this model only\), ", err)


def test_a_value_at_a_bound_is_a_warning(here, said):
    write_scene(here, even("nG", springStiffness=[3e4] * 33, fit={"bounds": {"stiffness": [1, 1e4]}}))
    _, _, err = said("estimate scene.json --start 10")
    assert "warning: objects[0] stiffness: 1 of 1 at a bound, " in err
    widen = "--bounds stiffness=:1e+07 widens it"
    assert f"hint: objects[0] stiffness: values lie at the upper bound of the fit; {widen}\n" in err


def test_a_spent_budget_is_code_5_and_the_best_is_written_in_place(scene, told):
    old = Path("scene.json").read_text()
    summary, _ = told(f"estimate scene.json --in-place --max-evaluations 3 {DOWNHILL}", code=5)
    assert (summary["status"], summary["evaluations"]) == ("limit", 3)
    assert (summary["output"], names()) == ("scene.json", ["scene.json"])
    found = differing(old, Path("scene.json").read_text())
    assert found
    assert set(found) <= set(span(old, "vertMass"))


def test_where_no_evaluation_ends_in_time_the_start_is_written(scene, said):
    code, _, err = said("estimate scene.json --budget 1e-9 -o fitted.json")
    assert (code, re.search(r"\binf\b", err)) == (5, None)
    assert "the time was used up before the first step, so the values are those of the start" in err
    assert load("fitted.json").cloths[0].stiffness.tolist() == scene.cloths[0].stiffness.tolist()


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
    ("--budget 2m", {"time_limit": 120.0}),
    ("--bounds stiffness=1:1e6 --bounds mass=:2", {"bounds": {"stiffness": (1.0, 1e6), "mass": (None, 2.0)}}),
    ("--model R", {"model": "R"}),
    ("--substeps 4", {"substeps": 4}),
    ("--substeps auto", {"substeps": "auto"}),
    ("--keep-step", {"keep_step": True}),
    ("--windows 9", {"windows": 9}),
    *((f"--{name.replace('_', '-')}", {name: True}) for name in ("fit_time", "fit_placement", "fit_scale",
                                                                "keep_markers")),
]  # fmt: skip


@pytest.mark.parametrize(("options", "expected"), ASKED, ids=[options for options, _ in ASKED])
def test_an_option_is_that_of_the_fit_and_no_other(folder, fits, said, options, expected):
    Path("t.npz").write_bytes(still(load("scene.json")))
    assert said(f"estimate scene.json --target t.npz {options} -q")[0] == 0
    (asked,) = fits
    plain = {name: value for name, value in vars(Request()).items() if name not in ("observer", "checkpoint")}
    plain["objective"] = {"position": 1.0}
    assert {name: value for name, value in vars(asked.options).items() if plain.get(name, value) != value} == expected
    assert len(asked.targets[0].times) == 5


def still(scene):
    """The file of a motion in which nothing moves."""
    file = io.BytesIO()
    x = np.repeat(scene.cloths[0].positions[None], 5, axis=0)
    np.savez(file, positions=x, times=0.02 * np.arange(5))
    return file.getvalue()


def test_targets_come_with_their_scenes_and_the_start_from_a_file_or_a_number(folder, fits, said):
    write_scene(folder, trial("nn", 5, windVel={"x": 2.0, "y": 0.0, "z": 0.0}), "windy.json")
    for name in ("still@1.npz", "wind.npz", "wind@1.npz"):
        Path(name).write_bytes(still(load("scene.json")))
    both = "--target still@1.npz --target wind.npz@windy.json --target wind@1.npz@windy.json"
    for start in ("windy.json", "0.03"):
        assert said(f"estimate scene.json {both} --start {start} -q")[0] == 0
    (own, *others), second = fits[0].targets, fits[1].start
    assert len(own.times) == 5
    assert [(len(motion.times), scene.name) for motion, scene in others] == [(5, "windy.json")] * 2
    assert (fits[0].start.name, second) == ("windy.json", 0.03)


@pytest.mark.parametrize(
    ("given", "needed"),
    [("", "--up z --scale 0.01 would fit; --up y --scale 1.0 fits it as it is"), ("--up z", "--scale 0.01 would fit"),
     ("--up y --scale 1", ""), ("--up z --scale 0.01", ""), ("--fit-scale", "")],
)  # fmt: skip
def test_another_unit_or_axes_than_were_assumed_is_no_target(folder, fits, said, given, needed):
    """What is said of the file counts, and what is looked for may be anything: then the fit begins."""
    x, y, z = np.moveaxis(load("scene.json").cloths[0].positions, -1, 0)
    np.savez("t.npz", positions=np.repeat(100 * np.stack([x, -z, y], axis=-1)[None], 5, axis=0))
    code, _, err = said(f"estimate scene.json --target t.npz {given}")
    assert (code, len(fits)) == ((3, 0) if needed else (0, 1))
    assert not needed or needed in err.splitlines()[-1]


@pytest.mark.parametrize(
    ("name", "fitted"),
    [("a.txt", "a.fitted.txt"), ("a.v2.json", "a.v2.fitted.json"), ("plain", "plain.fitted"),
     ("ä b.json", "ä b.fitted.json")],
)  # fmt: skip
@pytest.mark.usefixtures("fits")
def test_the_default_name_keeps_stem_and_suffix_and_quiet_is_quiet(here, said, name, fitted):
    write_scene(here, even("nG", 5, 3, 3), name)
    assert said(f"estimate '{name}' -q") == (0, "", "")
    assert names() == sorted([name, fitted])
    assert Path(name).read_bytes() == Path(fitted).read_bytes()


# --- the round trip


@pytest.mark.parametrize(
    ("layout", "settings"), [({}, "Ln"), ({"indent": 2}, "nL"), ({"separators": (",", ":")}, "Gn"), ({}, "lG")]
)
def test_only_flagged_numbers_differ_in_the_text(here, said, layout, settings):
    strange = [1e-7, -0.0, 12345678901234567890, None, {"vertMass": [1.5]}]
    extra = {"note": "3.0e1 [1, 2] \"vertMass\": {", "x": strange}
    flagged = cloth(3, 3, optimizationSettings=settings, **extra)
    write_scene(here, document(cloth(3, 3, **extra), flagged, optimizationIterations=5, unknown=extra), **layout)
    said("estimate scene.json -q --max-evaluations 2 --start 7")
    old, new = (Path(name).read_bytes().decode() for name in ("scene.json", "scene.fitted.json"))
    places = {"vertMass": span(old, "vertMass", 2), "springStiffness": span(old, "springStiffness", 1)}
    allowed = [set(part) for part, letter in zip(places.values(), settings, strict=True) if letter != "n"]
    found = differing(old, new)
    assert found
    assert set(found) <= set().union(*allowed)


# --- divergence


def test_values_that_all_diverge_are_code_4_and_no_file(here, told):
    scene = load(write_scene(here, even("nG", 40, integrationMethod=0, delta=1.0, damping=1e3)))
    still = np.broadcast_to(scene.cloths[0].positions, (40, 16, 3))
    np.savez("t.npz", positions=still, times=np.arange(40.0))
    summary, err = told("estimate scene.json --target t.npz", code=4)
    assert (summary["status"], summary["output"]) == ("diverged", None)
    assert "no values that were tried gave a simulation that stays finite; nothing is written" in err.splitlines()[-1]
    assert names() == ["scene.json", "t.npz"]


# --- models and the time step


@pytest.mark.parametrize("kept", [None, 3e-3])
@pytest.mark.usefixtures("folder")
def test_the_ladder_is_in_the_summary_and_printed(told, monkeypatch, found, kept):
    rows = [Judged("F", 1, 2e-3, kept, 0.5), Judged("L", 33, 1e-3, kept, 4.0)]
    fit = replace(found, ladder=rows)
    monkeypatch.setattr("clothfit.fit.estimate.by_request", lambda scene, *given, **more: replace(fit, scene=scene))
    summary, err = told("estimate scene.json")
    assert summary["ladder"] == [asdict(each) for each in rows]
    lines = [re.split("  +", line.strip()) for line in err.splitlines()]
    begin = lines.index(["model", "values", "RMSE", *["kept out"] * bool(kept), "seconds"])
    assert lines[begin + 1] == ["F one factor", "1", "2 mm", *["3 mm"] * bool(kept), "0.5"]
    assert lines[begin + 2][1:3] == ["33", "1 mm"]


@pytest.mark.usefixtures("here")
def test_the_step_that_is_chosen_is_in_the_summary_and_in_the_file(told):
    made = small("nF", 24, method=3)
    save(made, "scene.json")
    save_motion(with_finer_steps(made, 8), "t.npz")
    summary, err = told("estimate scene.json --target t.npz")
    step = summary["step"]
    assert set(step) == {"delta", "integrator", "substeps", "tried"}
    assert all(set(each) == {"substeps", "integrator", "rmse", "seconds"} for each in step["tried"])
    assert step["substeps"] > 1
    assert (step["integrator"], step["delta"]) == ("bdf2", 0.02 / step["substeps"])
    fitted = load(summary["output"])
    assert (fitted.delta, fitted.method) == (step["delta"], 3)
    coarse, *finer = step["tried"]
    assert (coarse["substeps"], coarse["integrator"]) == (1, "implicit")
    assert [each["substeps"] for each in finer if each["integrator"] == "bdf2"] == [1, 2, 4]
    assert f"time step: {1000 * step['delta']:g} ms by bdf2, {step['substeps']} steps to a frame of the target" in err


# --- processes


def test_a_chain_of_pipes(scene):
    text = Path("scene.json").read_bytes()
    motion = started("target", "-", "-q", input=text)
    Path("t.npz").write_bytes(motion.stdout)
    fitted = started("estimate", "-", "-q", "--json", "--target", "t.npz", "--start", "0.02", input=text)
    report = started("evaluate", "scene.json", "-", "--json", "--steps", "30", input=fitted.stdout)
    assert [done.returncode for done in (motion, fitted, report)] == [0, 0, 0]
    assert [done.stderr for done in (motion, report)] == [b"", b""]
    assert json.loads(report.stdout)["rmse"] < 1e-7  # the fit ends below 1e-8
    assert b"\x1b" not in fitted.stderr
    assert set(json.loads(fitted.stderr)) == KEYS  # the scene goes to standard output
    assert set(differing(text.decode(), fitted.stdout.decode())) <= set(span(text.decode(), "vertMass"))


@pytest.mark.parametrize("end", [signal.SIGTERM, "input"])
def test_a_fit_that_is_asked_to_end_is_code_130_and_the_best_so_far_is_written_whole(here, end):
    write_scene(here, LONG)
    log, call = here / "log.jsonl", ["estimate", "scene.json", *ENDLESS.split(), "--log", "log.jsonl"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": environment()}
    more = ["--end-with-input"] * (end == "input")
    with subprocess.Popen([sys.executable, "-m", "clothfit", *call, *more], **pipes) as process:
        process.stdin.write(b"what comes on its input is ignored\n")
        process.stdin.flush()
        while not log.exists() or log.read_text("utf-8").count("\n") < 3:
            assert process.poll() is None
            time.sleep(0.02)
        if end != "input":
            process.send_signal(end)
        out, err = process.communicate(timeout=100)  # closes its input
    summary = json.loads(out)
    assert (process.returncode, summary["status"]) == (130, "interrupted"), err.decode()
    assert names() == ["log.jsonl", "scene.fitted.json", "scene.json"]
    assert summary["evaluations"] >= 3
    assert (load("scene.fitted.json").cloths[0].stiffness != 1.0).all()
    assert b"Traceback" not in err


# --- the log: JSON lines that others can follow

LOG = "estimate scene.json --method gauss-newton --start 0.05 -q"


def lines(name="fit.jsonl"):
    """The iterations of a log, and its summary."""
    *iterations, last = map(json.loads, Path(name).read_text("utf-8").splitlines())
    return iterations, last["summary"]


@pytest.mark.usefixtures("scene")
def test_a_log_begins_anew_has_each_iteration_and_the_summary_and_changes_no_bit_of_the_fit(said, told):
    Path("scene.jsonl").write_text('{"iteration": 99, "evaluations": 0}\n')
    printed, _ = told(f"{LOG} -o a.json --log {{stem}}.jsonl")
    iterations, summary = lines("scene.jsonl")
    assert summary == printed
    assert len(iterations) > 3
    assert all(set(one) == set(LOGGED) for one in iterations)
    columns = {key: [one[key] for one in iterations] for key in LOGGED}
    for key in ("iteration", "evaluations", "seconds"):
        assert columns[key] == sorted(columns[key])
    assert set(columns["iteration"]) == set(range(columns["iteration"][-1] + 1))
    assert columns["step"][0] is None  # nothing has changed at the start
    assert all(value > 0 for value in columns["step"][1:])
    assert columns["cost"][-1] == summary["cost"]
    assert set(columns["stage"]) == {"gauss-newton"}
    assert columns["frames"] == [20] * len(iterations)
    assert min(columns["window"]) < columns["window"][-1] == 20  # short windows come first
    assert columns["rmse"][-1] == pytest.approx(math.sqrt(columns["cost"][-1] / (16 * 20)))
    assert columns["evaluations"][-1] <= summary["evaluations"]
    assert said(f"{LOG} -o b.json")[0] == 0
    assert Path("a.json").read_bytes() == Path("b.json").read_bytes()


@pytest.mark.usefixtures("scene")
def test_a_resumed_fit_goes_on_with_its_log(said):
    some = f"{LOG.removesuffix(' -q')} --checkpoint fit.checkpoint --log fit.jsonl"
    code, _, err = said(f"{some} --max-evaluations 12")
    assert (code, "to go on, repeat the command with --resume and more --max-evaluations: fit.ch" in err) == (5, True)
    before, _ = lines()
    assert said(f"{some} --resume")[0] == 0
    assert Path("fit.checkpoint").exists()
    after, summary = lines()
    assert summary["status"] == "converged"
    kept = [one for one in after if one in before]
    assert len(kept) >= len(before) - 1  # the last line may be of the point where the fit goes on
    assert len(after) > len(before)
    for key in ("iteration", "evaluations"):
        values = [one[key] for one in after]
        assert values == sorted(values)


def test_only_iterations_are_taken_from_an_earlier_log():
    good = {"iteration": 0, "evaluations": 3}
    Path("x.jsonl").write_text(f'{json.dumps(good)}\n{{"summary": {{}}}}\n[1]\nnot JSON\n{{"iteration": 1, "eval')
    assert earlier("x.jsonl") == [good]
    assert earlier("absent") == []


def test_every_line_is_there_at_once_and_what_is_not_finite_is_null():
    log = FitLog("fit.jsonl", [], Console())
    for iteration in range(3):
        log.record(Progress(iteration + 1, 10, np.inf, np.nan, 0.5, iteration))
        assert Path("fit.jsonl").read_text().count("\n") == iteration + 1
    log.end({"rmse": float("nan")})
    (first, *_), summary = lines()
    assert (first["cost"], first["rmse"], summary) == (None, None, {"rmse": None})


@needs_full_disk
@pytest.mark.usefixtures("scene")
def test_a_full_disk_ends_the_log_and_not_the_fit(said):
    code, _, err = said(f"{LOG.removesuffix(' -q')} --log /dev/full")
    assert (code, "converged" in err) == (0, True)
    assert err.count("warning: the log ends here: /dev/full: No space left on device") == 1


def test_the_page_tells_all_keys_of_a_log():
    page = (DOCS / "progress.md").read_text("utf-8")
    rows = re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)
    assert set(LOGGED) | {"summary"} == {key for row in rows for key in re.findall(r"`(\w+)`", row)}
    shown = [json.loads(line) for line in re.findall(r'^{"iteration.*', page, re.MULTILINE)]
    assert all(tuple(line) == LOGGED for line in shown)
