"""The clock of a fit counts computing, but not compilation."""

import time

import numba
import pytest
from numba.core import event
from numba.core.compiler_lock import global_compiler_lock

from clothfit.base import interrupts
from clothfit.kernels import clock


class Times:
    """A clock that goes when it is told to."""

    def __init__(self, monkeypatch):
        self.now = time.process_time()
        monkeypatch.setattr(clock.time, "process_time", lambda: self.now)
        monkeypatch.setattr(clock.time, "perf_counter", lambda: self.now)

    def spend(self, seconds):
        self.now += seconds


def test_only_what_is_not_compilation_counts(monkeypatch):
    times, began, before = Times(monkeypatch), clock.computing(), clock.elapsed()
    times.spend(1.0)
    with global_compiler_lock:
        times.spend(10.0)
        with global_compiler_lock:  # of a function that the first one calls
            times.spend(20.0)
        times.spend(40.0)
    times.spend(2.0)
    assert clock.computing() - began == pytest.approx(3.0, abs=1e-9)  # sums of seconds
    assert clock.elapsed() - before == pytest.approx(3.0, abs=1e-9)


def test_a_function_that_is_compiled_takes_no_time(monkeypatch):
    times, began = Times(monkeypatch), clock.computing()

    def at_compilation(event):
        times.spend(5.0)

    listener = clock.event.RecordingListener()
    listener.on_start = at_compilation
    with event.install_listener("numba:compile", listener):
        assert numba.njit(lambda x: x + 1)(2) == 3
    assert times.now - began >= 5.0
    assert clock.computing() - began == pytest.approx(0.0, abs=1e-9)  # sums of seconds


def test_an_exception_between_two_lines_of_the_compiler_does_not_stop_the_clock(monkeypatch):
    times = Times(monkeypatch)
    event.start_event("numba:compiler_lock")  # and it never ends
    began = clock.computing()
    times.spend(3.0)
    assert clock.computing() - began == pytest.approx(3.0, abs=1e-9)  # sums of seconds


def test_a_deadline_waits_for_compilation(monkeypatch):
    times = Times(monkeypatch)
    monkeypatch.setattr(interrupts.time, "monotonic", lambda: times.now)
    with interrupts.limited(5.0), interrupts.limited(7.0):
        times.spend(4.0)
        with global_compiler_lock:
            times.spend(100.0)
        times.spend(0.5)
        interrupts.check()  # 4.5 s of 5
        times.spend(1.0)
        with pytest.raises(interrupts.OutOfTime):
            interrupts.check()
