"""References to arrays: counted only where a kernel makes some, and none lost or kept either way."""

import sys

import numba
import numpy as np
import pytest
from numba.core import types
from numba.core.runtime import _nrt_python, rtsys

from clothfit.kernels import cache, compiling
from clothfit.kernels.kernel import kernel, objmode
from clothfit.kernels.linking import Linked


@kernel
def part(pair, k):
    """A view of an argument, which its caller then has a reference to."""
    return pair[0][k]


@kernel
def total(pair):
    """A sum over parts of the arguments: no references to count."""
    own, other = pair
    s = 0.0
    for row in own:
        s += row[0]
    for i in range(len(other)):
        s += other[i, 1:][0]
    return s


@kernel
def total_of_new(pair):
    """The same with arrays made on the way, of each kind of expression that makes one."""
    own, other = pair
    made = own + other
    some = own[np.array([0, 1])]
    copied = part(pair, 0).copy()
    copied[1:] = part(pair, 1)[1:]
    return total((made, some)) + copied[1]


@kernel
def entry(pair, i):
    return pair[0][i, 0]


@kernel
def flagged(pair, negative):
    return -total(pair) if negative else total(pair)


def arrays():
    own = np.arange(12.0).reshape(4, 3)
    return own, np.ascontiguousarray(own[::-1])


@pytest.fixture
def _counted():
    """numba counts what it allocates."""
    _nrt_python.memsys_enable_stats()
    yield
    _nrt_python.memsys_disable_stats()


@pytest.mark.slow
@pytest.mark.usefixtures("_counted")
@pytest.mark.parametrize("call", [total, total_of_new])
def test_no_reference_is_lost_or_kept(call):
    pair = arrays()
    expected = call.py_func(pair)
    call(pair)
    before, references = rtsys.get_allocation_stats(), [sys.getrefcount(each) for each in pair]
    for _ in range(100):
        assert call(pair) == expected
    after = rtsys.get_allocation_stats()
    assert after.alloc - before.alloc == after.free - before.free
    assert [sys.getrefcount(each) for each in pair] == references


@pytest.mark.slow
def test_one_code_for_both_values_of_a_flag_and_for_integers_of_both_widths_known_or_not():
    pair = numba.typeof(arrays())
    for flag in (types.literal(True), types.literal(False), types.boolean):
        flagged.inner.get_call_template((pair, flag), {})
    for index in (types.int32, types.int64, types.literal(3)):
        entry.inner.get_call_template((pair, index), {})
    assert list(flagged.inner.overloads) == [(pair, types.boolean)]
    assert list(entry.inner.overloads) == [(pair, types.int64)]


@kernel
def doubled(own):
    with objmode(result="float64"):
        result = 2.0 * float(own.sum())
    return result + 0.0


def test_a_kernel_with_a_part_in_the_interpreter_is_kept_as_code_to_link(tmp_path, monkeypatch):
    """So that another process, which has not compiled it, can link it."""
    monkeypatch.setattr(cache, "folders", lambda: (tmp_path / "kernels-here",))
    kinds = (numba.typeof(np.zeros(3)),)
    for _ in range(2):  # compiled, and loaded
        made = compiling.for_kernels(doubled.py_func)
        made.compile(kinds)
        assert isinstance(made.overloads[kinds].library, Linked)
    assert made.stats.cache_hits[kinds] == 1
    assert doubled(np.ones(3)) == 6.0
