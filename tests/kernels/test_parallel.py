"""Parts of a computation on two threads: the results, faults and interrupts of one thread."""

import os
import threading
from functools import partial

import pytest

from clothfit.base import interrupts
from clothfit.kernels import parallel
from clothfit.kernels.parallel import only_here, processors, together


@pytest.fixture(params=[1, 2, 3])
def count(request, monkeypatch):
    """Processors."""
    monkeypatch.setattr(parallel, "processors", lambda: request.param)
    return request.param


@pytest.fixture
def two(monkeypatch):
    monkeypatch.setattr(parallel, "processors", lambda: 2)


def waits_for(event):
    """A part that ends when it is interrupted, or when the event comes."""
    while not event.wait(1e-3):
        interrupts.check()
    return "came"


def fails(error):
    raise error


def test_results_come_in_the_order_of_the_parts(count):
    assert together([partial(pow, i, 2) for i in range(7)]) == [i * i for i in range(7)]
    assert together([]) == []


def test_of_several_faults_the_first_is_raised(count):
    parts = [lambda: 0, partial(fails, KeyError("b")), partial(fails, IndexError("c")), lambda: 3]
    with pytest.raises(KeyError, match="b"):
        together(parts)


@pytest.mark.usefixtures("two")
def test_two_parts_run_at_once():
    """Each waits for the other."""
    first, second = threading.Event(), threading.Event()
    assert together([lambda: (first.set(), waits_for(second))[1], lambda: (second.set(), waits_for(first))[1]]) == [
        "came",
        "came",
    ]


@pytest.mark.usefixtures("two")
def test_an_interrupt_of_the_thread_that_waits_ends_the_other():
    never, begun, ended, main = threading.Event(), threading.Event(), threading.Event(), threading.get_ident()

    def either():
        if threading.get_ident() == main:
            begun.wait()
            raise KeyboardInterrupt
        begun.set()
        try:
            waits_for(never)
        except KeyboardInterrupt:
            ended.set()
            raise

    with pytest.raises(KeyboardInterrupt):
        together([either, either])
    assert ended.is_set()
    interrupts.check()  # this thread goes on as before


@pytest.mark.usefixtures("two")
def test_a_request_is_heard_by_all_parts():
    both = threading.Barrier(2)

    def part():
        both.wait()
        interrupts.request()
        interrupts.check()

    try:
        with pytest.raises(KeyboardInterrupt):
            together([part, part])
    finally:
        interrupts.clear()


@pytest.mark.usefixtures("two")
def test_a_deadline_is_heard_by_all_parts():
    with interrupts.limited(0.0), pytest.raises(interrupts.OutOfTime):
        together([interrupts.check, interrupts.check])


def test_within_a_part_there_is_one_processor(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    assert processors() == 2
    assert together([processors, processors]) == [1, 1]
    assert processors() == 2


@pytest.mark.usefixtures("two")
def test_a_report_is_for_the_thread_that_began():
    heard, both = [], threading.Barrier(2)
    report = only_here(lambda: heard.append(threading.get_ident()))
    together([lambda: (both.wait(), report()), lambda: (both.wait(), report())])
    assert heard == [threading.get_ident()]
    assert only_here(None) is None
