"""Standard output holds results alone, whatever libraries and other processes print."""

import json
import os
import subprocess
import sys

import pytest
from helpers.scenes import environment, started, trial, write_scene

from clothfit.cli.common.console import results_apart

pytestmark = pytest.mark.slow  # starts processes
unix = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such paths")

# A command in whose simulation a library in C prints, and a process that is started
NOISE = """
import ctypes, os, sys
import clothfit.motion.simulate
real = clothfit.motion.simulate.simulate
def simulate(*arguments, **keywords):
    libc = ctypes.CDLL(None)
    libc.puts(b"** On entry to DPOTRI")
    libc.fflush(None)
    os.system("echo of a process")
    return real(*arguments, **keywords)
clothfit.motion.simulate.simulate = simulate
from clothfit.__main__ import main
main(sys.argv[1:])
"""


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return write_scene(tmp_path, trial("nG", 5, 3, 3))


@unix
@pytest.mark.parametrize("closed", ["", "2>&-"])
def test_what_a_library_prints_goes_to_standard_error(scene, closed):
    call = f'"{sys.executable}" -c "$NOISE" simulate scene.json --json {closed}'
    done = subprocess.run(call, shell=True, capture_output=True, env=environment(NOISE=NOISE), check=False, timeout=50)
    assert done.returncode == 0
    assert json.loads(done.stdout)["command"] == "simulate"
    assert (b"DPOTRI" in done.stderr, b"of a process" in done.stderr) == (closed == "", closed == "")


@unix
@pytest.mark.parametrize("name", ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"])
@pytest.mark.usefixtures("scene")
def test_a_path_to_standard_output_is_standard_output(name):
    if not os.path.exists(name):
        pytest.skip("this system has no such path")
    with open("messages.txt", "wb") as messages:
        done = started("new", "plane", "-o", name, stderr=messages)
    assert done.returncode == 0
    assert json.loads(done.stdout)["objects"]
    with open("messages.txt", "rb") as messages:  # it was not taken for the result's place
        assert b"144 vertices" in messages.read()


def test_the_streams_are_as_before_afterwards(capfd):
    before = sys.stdout  # of the test, which is not the descriptor: it is left as it is
    with results_apart():
        assert sys.stdout is before
    with capfd.disabled():
        before, number = sys.stdout, os.fstat(1).st_ino
        with results_apart():
            inside = sys.stdout.fileno()
        assert (sys.stdout, os.fstat(1).st_ino) == (before, number)
        assert inside != 1 or before.fileno() != 1
