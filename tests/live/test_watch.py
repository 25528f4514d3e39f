"""Watching files: what counts as a change, and that of many saves the last one wins."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest
from helpers.scenes import cloth, document, environment, write_scene

from clothfit import load, save_motion, simulate
from clothfit.cli.common import running as watch
from clothfit.cli.common.running import Watch
from clothfit.cli.program import run


@pytest.fixture
def clock(monkeypatch):
    """A clock that goes on when it is asked to."""
    now = [100.0]
    monkeypatch.setattr(watch.time, "monotonic", lambda: now[0])
    return now


@pytest.fixture
def watched(tmp_path):
    """A file and what watches it, which knows its content."""
    path = tmp_path / "scene.json"
    path.write_text("one")
    files = Watch([str(path)])
    files.given()
    return path, files


def test_a_change_counts_when_the_file_is_still(watched, clock):
    path, files = watched
    assert not files.changed()
    path.write_text("two, longer")
    assert not files.changed()
    clock[0] += watch.QUIET_SECONDS / 2
    path.write_text("three, longer still")
    assert not files.changed()
    clock[0] += 0.9 * watch.QUIET_SECONDS
    assert not files.changed()  # it has been still for less than that
    clock[0] += 0.2 * watch.QUIET_SECONDS
    assert files.changed()


def test_a_file_that_never_rests_counts_after_a_while(watched, clock):
    (path, files), begin = watched, clock[0]
    while True:
        path.write_text(path.read_text() + "x")
        if files.changed():
            break
        clock[0] += 0.1
    assert watch.LONGEST - 0.05 < clock[0] - begin < watch.LONGEST + 0.25


def test_the_same_content_is_no_change_and_a_new_file_in_its_place_is(watched, clock):
    path, files = watched
    other = path.with_name("new.json")
    path.write_text("one")
    os.utime(path, ns=(1, 1))
    assert not files.changed()
    clock[0] += 1.0
    assert not files.changed()
    other.write_text("two")
    os.replace(other, path)
    assert not files.changed()
    clock[0] += 1.0
    assert files.changed()
    files.given()
    path.unlink()
    assert not files.changed()
    clock[0] += 1.0
    assert files.changed()


@contextmanager
def watching(folder, *words):
    """A command that watches its files and is ended by Ctrl-C; gives what tells what it has said."""
    command, said = [sys.executable, "-m", "clothfit", *words, "--watch"], folder / "said.txt"
    with open(said, "w") as stream:
        running = subprocess.Popen(command, env=environment(), cwd=folder, stderr=stream)
    try:
        yield lambda: said.read_text("utf-8")
        assert running.poll() is None
    finally:
        running.send_signal(signal.SIGINT)
        running.wait(120)
    assert "Traceback" not in said.read_text("utf-8")
    assert running.returncode == 130


@pytest.mark.slow
def test_of_many_saves_the_last_one_wins(tmp_path):
    def version(i):
        return document(title=str(i), windVel={"x": 0.0, "y": 0.0, "z": float(i)}, optimizationIterations=10)

    def shown():
        found = tmp_path / "scene.motion.npz"
        return np.load(found)["positions"] if found.exists() else np.zeros(0)  # written whole or not at all

    path = write_scene(tmp_path, version(0))
    with watching(tmp_path, "simulate", path):
        until(lambda: len(shown()) == 10)
        for i in range(1, 31):
            with open(path, "w", encoding="utf-8") as file:  # as editors do that do not care
                text = json.dumps(version(i))
                file.write(text[: len(text) // 2])
                file.flush()
                time.sleep(0.01)
                file.write(text[len(text) // 2 :])
        expected = simulate(load(version(30)), 10).positions
        until(lambda: np.array_equal(shown(), expected))


@pytest.mark.slow
def test_a_fit_starts_from_its_last_result(tmp_path):
    """With the values that the last fit found, another fit to the same motion has nothing left to find."""

    def version(frames=8, **fields):
        return document(cloth(optimizationSettings="nL"), optimizationIterations=frames, **fields)

    path, target = write_scene(tmp_path, version()), str(tmp_path / "target.npz")
    truth = document(cloth(springStiffness=[40.0] * 23), optimizationIterations=8)
    save_motion(simulate(load(truth), 8), target)
    with watching(tmp_path, "estimate", path, "--target", target, "-o", "out.json") as said:
        until(lambda: "waiting for" in said())
        write_scene(tmp_path, version(title="again"))
        until(lambda: said().count("waiting for") == 2)
        write_scene(tmp_path, version(-8))
        until(lambda: said().count("waiting for") == 3)
        assert said().count("error: ") == 1  # what is broken is said once
    assert json.loads((tmp_path / "out.json").read_text())["title"] == "again"
    assert "error: cannot write" not in said()
    first, second = (int(n) for n in re.findall(r"(\d+) evaluations? in", said()))
    assert second < first


def until(condition):
    """Wait for a condition, a long time where the machine is slow."""
    for _ in range(2400):
        if condition():
            return
        time.sleep(0.05)
    raise AssertionError("never")


@pytest.mark.parametrize("words", [["--in-place"], ["-o", "-"]])
def test_what_cannot_be_watched_is_said(tmp_path, capsys, words):
    assert run(["estimate", write_scene(tmp_path, document()), "--watch", *words]) == 2
    assert "--watch goes neither" in capsys.readouterr().err
