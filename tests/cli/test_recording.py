"""`clothfit estimate --log`: JSON lines that others can follow."""

import json
import math
import re

import numpy as np
import pytest
from helpers.paths import DOCS
from helpers.scenes import needs_full_disk, trial, write_scene

from clothfit.cli.common.console import Console
from clothfit.cli.parts.estimate_results import KEYS, FitLog, earlier
from clothfit.cli.program import run
from clothfit.optimise.progress import Progress

pytestmark = pytest.mark.slow  # compiles a fit

FIT = ["--method", "gauss-newton", "--start", "0.05"]


@pytest.fixture
def path(tmp_path, monkeypatch):
    """The path of a scene to fit, alone in the current folder."""
    monkeypatch.chdir(tmp_path)
    return write_scene(tmp_path, trial("Ln", 20))


def lines(name="fit.jsonl"):
    """The iterations of a log, and its summary."""
    with open(name, encoding="utf-8") as file:
        *iterations, last = [json.loads(line) for line in file]
    return iterations, last["summary"]


def test_a_line_for_each_iteration_and_the_summary_that_json_prints(path, capsys):
    assert run(["estimate", path, *FIT, "--log", "fit.jsonl", "--json"]) == 0
    iterations, summary = lines()
    assert summary == json.loads(capsys.readouterr().out)
    assert len(iterations) > 3
    assert all(set(one) == set(KEYS) for one in iterations)
    columns = {key: [one[key] for one in iterations] for key in KEYS}
    assert columns["iteration"] == sorted(columns["iteration"])
    assert set(columns["iteration"]) == set(range(columns["iteration"][-1] + 1))
    assert columns["evaluations"] == sorted(columns["evaluations"])
    assert columns["seconds"] == sorted(columns["seconds"])
    assert columns["step"][0] is None  # nothing has changed at the start
    assert all(value > 0 for value in columns["step"][1:])
    assert columns["cost"][-1] == summary["cost"]
    assert set(columns["stage"]) == {"gauss-newton"}
    assert columns["frames"] == [20] * len(iterations)
    assert min(columns["window"]) < columns["window"][-1] == 20  # short windows come first
    assert columns["rmse"][-1] == pytest.approx(math.sqrt(columns["cost"][-1] / (16 * 20)))
    assert columns["evaluations"][-1] <= summary["evaluations"]


def test_a_log_changes_no_bit_of_a_fit_and_begins_anew(path):
    with open("scene.jsonl", "w", encoding="utf-8") as file:
        file.write('{"iteration": 99, "evaluations": 0}\n')
    assert run(["estimate", path, *FIT, "-q", "-o", "a.json"]) == 0
    assert run(["estimate", path, *FIT, "-q", "-o", "b.json", "--log", "{stem}.jsonl"]) == 0
    with open("a.json", "rb") as a, open("b.json", "rb") as b:
        assert a.read() == b.read()
    iterations, summary = lines("scene.jsonl")
    assert (iterations[0]["iteration"], summary["output"]) == (0, "b.json")


def test_a_resumed_fit_goes_on_with_its_log(path):
    some = ["estimate", path, *FIT, "-q", "--checkpoint", "fit.checkpoint", "--log", "fit.jsonl"]
    assert run([*some, "--max-evaluations", "12"]) == 5
    before, _ = lines()
    assert run([*some, "--resume"]) == 0
    after, summary = lines()
    assert summary["status"] == "converged"
    kept = [one for one in after if one in before]
    assert len(kept) >= len(before) - 1  # the last line may be of the point where the fit goes on
    assert len(after) > len(before)
    for key in ("iteration", "evaluations"):
        values = [one[key] for one in after]
        assert values == sorted(values)


def test_only_iterations_are_taken_from_an_earlier_log(tmp_path):
    good = {"iteration": 0, "evaluations": 3}
    text = f'{json.dumps(good)}\n{{"summary": {{}}}}\n[1]\nnot JSON\n{{"iteration": 1, "eval'
    (tmp_path / "x.jsonl").write_text(text)
    assert earlier(str(tmp_path / "x.jsonl")) == [good]
    assert earlier(str(tmp_path / "absent")) == []


def test_every_line_is_there_at_once_and_what_is_not_finite_is_null(tmp_path):
    log = FitLog(str(tmp_path / "x.jsonl"), [], Console())
    for iteration in range(3):
        log.record(Progress(iteration + 1, 10, np.inf, np.nan, 0.5, iteration))
        assert (tmp_path / "x.jsonl").read_text().count("\n") == iteration + 1
    log.end({"rmse": float("nan")})
    (first, *_), summary = lines(tmp_path / "x.jsonl")
    assert (first["cost"], first["rmse"], summary) == (None, None, {"rmse": None})


@needs_full_disk
def test_a_full_disk_ends_the_log_and_not_the_fit(path, capsys):
    assert run(["estimate", path, *FIT, "--log", "/dev/full"]) == 0
    err = capsys.readouterr().err
    assert err.count("warning: the log ends here: /dev/full: No space left on device") == 1
    assert "converged" in err


def test_the_page_tells_all_keys():
    page = (DOCS / "progress.md").read_text("utf-8")
    rows = re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)
    told = [key for row in rows for key in re.findall(r"`(\w+)`", row)]
    assert set(KEYS) | {"summary"} == set(told)
    shown = [json.loads(line) for line in re.findall(r'^{"iteration.*', page, re.MULTILINE)]
    assert all(tuple(line) == KEYS for line in shown)
