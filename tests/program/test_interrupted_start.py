"""Ctrl-C while the program is still loading: one line, the code of an interrupt, no traceback."""

import signal
import subprocess
import sys
import time

import pytest
from helpers.scenes import environment, needs_compiler, trial, write_scene

from clothfit.cli.program import _interrupt

pytestmark = pytest.mark.slow  # starts processes

# Sends the signal at the moment when a module is about to be imported.
START = """
import os, sys
from importlib.abc import MetaPathFinder
class Interrupt(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[1]:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), int(sys.argv[2]))
sys.meta_path.insert(0, Interrupt())
from clothfit.__main__ import main
main(sys.argv[3:])
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize(
    ("module", "kind"),
    [("clothfit.cli.program", signal.SIGINT), ("click", signal.SIGTERM), ("click", signal.SIGINT),
     ("clothfit.cli.simulate", signal.SIGINT), ("numpy", signal.SIGINT), ("numba", signal.SIGINT)],
)  # fmt: skip
def test_an_interrupt_while_loading_is_one_line(tmp_path, module, kind):
    scene = write_scene(tmp_path, trial("nG", 5, 3, 3))
    call = [sys.executable, "-c", START, module, str(int(kind)), "simulate", scene]
    done = subprocess.run(call, capture_output=True, env=environment(), check=False, timeout=50)
    assert (done.returncode, done.stdout) == (130, b"")
    assert done.stderr.lstrip() == b"error: interrupted\n"  # click may end the line that a terminal shows ^C on
    assert [path.name for path in tmp_path.iterdir()] == ["scene.json"]


# Sends the signal within a class that is made from text, after which `python -m` kills itself when it ends.
FROM_TEXT = """
import os, signal, sys
from importlib.abc import MetaPathFinder
class Interrupt(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == "numpy":
            sys.meta_path.remove(self)
            exec("os.kill(os.getpid(), signal.SIGINT)\\nfor _ in range(1000): pass")
sys.meta_path.insert(0, Interrupt())
from clothfit.__main__ import main
main(sys.argv[1:])
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_an_interrupt_in_what_is_made_from_text_keeps_the_code(tmp_path):
    scene = write_scene(tmp_path, trial("nG", 5, 3, 3))
    (tmp_path / "started.py").write_text(FROM_TEXT)
    call = [sys.executable, "-m", "started", "simulate", scene]
    done = subprocess.run(call, capture_output=True, env=environment(), cwd=tmp_path, check=False, timeout=50)
    assert (done.returncode, done.stdout) == (130, b"")
    assert done.stderr.lstrip() == b"error: interrupted\n"


# Sends the signal in the middle of a compilation, where an exception in what the compiler calls is lost.
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
from clothfit.__main__ import main
main(sys.argv[1:])
"""


@needs_compiler
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_an_interrupt_in_the_first_compilation_is_one_line(tmp_path):
    scene = write_scene(tmp_path, trial("nG", 5, 3, 3))
    call = [sys.executable, "-c", COMPILING, "simulate", scene]
    where = environment(NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    done = subprocess.run(call, capture_output=True, env=where, check=False, timeout=50)
    assert (done.returncode, done.stdout) == (130, b"")
    assert done.stderr.decode().splitlines()[-1] == "error: interrupted"
    assert b"Traceback" not in done.stderr


# As importlib's callback of a module's lock, and a destructor.
CALLBACKS = [("<frozen importlib._bootstrap>", "cb"), ("/usr/lib/python/weakref.py", "remove"), ("any.py", "__del__")]


@pytest.mark.parametrize(("file", "name"), CALLBACKS)
def test_an_interrupt_where_its_exception_would_be_lost_comes_later(file, name):
    space = {"interrupt": _interrupt, "frame": sys._getframe, "number": int(signal.SIGINT)}
    exec(compile(f"def {name}():\n    interrupt(number, frame())\n    return 'went on'", file, "exec"), space)
    assert space[name]() == "went on"
    with pytest.raises(KeyboardInterrupt):
        time.sleep(10.0)  # by Python's own handler, which is that of tests
