"""Compiled code: the same answers whether compiled just now or taken from the cache, and never from old sources."""

import hashlib
import subprocess
import sys

import pytest
from helpers.compiled import copied
from helpers.paths import TESTS
from helpers.scenes import environment, trial

from clothfit import cost_and_gradient, load, parameters, simulate, with_parameters

pytestmark = pytest.mark.slow  # starts processes

CALLED = ("engine.march.run-*", "derivative.adjoint.sweep_back-*")
"""Files with the code of the kernels that Python calls for a motion and its gradient. Those that they call are only
optimised, and translated to machine code, as parts of them (`kernels.linking`).
"""


def bits():
    """A number and a hash of a motion and a gradient."""
    scene = load(trial("LL", 12, 5, 5))
    motion = simulate(scene)
    cost, gradient = cost_and_gradient(with_parameters(scene, 1.1 * parameters(scene)), motion)
    return f"{cost.hex()} {hashlib.sha256(motion.positions.tobytes() + gradient.tobytes()).hexdigest()}\n"


BITS = """
import importlib.util, sys
sys.path.insert(0, sys.argv[1])
made = importlib.util.spec_from_file_location("test_kernel", sys.argv[2])
module = importlib.util.module_from_spec(made)
made.loader.exec_module(module)
print(module.bits(), end="")
"""


def test_compiled_now_or_cached_the_bits_are_the_same(tmp_path):
    here = bits()  # so that all is compiled
    folder = copied(tmp_path, *CALLED)
    call = [sys.executable, "-c", BITS, str(TESTS), __file__]
    first, second = (
        subprocess.check_output(call, text=True, env=environment(NUMBA_CACHE_DIR=str(tmp_path))) for _ in range(2)
    )
    assert first == second == here
    assert all([*folder.glob(pattern)] for pattern in CALLED)  # compiled by the first
