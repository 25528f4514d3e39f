"""The command line as a whole: what goes wrong, streams that end early or are noisy, errors as JSON."""

import json
import os
import re
import subprocess
import sys

import pytest
from helpers.scenes import changed, environment, names, needs_full_disk, started, trial, write_scene

from clothfit.cli.common.console import results_apart

pytestmark = pytest.mark.slow  # starts processes


# --- faults and interrupts


@pytest.fixture
def small(here):
    """The path of a small scene."""
    return write_scene(here, trial("nG", 5, 3, 3))


def broken(error):
    def simulate(*_):
        raise error

    return simulate


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (ZeroDivisionError("by nothing"), 1, "a fault of the program: ZeroDivisionError: by nothing (set "),
        (MemoryError(), 1, "out of memory; try fewer frames"),
        (OSError(5, "Input/output error", "disk"), 3, "disk: Input/output error"),
        (OSError(28, "No space left on device"), 3, "standard output: No space left on device"),
        (OSError(24, "Too many open files"), 3, "too many open files; allow more (ulimit -n)"),
        (OSError(12, "Cannot allocate memory"), 3, "out of memory; allow more (ulimit -v)"),
        (OSError("Could not load\nlibllvmlite.so"), 3, "a library cannot be loaded, for which memory may be too"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_what_goes_wrong_inside_is_one_line(small, said, monkeypatch, error, code, message):
    monkeypatch.delenv("CLOTHFIT_TRACEBACK", raising=False)
    monkeypatch.setattr("clothfit.simulate", broken(error), raising=False)
    found, out, err = said("simulate scene.json")
    assert (found, out, names()) == (code, "", ["scene.json"])
    assert err.strip().startswith(f"error: {message}")
    assert "Traceback" not in err
    if code == 1 and message.startswith("a fault"):
        monkeypatch.setenv("CLOTHFIT_TRACEBACK", "1")  # where it happened, on demand
        with pytest.raises(type(error)):
            said("simulate scene.json")


# --- streams


@pytest.mark.parametrize("writer", ["new plane -q -o -", "simulate scene.json -q --json", "simulate --help"])
def test_a_reader_that_left_is_no_reason_to_complain(small, writer):
    call = [sys.executable, "-m", "clothfit", *writer.split()]
    process = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment())
    process.stdout.close()
    err = process.communicate(timeout=50)[1]
    assert process.returncode not in (0, 1)  # 1 is a fault of the program
    assert not re.search(b"Traceback|error|Exception", err)


@needs_full_disk
@pytest.mark.parametrize("writer", [["--help"], ["new", "plane", "-q", "-o", "-"]])
def test_a_full_disk_behind_standard_output_is_code_3(writer):
    with open("/dev/full", "wb") as full:
        done = started(*writer, stdout=full)
    assert (done.returncode, done.stderr) == (3, b"error: standard output: No space left on device\n")


def without(stream, *arguments):
    """Run a command from a shell that closes one of the streams."""
    line = f'exec "$0" -m clothfit "$@" {stream}'
    call = ["sh", "-c", line, sys.executable, *arguments]
    return subprocess.run(call, capture_output=True, env=environment(), check=False, timeout=50)


def test_a_closed_stream_matters_only_to_who_needs_it():
    done = without(">&-", "new", "plane", "-o", "x.json")
    assert (done.returncode, b"Traceback" in done.stderr) == (0, False)
    assert without("<&-", "simulate", "-", "-o", "x.npz").returncode == 3


def test_with_standard_error_closed_a_fit_runs_and_standard_output_holds_data_only(small):
    done = without("2>&-", "estimate", small, "--max-evaluations", "2")
    assert done.returncode in (0, 5)
    assert done.stdout == b""


@pytest.mark.parametrize("arguments", [["--help"], ["new", "plane", "-o", "-"], ["new", "plane", "--json", "-q"]])
def test_data_for_a_closed_standard_output_is_not_lost_in_silence(arguments):
    done = without(">&-", *arguments)
    assert done.returncode == 3
    assert done.stderr.decode().splitlines()[-1].startswith("error: standard output: ")
    assert b"Traceback" not in done.stderr


# --- errors with --json


@pytest.mark.parametrize(
    ("line", "command", "where", "code"),
    [
        ("info absent.json", "info", "absent.json", 3),
        ("simulate scene.json --steps 0", "simulate", "--steps", 3),
        ("simulate scene.json --steps many", "simulate", "--steps", 3),
        ("simulate", "simulate", "SCENE", 2),
        ("estimate scene.json --fast", "estimate", "--fast", 2),
        ("info wrong.json", "info", "wrong.json: objects[0].vertMass[3]", 3),
        ("estimate scene.json --target folder/absent.npz", "estimate", "absent.npz", 3),
        ("fold", None, None, 2),
    ],
)
def test_with_json_an_error_is_an_object(small, here, said, line, command, where, code):
    write_scene(here, changed(trial("nG", 5, 3, 3), ("objects", 0, "vertMass", 3), -1), "wrong.json")
    found, out, err = said(f"{line} --json")
    told = json.loads(out)
    assert (set(told), out.count("\n")) == ({"schema_version", "command", "error", "where", "code"}, 1)
    assert (told["command"], told["where"], told["code"], found) == (command, where, code, code)
    assert err == f"error: {told['error']}\n"


def test_after_a_summary_or_where_data_go_to_standard_output_an_error_is_no_object_there(here, said, told):
    write_scene(here, trial("nG", 50, 3, 3, integrationMethod=0, springStiffness=[1e6] * 16))
    found, err = told("simulate scene.json", code=4)
    assert found["command"] == "simulate"
    assert err.splitlines()[-1].startswith("error: ")
    code, out, err = said("simulate absent.json -o - --json")
    assert (code, out, json.loads(err.splitlines()[-1])["code"]) == (3, "", 3)


def test_the_locale_c_gets_ascii(small):
    plain = environment(LC_ALL="C", PYTHONUTF8="", PYTHONIOENCODING="")
    done = started("info", small, env=plain)
    assert done.returncode == 0
    assert b"m/s^2" in done.stdout
    assert done.stdout.isascii()
    assert b" -> " in started("new", "plane", "-o", f"{small}.x", env=plain).stderr
    for encoding in ("ascii", "cp1252"):
        assert started("target", "--help", env=environment(PYTHONIOENCODING=encoding)).returncode == 0


# --- options as they are typed, before or after the command


@pytest.mark.parametrize(
    "line", ["--json -q info", "-q info --json", "info --json -q", "-v --json info -q"]
)
def test_common_options_go_before_or_after_the_command(small, said, line):
    code, out, err = said(f"{line} scene.json")
    assert (code, err == "") == (0, "-v" not in line)
    assert json.loads(out)["command"] == "info"


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


@unix
@pytest.mark.parametrize("closed", ["", "2>&-"])
def test_what_a_library_prints_goes_to_standard_error(folder, closed):
    call = f'"{sys.executable}" -c "$NOISE" simulate scene.json --json {closed}'
    done = subprocess.run(call, shell=True, capture_output=True, env=environment(NOISE=NOISE), check=False, timeout=50)
    assert done.returncode == 0
    assert json.loads(done.stdout)["command"] == "simulate"
    assert (b"DPOTRI" in done.stderr, b"of a process" in done.stderr) == (closed == "", closed == "")


@unix
@pytest.mark.parametrize("name", ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"])
@pytest.mark.usefixtures("folder")
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
