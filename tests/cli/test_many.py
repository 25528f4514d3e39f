"""`clothfit estimate` of several scenes or from several starts: files, table, JSON, exit codes, refusals, Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.scenes import environment, even, names, trial, write_scene

from clothfit.cli.parts import estimate_many
from clothfit.cli.parts.estimate_files import filled
from clothfit.fit.estimate import record_target
from clothfit.many.job import run as do
from clothfit.motion.motion import save_motion
from clothfit.optimise.checkpoint import decoded
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow

FEW = "--method l-bfgs-b --max-evaluations 6 --no-intervals"


@pytest.fixture(autouse=True)
def scenes(here):
    """The folder has two scenes and their targets."""
    (here / "captures").mkdir()
    for i, name in enumerate("ab"):
        path = write_scene(here, trial("Ln", 15, 4, 3 + i), f"{name}.json")
        save_motion(record_target(load(path)), f"captures/{name}.npz")


class Here:
    """A pool that does each job at once, in this process."""

    width, retried_alone = 1, True

    def __init__(self):
        self.found = {}

    def prepare(self, done):
        return False

    def submit(self, number, job, done):
        self.found[number] = do(job)
        done(number)

    def outcome(self, number):
        return self.found[number]

    def close(self, kill=False):
        pass


@pytest.fixture
def in_this_process(monkeypatch):
    """No processes, which take seconds to start: only what is written and told is looked at."""
    monkeypatch.setattr("clothfit.cli.parts.estimate_many.chosen_pool", lambda *arguments: Here())


def test_each_scene_has_its_target_its_file_its_row_and_the_worst_decides(here, said):
    (here / "bad.json").write_text("{")
    (here / "captures/bad.npz").touch()
    many = "estimate a.json bad.json b.json --target 'captures/{stem}.npz' -o new/fitted --jobs 1"
    code, out, err = said(many)
    lines = err.splitlines()
    message = "line 1, column 2: the text ends inside a value; is the file complete?"
    assert lines[0].startswith("1 of 3: a.json: converged, RMSE ")
    assert lines[1] == f"2 of 3: bad.json: error: {message}"
    header, *rows = out.splitlines()
    assert header.split() == ["scene", "status", "RMSE", "frames", "evaluations", "seconds", "output"]
    assert [" ".join(line.split()[:2]) for line in rows] == ["a.json converged", "bad.json failed", "b.json converged"]
    assert rows[0].endswith("new/fitted/a.fitted.json")
    assert rows[1].endswith(f"error: bad.json: {message}")
    assert (code, names("new/fitted")) == (3, ["a.fitted.json", "b.fitted.json"])
    assert said("estimate a.json --target captures/a.npz -q")[0] == 0
    assert (here / "a.fitted.json").read_bytes() == (here / "new/fitted/a.fitted.json").read_bytes()


@pytest.mark.usefixtures("in_this_process")
def test_quiet_tells_errors_only_and_json_tells_all(told):
    summary, err = told(f"estimate none.json a.json --in-place -q --jobs 1 {FEW}", code=3)
    message = "none.json: there is no such file"
    assert err == f"error: {message}\n"
    assert (summary["schema_version"], summary["command"]) == (1, "estimate")
    assert summary["seconds"] > 0
    failed, fitted = summary["scenes"]
    assert failed == {"scene": "none.json", "status": "failed", "output": None, "exit_code": 3, "error": message}
    assert [fitted[key] for key in ("scene", "output", "exit_code", "error")] == ["a.json", "a.json", 5, None]
    assert {"status", "method", "cost", "rmse", "frames", "evaluations", "parameters"} <= set(fitted)


@pytest.mark.usefixtures("in_this_process")
def test_the_best_start_of_one_scene_is_written_and_all_are_told(here, said):
    stiff = [90.0] * len(load("a.json").cloths[0].stiffness)
    write_scene(here, even("nG", 15, 4, 3, springStiffness=stiff), "guess.json")
    code, out, err = said(f"estimate guess.json --target captures/a.npz --starts 3 --jobs 1 --json -o - {FEW}")
    table, told = err.splitlines()[:4], json.loads(err.splitlines()[-1])
    assert (code, [line.split()[0] for line in table[1:]]) == (0, ["guess.json", "2", "3"])
    costs = [start["cost"] for start in told["starts"]]
    assert told["cost"] == min(costs) == costs[told["start"] - 1]
    assert len(set(costs)) == 3
    assert load(json.loads(out)).cloths[0].stiffness[0] != 90.0


def decoded_file(path):
    """The state in a checkpoint."""
    return decoded(Path(path).read_bytes(), "")[1]


@pytest.mark.usefixtures("in_this_process")
def test_checkpoints_are_kept_for_each_scene_and_each_start_and_gone_on_from(here, said):
    call = f"estimate a.json b.json --starts 2 --jobs 1 -q --checkpoint '{{stem}}.check' {FEW}"
    assert said(call)[0] == 5
    kept = {"a.2.check", "a.check", "b.2.check", "b.check"}
    assert kept <= set(names())
    short = (here / "a.fitted.json").read_bytes()
    before = {check: decoded_file(check) for check in kept}
    (here / "b.check").unlink()  # begins anew
    assert said(f"{call.replace('evaluations 6', 'evaluations 12')} --resume")[0] == 5
    assert (here / "a.fitted.json").read_bytes() != short
    for check, earlier in before.items():
        found = decoded_file(check)
        assert len(found.history) == 12
        assert found.cost <= earlier.cost


def test_patterns_name_stem_and_folder_and_files_that_are_there_keep_their_names(tmp_path):
    assert filled("c/{stem}.npz", "x/a.v2.json") == "c/a.v2.npz"
    assert filled("{folder}/c/{stem}.npz", "x/y/a.json") == "x/y/c/a.npz"
    odd = tmp_path / "{stem}.npz"
    odd.touch()
    assert filled(str(odd), "a.json") == str(odd)


def has_result(path):
    """Whether a checkpoint holds a point that was evaluated."""
    return path.is_file() and decoded_file(path).cost < float("inf")


def test_ctrl_c_ends_with_the_best_so_far_and_begins_no_more(here):
    for name in "cde":
        write_scene(here, trial("LL", 60, 8, 8), f"{name}.json")  # takes minutes to fit to the last digit
    line = ("estimate c.json d.json e.json --start 1 --rmse 0 --max-evaluations 1000000 --method l-bfgs-b --json "
            "--jobs 2 --checkpoint {stem}.check")  # fmt: skip
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": environment(), "start_new_session": True}
    process = subprocess.Popen([sys.executable, "-m", "clothfit", *line.split()], **options)
    until = time.monotonic() + 40
    while not all(has_result(here / name) for name in ("c.check", "d.check")) and time.monotonic() < until:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130
    found = [(one["status"], one["exit_code"], one["output"]) for one in json.loads(out)["scenes"]]
    ended = [("interrupted", 130, f"{name}.fitted.json") for name in "cd"]
    assert found == [*ended, ("not started", 130, None)]
    assert [name for name in names() if "fitted" in name] == ["c.fitted.json", "d.fitted.json"]
    assert b"Traceback" not in err


@pytest.mark.usefixtures("in_this_process")
def test_scenes_that_were_written_over_before_a_kill_do_not_stop_those_that_go_on(said, told, monkeypatch):
    """The second scene is killed when the first is already the result of its fit."""
    call = f"estimate a.json b.json --in-place --checkpoint '{{stem}}.kept' --start 2 {FEW}"
    write = estimate_many.write_scene

    def killed(scene, out):
        if out.path == "b.json":
            raise SystemExit(9)  # nothing is tidied up
        write(scene, out)

    monkeypatch.setattr(estimate_many, "write_scene", killed)
    with pytest.raises(SystemExit):
        said(f"{call} -q")
    monkeypatch.setattr(estimate_many, "write_scene", write)
    first = Path("a.json").read_bytes()
    before = Path("b.json").read_bytes()
    summary, err = told(f"{call} --resume", code=5)
    a, b = summary["scenes"]
    assert (a["status"], a["exit_code"], a["error"], a["output"]) == ("written", 0, None, "a.json")
    assert b["error"] is None
    assert "1 of 2: a.json: its result was written before, and stays as it is" in err
    assert Path("a.json").read_bytes() == first
    assert Path("b.json").read_bytes() != before
