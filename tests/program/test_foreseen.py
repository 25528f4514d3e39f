"""Memory that is not there is refused before any work, with the figure."""

import subprocess
import sys
from types import SimpleNamespace

import pytest
from helpers.scenes import environment, names

from clothfit.base import memory
from clothfit.cli.program import run

pytestmark = pytest.mark.slow  # starts processes

SECONDS = 50


FORESEEN = [["simulate", "scene.json"], ["target", "scene.json"], ["evaluate", "scene.json", "scene.json"]]


@pytest.mark.parametrize("command", [*FORESEEN, ["estimate", "scene.json"], ["evaluate", "scene.json", "--speed"]])
def test_memory_that_is_not_free_is_refused_with_the_figure_before_the_work(folder, monkeypatch, capsys, command):
    # the scene can be read
    monkeypatch.setattr("clothfit.scene.text.memory", SimpleNamespace(free=lambda: 10**9))
    monkeypatch.setattr("clothfit.base.memory.ALWAYS_FREE", 0)  # so little is looked at otherwise
    monkeypatch.setattr("clothfit.base.memory.available", lambda: 1000)
    monkeypatch.setattr("clothfit.engine.rollout.advance", lambda *_: pytest.fail("it began to work"))
    assert run(command) == 3
    assert ", 1 kB of memory are free; use fewer frames" in capsys.readouterr().err
    assert names() == ["scene.json"]


@pytest.mark.parametrize("steps", ["100000000", "9" * 400])
@pytest.mark.parametrize("command", FORESEEN)
def test_any_number_of_steps_has_its_figure(folder, capsys, command, steps):
    assert run([*command, "--steps", steps]) == 3
    err = capsys.readouterr().err
    assert "frames of 16 vertices take " in err
    assert len(err) < 200


@pytest.mark.parametrize("rate", ["1e12", "1e308"])
def test_any_rate_of_frames_has_its_figure(folder, capsys, rate):
    assert run(["target", "scene.json", "--fps", rate]) == 3
    assert "frames of 16 vertices take " in capsys.readouterr().err


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere the use of address space is not told")
def test_a_limit_of_the_process_counts(folder):
    # 4 GB of address space, of which the program takes 1; 10^7 frames of 16 vertices take 3.84 GB.
    call = ["sh", "-c", 'ulimit -v 4000000; exec "$0" -m clothfit "$@"', sys.executable]
    call += ["simulate", "scene.json", "--steps", "10000000"]
    done = subprocess.run(call, capture_output=True, env=environment(), check=False, timeout=SECONDS)
    assert (done.returncode, done.stdout) == (3, b"")
    assert b"error: 10000001 frames of 16 vertices take 3.84 GB, " in done.stderr


def test_what_a_container_keeps_of_files_it_has_read_is_free(tmp_path):
    (tmp_path / "max").write_text("1000\n")
    (tmp_path / "current").write_text("900\n")
    assert memory.left(tmp_path / "max", tmp_path / "current") == 100
    (tmp_path / "memory.stat").write_text("anon 300\nactive_file 200\ninactive_file 400\n")
    assert memory.left(tmp_path / "max", tmp_path / "current") == 500
