"""Records, absent parts and kernels that are called apart: what there is in place of a tuple, of nothing, of code."""

import signal
import sys
import types
from typing import NamedTuple

import numba
import numpy as np
import pytest

from clothfit.kernels.kernel import kernel, record
from clothfit.many.warmup import compilations


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
    pair: tuple
    mixed: tuple


def made():
    pair = np.arange(4, dtype=np.int32), np.arange(6, 10, dtype=np.int32)
    mixed = 0.25, np.arange(24.0).reshape(2, 3, 4)[::-1, :, ::2], (True, 3)
    return Outer(0.5, Inner(True, np.array([1.0, 2.0])), np.arange(6.0).reshape(2, 3), 7, None, pair, mixed)


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


@kernel
def look(own, out):
    """Parts of tuples within the record: arrays of two types, one of them with strides of its own, and numbers."""
    scale, table, (flag, number) = own.mixed
    out[:] = own.pair[1]
    for i in range(table.shape[0]):
        for j in range(table.shape[1]):
            for k in range(table.shape[2]):
                out[k] += scale * table[i, j, k] * (i + 1) * (j + 2)
    return number + len(own.pair[0]) + table.size if flag else 0


def test_tuples_within_a_record_are_read_with_the_strides_of_their_arrays():
    own, out = made(), np.zeros(4)
    table = own.mixed[1]
    weights = np.array([1, 2])[:, None] * np.array([2, 3, 4])
    assert look(own, out) == 3 + 4 + 12
    assert out.tolist() == [*(own.pair[1][:2] + 0.25 * np.einsum("ijk,ij->k", table, weights)), 8.0, 9.0]


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


@pytest.fixture
def apart(monkeypatch):
    """A kernel that is called apart, and two that call it, one of them only for positive numbers."""

    @kernel(apart=0.0)
    def twice(x):
        if x > 100.0:
            raise ValueError("too large")
        return 2.0 * x

    @kernel
    def thrice(x):
        return twice(x) + x

    @kernel
    def relu(x):
        return 0.5 * twice(x) if x > 0.0 else 0.0

    place = types.ModuleType("with_twice")  # where it is looked for when it is called
    place.twice = twice
    monkeypatch.setitem(sys.modules, place.__name__, place)
    function = getattr(twice, "py_func", twice)
    function.__module__, function.__qualname__ = place.__name__, "twice"
    return twice, thrice, relu


def test_a_kernel_that_is_called_apart_gives_what_it_returns_or_its_error(apart):
    _, thrice, relu = apart
    assert (thrice(2.0), relu(3.0), relu(-3.0)) == (6.0, 3.0, 0.0)
    with pytest.raises(ValueError, match="too large"):
        thrice(101.0)


def test_there_is_code_of_it_when_it_is_needed_and_once(apart):
    twice, thrice, relu = apart
    relu(-1.0)
    assert len(twice.inner.overloads) == 0
    relu(1.0)
    thrice(1.0)
    assert len(twice.inner.overloads) == 1


@pytest.mark.parametrize("address", [lambda *_: signal.raise_signal(signal.SIGINT), lambda *_: 0])
def test_what_ends_its_compilation_is_raised_by_the_call_and_the_next_call_compiles_it(apart, monkeypatch, address):
    """Ctrl-C meanwhile, or before all else: then there is no code, and no reason why."""
    twice, thrice, _ = apart
    with monkeypatch.context() as patch:
        patch.setattr(type(twice), "address", address)
        with pytest.raises(KeyboardInterrupt):
            thrice(1.0)
    assert thrice(1.0) == 3.0


def test_python_calls_the_same_code_as_kernels_do(apart):
    twice, thrice, _ = apart
    thrice(1.0)
    with compilations() as found:
        assert twice(4.0) == 8.0
    assert len(twice.inner.overloads) == 1
    assert len(found) <= 1  # of the call


@pytest.mark.parametrize("marks", [{"apart": 1}, {"apart": True}, {"apart": None}])
def test_an_example_of_another_type_than_the_result_is_an_error(marks):
    @kernel(**marks)
    def half(x):
        return 0.5 * x

    with pytest.raises(TypeError, match="half returns float64, not"):
        half.address((numba.float64,))


def test_marks_that_contradict_each_other_are_an_error():
    def first(part):
        return part[0]

    with pytest.raises(TypeError, match="called apart"):
        kernel(empty=0.0)(first)
    with pytest.raises(TypeError, match="returns int64, and float64 without the part"):
        _ = kernel(absent=0.0, apart=0)(first).inner


def test_arguments_by_name_are_an_error(apart):
    twice = apart[0]

    @kernel
    def by_name(x):
        return twice(x=x)

    with pytest.raises(numba.TypingError, match="twice wants all its arguments, by their places"):
        by_name(1.0)


def nested(depth):
    """A tuple of so many tuples within each other, the record that holds it counted."""
    values = (np.ones(1),)
    for _ in range(depth - 2):
        values = (values,)
    return Only(values)


@record
class Only(NamedTuple):
    part: object


@kernel
def length(own):
    return len(own)


def test_what_a_record_cannot_hold_is_an_error():
    assert length(nested(8)) == 1
    for own, message in ((nested(9), "more than 8 tuples"), (Only(1j), "holds no complex128")):
        with pytest.raises(Exception, match=message):
            length(own)


@kernel(empty=4.0, apart=0.0)
def of_rows(part, x):
    return part[0][0] * x


@kernel
def with_rows(part, x):
    return 1.0 + of_rows(part, x)


def test_a_part_without_rows_is_as_absent_as_none():
    empty, full = (np.zeros(0), 1.0), (np.array([3.0]), 1.0)
    for part, value in ((None, 4.0), (empty, 4.0), (full, 6.0)):
        assert (of_rows(part, 2.0), with_rows(part, 2.0)) == (value, 1.0 + value)
