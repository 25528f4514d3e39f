"""Processes that need the same kernel at once: one compiles it, and nobody waits for what does not come."""

import os
import subprocess
import sys

import pytest
from helpers.scenes import environment

from clothfit.kernels import once
from clothfit.kernels.trusted import made

pytestmark = [
    pytest.mark.slow,  # starts processes
    pytest.mark.skipif(once.fcntl is None, reason="this system has no such locks"),
]


@pytest.fixture
def folder(tmp_path):
    """An open folder for compiled code."""
    with made(tmp_path / "cache" / "kernels-now", True, "kernels-", None) as folder:
        yield folder


def never():
    raise AssertionError("nobody else has it")


def test_the_second_waits_until_the_first_is_done_and_no_file_is_left(folder):
    first, looks = once.locked(folder, "f", never), []
    first.__enter__()

    def look():
        looks.append(folder.names())
        if len(looks) == 3:
            first.__exit__(None, None, None)

    with once.locked(folder, "g", never), once.locked(folder, "f", look):
        assert len(looks) == 3
        assert sorted(folder.names()) == [".f.lock", ".g.lock"]
    assert folder.names() == []


def test_an_interrupted_wait_leaves_the_lock_to_who_has_it(folder):
    def interrupted():
        raise KeyboardInterrupt

    with once.locked(folder, "f", never):
        for _ in range(2):
            with pytest.raises(KeyboardInterrupt), once.locked(folder, "f", interrupted):
                pass
    with once.locked(folder, "f", never):
        pass


def test_who_has_waited_for_too_long_goes_on_and_takes_nothing_away(folder, monkeypatch):
    with once.locked(folder, "f", never):
        monkeypatch.setattr(once, "LONGEST", 0.0)
        with once.locked(folder, "f", never):
            pass
        assert folder.names() == [".f.lock"]


HOLDS = """
import sys
from pathlib import Path
from clothfit.kernels import once
from clothfit.kernels.trusted import made
with made(Path(sys.argv[1]), True, "kernels-", None) as folder, once.locked(folder, "f", print):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_the_lock_of_a_process_that_is_killed_is_free(folder):
    call = [sys.executable, "-c", HOLDS, str(folder.path)]
    with subprocess.Popen(call, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment()) as holder:
        assert holder.stdout.readline() == b"held\n"
        holder.kill()
    with once.locked(folder, "f", never):
        pass


MODULE = """
from clothfit.kernels.kernel import kernel

@kernel
def inner(x):
    return x + 1.0

@kernel
def outer(x):
    return inner(x) * inner(x)
"""
CALLS = """
import sys
from module import inner, outer
from clothfit.kernels import compiling
outer.outer, inner.inner
print("ready", flush=True)
sys.stdin.readline()
print(outer(1.0), *(sum(each.stats.cache_misses.values()) for each in (outer.outer, inner.inner)))
"""


def test_processes_that_need_a_kernel_at_once_compile_it_once(tmp_path):
    (tmp_path / "module.py").write_text(MODULE)
    where = environment(NUMBA_CACHE_DIR=str(tmp_path / "cache"), PYTHONPATH=os.pathsep.join([str(tmp_path), *sys.path]))
    call, pipe = [sys.executable, "-c", CALLS], subprocess.PIPE
    running = [subprocess.Popen(call, stdin=pipe, stdout=pipe, env=where, text=True) for _ in range(3)]
    for each in running:
        assert each.stdout.readline() == "ready\n"
    for each in running:
        each.stdin.write("go\n")
        each.stdin.flush()
    found = sorted(each.communicate()[0].split() for each in running)
    assert found == [["4.0", "0", "0"], ["4.0", "0", "0"], ["4.0", "1", "1"]]
