"""Runs that are asked to end, killed, or not alone: no file is torn, and what killed ones left goes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import BENCHMARKS
from helpers.scenes import environment, names, trial, write_scene

import clothfit
from clothfit.base import writing
from clothfit.cli.program import run

pytestmark = pytest.mark.slow  # starts processes

unix = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals, pipes and limits")
SECONDS = 50


# --- signals


def begun(*arguments, **keywords):
    """A long simulation, at the moment when it has begun."""
    call = [sys.executable, "-m", "clothfit", "simulate", "scene.json", "-v", "--steps", "100000", *arguments]
    process = subprocess.Popen(call, stderr=subprocess.PIPE, env=environment(), **keywords)
    process.stderr.readline()  # the scene is read
    return process


@unix
@pytest.mark.parametrize("kind", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_request_to_end_leaves_nothing_behind(folder, kind):
    process = begun()
    process.send_signal(getattr(signal, kind))
    err = process.communicate(timeout=SECONDS)[1]
    assert process.returncode == 130
    assert err.endswith(b"error: interrupted\n")
    assert names() == ["scene.json"]


@unix
def test_with_nohup_a_terminal_may_be_closed(folder):
    process = begun("--steps", "2000", preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    process.send_signal(signal.SIGHUP)
    process.communicate(timeout=SECONDS)
    assert process.returncode == 0


@unix
def test_a_second_request_ends_a_writing_that_nobody_reads(folder):
    os.mkfifo("pipe")
    call = [sys.executable, "-m", "clothfit", "simulate", "scene.json", "-v", "-o", "pipe"]
    process = subprocess.Popen(call, stderr=subprocess.PIPE, env=environment())
    while b"simulated" not in process.stderr.readline():
        pass
    time.sleep(0.3)  # until it waits for a reader
    process.terminate()
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(1.2)
    process.terminate()
    assert process.wait(SECONDS) == 130
    process.stderr.close()


# --- two at once, and what killed ones left


def test_two_runs_with_one_output_leave_one_of_both_results(folder):
    calls = [[sys.executable, "-m", "clothfit", "simulate", "scene.json", "--steps", n, "-q", "-o", "x.npz"]
             for n in ("1000", "1001")]  # fmt: skip
    both = [subprocess.Popen(call, env=environment()) for call in calls]
    assert [process.wait(SECONDS) for process in both] == [0, 0]
    motion = clothfit.load_motion("x.npz", clothfit.load("scene.json"))
    assert len(motion.times) in (1001, 1002)
    alone = clothfit.simulate(clothfit.load("scene.json"), len(motion.times))
    np.testing.assert_array_equal(motion.positions, alone.positions)
    assert names() == ["scene.json", "x.npz"]


@unix
def test_what_a_killed_run_left_goes_with_the_next_and_nothing_else_does(folder, monkeypatch):
    left, foreign = f"{writing.prefix()}{'0' * 16}.tmp", f".clothfit-another0-{'0' * 16}.tmp"
    for name in (left, foreign, ".clothfit-mine.tmp"):
        Path(name).write_bytes(b"half")
    writing._swept.clear()
    with writing.create(str(folder)) as alive:
        assert not Path(left).exists()
        writing._swept.clear()
        assert run(["simulate", "scene.json", "-q", "-o", "x.npz"]) == 0
        assert Path(alive.name).exists()  # somebody is writing it
    assert sorted(set(names()) - {os.path.basename(alive.name)}) == sorted(
        [foreign, ".clothfit-mine.tmp", "scene.json", "x.npz"]
    )


@unix
def test_a_new_file_that_is_taken_for_left_behind_is_made_again(folder, monkeypatch):
    lock, taken = writing.lock, []

    def late(number, wait):
        if not taken:  # in the moment before it is locked
            taken.extend(name for name in names() if name.startswith(".clothfit"))
            os.unlink(taken[0])
        return lock(number, wait)

    monkeypatch.setattr(writing, "lock", late)
    assert run(["simulate", "scene.json", "-q", "-o", "x.npz"]) == 0
    assert len(taken) == 1
    assert names() == ["scene.json", "x.npz"]


@unix
def test_runs_that_are_killed_leave_whole_files_and_go_on(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    for name, value in environment().items():
        monkeypatch.setenv(name, value)
    from kills import trials

    scene = Path(write_scene(tmp_path, trial("nL", 10)))
    # With this seed each of the two commands is killed while it writes, and with an older file there and without one,
    # unless it is faster than it was.
    runs, faults = trials(count=4, seed=550, frames=6, steps=5000, scene=scene, warm=0)
    assert faults == []
    assert sum(run.counts["killed"] for run in runs) == 4
