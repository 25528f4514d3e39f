"""Watching files: what counts as a change, and that of many saves the last one wins."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from helpers.scenes import cloth, document, environment, write_scene

from clothfit.cli.program import run
from clothfit.live import watch
from clothfit.live.watch import Watch
from clothfit.motion.files import save_motion
from clothfit.motion.simulate import simulate
from clothfit.scene.scene import load


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
    clock[0] += watch.STILL / 2
    path.write_text("three, longer still")
    assert not files.changed()
    clock[0] += 0.9 * watch.STILL
    assert not files.changed()  # it has been still for less than that
    clock[0] += 0.2 * watch.STILL
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


@pytest.mark.slow
def test_of_many_saves_the_last_one_wins(tmp_path):
    def version(i):
        return document(title=str(i), windVel={"x": 0.0, "y": 0.0, "z": float(i)}, optimizationIterations=10)

    def shown():
        found = tmp_path / "scene.motion.npz"
        return np.load(found)["positions"] if found.exists() else np.zeros(0)  # written whole or not at all

    path = write_scene(tmp_path, version(0))
    command = [sys.executable, "-m", "clothfit", "simulate", path, "--watch"]
    running = subprocess.Popen(command, env=environment(), cwd=tmp_path, stderr=subprocess.PIPE)
    try:
        until(lambda: len(shown()) == 10)
        for i in range(1, 31):
            with open(path, "w", encoding="utf-8") as file:  # as editors do that do not care
                text = json.dumps(version(i))
                file.write(text[: len(text) // 2])
                file.flush()
                time.sleep(0.01)
                file.write(text[len(text) // 2 :])
        expected = simulate(load(io.StringIO(json.dumps(version(30)))), 10).positions
        until(lambda: np.array_equal(shown(), expected))
        assert running.poll() is None
    finally:
        running.send_signal(signal.SIGINT)
        said = running.communicate(timeout=120)[1].decode()
    assert "Traceback" not in said
    assert running.returncode == 130


@pytest.mark.slow
def test_a_fit_starts_from_its_last_result(tmp_path):
    """With the values that the last fit found, another fit to the same motion has nothing left to find."""
    path = write_scene(tmp_path, document(cloth(optimizationSettings="nL"), optimizationIterations=8))
    target, truth = tmp_path / "target.npz", document(cloth(springStiffness=[40.0] * 23), optimizationIterations=8)
    save_motion(simulate(load(io.StringIO(json.dumps(truth))), 8), str(target))
    words = ["estimate", path, "--target", str(target), "-o", "out.json", "--watch"]
    command, said = [sys.executable, "-m", "clothfit", *words], tmp_path / "said.txt"
    with open(said, "w") as stream:
        running = subprocess.Popen(command, env=environment(), cwd=tmp_path, stderr=stream)
    try:
        until(lambda: "waiting for" in said.read_text())
        again = document(cloth(optimizationSettings="nL"), optimizationIterations=8, title="again")
        write_scene(tmp_path, again)
        until(lambda: said.read_text().count("waiting for") == 2)
        write_scene(tmp_path, document(cloth(optimizationSettings="nL"), optimizationIterations=-8))
        until(lambda: said.read_text().count("waiting for") == 3)
        assert said.read_text().count("error: ") == 1  # what is broken is said once
    finally:
        running.send_signal(signal.SIGINT)
        running.wait(120)
    assert json.loads((tmp_path / "out.json").read_text())["title"] == "again"
    assert "error: cannot write" not in said.read_text()
    first, second = (int(n) for n in re.findall(r"(\d+) evaluations? in", said.read_text()))
    assert second < first
    assert running.returncode == 130


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
