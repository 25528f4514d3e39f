"""The second thread: each share is done once and by one, and the thread ends with the block that asked for it."""

import os
import threading

import numba
import numpy as np
import pytest

from clothfit.engine.solve import two_threads
from clothfit.engine.solve.two_threads import SERVES, STOP


@numba.njit(nogil=True)
def serve(worker, done):
    """Note that it was done, and answer with the double of the parameter."""
    two_threads.enter(worker)
    while True:
        phase = two_threads.next_phase(worker)
        if phase == STOP:
            return
        done[1, int(phase)] += 1
        worker.message[0, 3] = 2.0 * worker.message[0, 1]
        two_threads.done(worker)


@numba.njit(nogil=True)
def ask(worker, done):
    """Post a phase after the other and do what the second thread does not come to; returns the sum of the answers."""
    total = 0.0
    for phase in range(done.shape[1]):
        worker.message[0, 1] = float(phase)
        two_threads.post(worker, float(phase))
        if not two_threads.claim(worker):
            two_threads.wait(worker)
            total += worker.message[0, 3]
        else:
            done[0, phase] += 1
            total += 2.0 * phase
            two_threads.done(worker)
    return total


def helpers():
    """The second threads that are there."""
    return [thread for thread in threading.enumerate() if thread.name == "clothfit-solve"]


def use(worker, phases=1000):
    """Let two threads, where there are two processors, go through phases: (2, phases), who did each how often."""
    done = np.zeros((2, phases), np.int64)
    with two_threads.serving(worker, lambda: serve(worker, done)):
        serving = len(helpers())
        assert ask(worker, done) == phases * (phases - 1)
    assert helpers() == []
    assert not worker.flags[SERVES]
    return done, serving


@pytest.fixture
def two(monkeypatch):
    """As if there were two processors."""
    monkeypatch.setattr(two_threads, "processors", lambda: 2)


def test_with_one_processor_all_is_done_alone(monkeypatch):
    monkeypatch.setattr(two_threads, "processors", lambda: 1)
    done, serving = use(two_threads.worker())
    assert serving == 0
    assert done.sum(axis=1).tolist() == [1000, 0]


@pytest.mark.usefixtures("two")
def test_two_threads_do_each_share_once():
    worker = two_threads.worker()
    for _ in range(3):  # a team is used again and again
        done, serving = use(worker)
        assert serving == 1
        assert (done.sum(axis=0) == 1).all()


@pytest.mark.usefixtures("two")
def test_a_block_within_another_has_its_thread():
    worker, done = two_threads.worker(), np.zeros((2, 100), np.int64)
    with two_threads.serving(worker, lambda: serve(worker, done)):
        with two_threads.serving(worker, lambda: pytest.fail("there is a thread")):
            assert len(helpers()) == 1
            ask(worker, done)
        assert len(helpers()) == 1  # one that took the STOP of the inner block would leave the outer one without
        ask(worker, done)
    assert helpers() == []
    assert (done.sum(axis=0) == 2).all()


@pytest.mark.usefixtures("two")
def test_the_second_thread_ends_with_the_block_that_fails():
    worker, done = two_threads.worker(), np.zeros((2, 10), np.int64)

    def fail():
        with two_threads.serving(worker, lambda: serve(worker, done)):
            assert len(helpers()) == 1
            raise ValueError("of the block")

    with pytest.raises(ValueError, match="of the block"):
        fail()
    assert helpers() == []
    assert not worker.flags.any()
    assert (use(worker)[0].sum(axis=0) == 1).all()


@pytest.mark.usefixtures("two")
def test_the_second_thread_ends_when_an_interrupt_comes_before_it_serves(monkeypatch):
    worker, done = two_threads.worker(), np.zeros((2, 10), np.int64)
    released = threading.Event()

    def interrupt(_):
        released.set()
        raise KeyboardInterrupt

    def late():
        released.wait()
        serve(worker, done)

    monkeypatch.setattr(two_threads.time, "sleep", interrupt)
    with pytest.raises(KeyboardInterrupt), two_threads.serving(worker, late):
        pytest.fail("the block is not entered")
    assert helpers() == []
    assert not worker.flags.any()


@pytest.mark.usefixtures("two")
def test_a_second_thread_that_does_not_come_is_not_waited_for():
    worker = two_threads.worker()
    with two_threads.serving(worker, lambda: None):
        done = np.zeros((2, 10), np.int64)
        ask(worker, done)
    assert done.tolist() == [[1] * 10, [0] * 10]


@pytest.mark.parametrize(("own", "all_there", "wish", "count"), [
    (1, None, {}, 1), (2, None, {}, 2), (5, None, {}, 5),
    (None, 4, {}, 4), (None, None, {}, 1),  # where processes have no processors of their own
    (2, None, {"NUMBA_NUM_THREADS": "2"}, 2), (2, None, {"NUMBA_NUM_THREADS": " 1 "}, 1),
    (2, None, {"OMP_NUM_THREADS": "2"}, 2), (2, None, {"OMP_NUM_THREADS": " 1 "}, 1),
])  # fmt: skip
def test_the_processors_are_those_of_the_process_unless_one_is_asked_for(monkeypatch, own, all_there, wish, count):
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    for name, value in wish.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(os, "cpu_count", lambda: all_there)
    if own is None:
        monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    else:
        monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(own)), raising=False)
    assert two_threads.processors() == count
