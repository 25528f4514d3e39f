"""Records and absent parts: what kernels get in place of a tuple, or of nothing."""

import sys
from typing import NamedTuple

import numba
import numpy as np
import pytest

from clothfit.kernels.kernel import kernel, record
from clothfit.many.warmup import compilations

compiles = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")


@record
class Inner(NamedTuple):
    flag: bool
    values: np.ndarray


@record
class Outer(NamedTuple):
    scale: float
    inner: Inner
    table: np.ndarray
    number: int
    nothing: None


def made():
    return Outer(0.5, Inner(True, np.array([1.0, 2.0])), np.arange(6.0).reshape(2, 3), 7, None)


@kernel
def add_up(inner, out):
    total = 0.0
    for i in range(len(inner.values)):
        total += inner.values[i]
        out[i] = inner.values[i]
    return total if inner.flag else -total


@kernel
def entry(own, out):
    return own.scale * add_up(own.inner, out) + own.table[1, 2] + own.number


def test_fields_of_a_record_and_of_one_within_it_are_read():
    own, out = made(), np.zeros(2)
    assert entry(own, out) == 0.5 * 3.0 + 5.0 + 7
    assert entry(own._replace(inner=own.inner._replace(flag=False), number=0), out) == -1.5 + 5.0
    assert out.tolist() == [1.0, 2.0]


@compiles
def test_a_call_leaves_no_reference_behind():
    own, out = made(), np.zeros(2)
    entry(own, out)
    before = sys.getrefcount(own.table), sys.getrefcount(own.inner.values)
    for _ in range(10):
        entry(own, out)
    assert (sys.getrefcount(own.table), sys.getrefcount(own.inner.values)) == before


@kernel
def fill(own, value):
    own.table[:] = value


def test_arrays_of_a_record_are_those_of_the_caller():
    own = made()
    fill(own, 3.0)
    assert (own.table == 3.0).all()


@kernel(absent=4.0)
def of_part(part, x):
    return part[0] * x


@kernel
def with_part(part, x):
    return 1.0 + of_part(part, x)


def test_an_absent_part_has_its_value_wherever_it_is_called():
    assert (of_part(None, 2.0), with_part(None, 2.0)) == (4.0, 5.0)
    assert (of_part(np.array([3.0]), 2.0), with_part(np.array([3.0]), 2.0)) == (6.0, 7.0)


@compiles
def test_nothing_is_compiled_for_a_part_that_is_absent():
    @kernel(absent=None)
    def touch(part, x):
        x[0] = part[0]

    @kernel
    def touched(part, x):
        touch(part, x)
        return x[0]

    with compilations() as found:
        assert touched(None, np.array([2.0])) == 2.0
    assert not any(name.endswith(".touch") for name in found)
