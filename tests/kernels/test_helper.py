"""The process that compiles along: it leaves the same code, but for the entry itself, and ends with the program."""

import os
import pickle
import subprocess
import sys

import pytest
from helpers.scenes import environment

from clothfit.kernels import helper

pytestmark = pytest.mark.slow  # starts processes

INFER = """
import numba, numpy as np
from clothfit.kernels import backward
import clothfit.kernels.vectors as v
kinds = (numba.typeof(1.0), numba.typeof(np.zeros((2, 3))), numba.typeof(np.zeros((2, 3))))
BACKWARD
ENTRY
"""


def kept(folder):
    """The files of compiled code below a folder, by the functions they are of."""
    return sorted(name.rsplit("-", 2)[0] for _, _, names in os.walk(folder) for name in names if name[0] != ".")


def run(tmp_path, name, *lines):
    text = INFER.replace("BACKWARD", lines[0]).replace("ENTRY", lines[1])
    folder = tmp_path / name
    subprocess.run([sys.executable, "-c", text], env=environment(NUMBA_CACHE_DIR=str(folder)), check=True)
    return kept(folder)


def test_it_compiles_what_an_entry_calls_and_not_the_entry(tmp_path):
    alone = run(tmp_path, "alone", "", "v.add.outer.compile(kinds)")
    along = run(tmp_path, "along", "backward.from_the_end()", "backward.infer(v.add.py_func, kinds)")
    assert alone == ["kernels.vectors.add", "kernels.vectors.combine"]
    assert along == ["kernels.vectors.combine"]


def test_it_ends_when_the_program_does_whatever_it_is_told():
    call = [sys.executable, "-c", helper.SERVE]
    with subprocess.Popen(call, stdin=subprocess.PIPE, env=environment()) as process:
        job = pickle.dumps(("clothfit.no.such", "kernel", (), False))
        process.stdin.write(len(job).to_bytes(8, "little") + job)
        process.stdin.close()
        assert process.wait(60) == 0
