"""Runs that are asked to end, killed, or not alone: one line, no file is torn, and what killed ones left goes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.paths import BENCHMARKS
from helpers.scenes import environment, names, trial, write_scene

from clothfit.base import writing
from clothfit.cli.program import _interrupt, run

pytestmark = [
    pytest.mark.slow,  # starts processes
    pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals and pipes"),
]
SECONDS = 50


# --- signals


def begun(*arguments, **keywords):
    """A long simulation, at the moment when it has begun."""
    call = [sys.executable, "-m", "clothfit", "simulate", "scene.json", "-v", "--steps", "100000", *arguments]
    process = subprocess.Popen(call, stderr=subprocess.PIPE, env=environment(), **keywords)
    process.stderr.readline()  # the scene is read
    return process


def test_a_request_to_end_leaves_nothing_behind(folder):
    process = begun()
    process.send_signal(signal.SIGHUP)
    err = process.communicate(timeout=SECONDS)[1]
    assert process.returncode == 130
    assert err.endswith(b"error: interrupted\n")
    assert names() == ["scene.json"]


def test_with_nohup_a_terminal_may_be_closed(folder):
    process = begun("--steps", "2000", preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    process.send_signal(signal.SIGHUP)
    process.communicate(timeout=SECONDS)
    assert process.returncode == 0


def test_a_second_request_ends_a_writing_that_nobody_reads(folder):
    os.mkfifo("pipe")
    call = [sys.executable, "-m", "clothfit", "simulate", "scene.json", "-v", "-o", "pipe"]
    process = subprocess.Popen(call, stderr=subprocess.PIPE, env=environment())
    while (line := process.stderr.readline()) and b"simulated" not in line:
        pass
    time.sleep(0.3)  # until it waits for a reader
    process.terminate()
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(1.2)
    process.terminate()
    assert process.wait(SECONDS) == 130
    process.stderr.close()


# --- Ctrl-C while the program is still loading or compiling

MAIN = "from clothfit.__main__ import main\nmain(sys.argv[1:])\n"

# Interrupts at the moment when a module is about to be imported.
IMPORTING = """
import os, signal, sys
from importlib.abc import MetaPathFinder
class Interrupt(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == "%s":
            sys.meta_path.remove(self)
            exec(%r)
sys.meta_path.insert(0, Interrupt())
"""

# Interrupts in the middle of a compilation, where an exception in what the compiler calls is lost.
COMPILING = """
import os, signal, sys
from numba.core.codegen import CPUCodeLibrary
compiled = CPUCodeLibrary._object_compiled_hook.__func__
def interrupt(*arguments):
    CPUCodeLibrary._object_compiled_hook = classmethod(compiled)
    os.kill(os.getpid(), signal.SIGINT)
    for _ in range(1000):  # the interpreter calls the handler between two instructions
        pass
    return compiled(*arguments)
CPUCodeLibrary._object_compiled_hook = classmethod(interrupt)
"""


def interrupted(folder, start, *, module=False, **changes):
    """The standard error of a simulation that interrupts itself; with `module` it is started by `python -m`."""
    scene = write_scene(folder, trial("nG", 5, 3, 3))
    (folder / "started.py").write_text(start + MAIN)
    call = [sys.executable, *(["-m", "started"] if module else [str(folder / "started.py")]), "simulate", scene]
    where = environment(**changes)
    done = subprocess.run(call, capture_output=True, env=where, cwd=folder, check=False, timeout=SECONDS)
    assert (done.returncode, done.stdout) == (130, b"")
    assert not list(folder.glob("*.npz"))
    return done.stderr.decode()


@pytest.mark.parametrize(
    ("name", "kind", "more"),
    [("clothfit.cli.program", "SIGINT", ""), ("click", "SIGTERM", ""), ("numba", "SIGINT", ""),
     ("numpy", "SIGINT", "\nfor _ in range(1000): pass")],  # in what is made from text, where `python -m` kills itself
)  # fmt: skip
def test_an_interrupt_while_loading_is_one_line(tmp_path, name, kind, more):
    start = IMPORTING % (name, f"os.kill(os.getpid(), signal.{kind}){more}")
    said = interrupted(tmp_path, start, module=bool(more))
    assert said.lstrip() == "error: interrupted\n"  # click may end the line that a terminal shows ^C on


def test_an_interrupt_in_the_first_compilation_is_one_line(tmp_path):
    said = interrupted(tmp_path, COMPILING, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert said.splitlines()[-1] == "error: interrupted"
    assert "Traceback" not in said


# As importlib's callback of a module's lock, a destructor, and numba's as a kernel hands over arrays.
CALLBACKS = [
    ("<frozen importlib._bootstrap>", "cb"), ("/usr/lib/python/weakref.py", "remove"), ("any.py", "__del__"),
    ("/numba/core/serialize.py", "_numba_unpickle"),
]  # fmt: skip


@pytest.mark.parametrize(("file", "name"), CALLBACKS)
def test_an_interrupt_where_its_exception_would_be_lost_comes_later(file, name):
    space = {"interrupt": _interrupt, "frame": sys._getframe, "number": int(signal.SIGINT)}
    exec(compile(f"def {name}():\n    interrupt(number, frame())\n    return 'went on'", file, "exec"), space)
    assert space[name]() == "went on"
    with pytest.raises(KeyboardInterrupt):
        time.sleep(10.0)  # by Python's own handler, which is that of tests


# --- two at once, and what killed ones left


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


def test_a_new_file_that_is_taken_for_left_behind_is_made_again(folder, monkeypatch):
    lock, taken = writing.lock, []

    def late(number, wait):
        if not taken:  # in the moment before it is locked
            taken.extend(name for name in names() if name.startswith(".clothfit"))
            os.unlink(taken[0])
        return lock(number, wait)

    monkeypatch.setattr(writing, "lock", late)
    writing.write_atomically("x.npz", b"data")
    assert len(taken) == 1
    assert names() == ["scene.json", "x.npz"]


def test_runs_that_are_killed_leave_whole_files_and_go_on(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    for name, value in environment().items():
        monkeypatch.setenv(name, value)
    from kills import trials

    scene = Path(write_scene(tmp_path, trial("nL", 10)))
    # With this seed each of the two commands is killed while it writes, one with an older file there and one without,
    # unless it is faster than it was.
    runs, faults = trials(count=2, seed=882, frames=6, steps=5000, scene=scene, warm=0)
    assert faults == []
    assert sum(run.counts["killed"] for run in runs) == 2
