"""Requests to end that wait, deadlines, and what is left of them."""

import signal
import time

import pytest

from clothfit.base import interrupts


@pytest.fixture(autouse=True)
def _clean():
    interrupts.clear()
    yield
    interrupts.clear()


def test_a_request_raises_at_the_next_check_until_it_is_cleared():
    interrupts.check()
    interrupts.request()
    with pytest.raises(KeyboardInterrupt):
        interrupts.check()
    interrupts.clear()
    interrupts.check()


def test_before_there_is_a_result_a_signal_raises_at_once_and_with_one_it_waits_for_a_check():
    with pytest.raises(KeyboardInterrupt), interrupts.deferred():
        signal.raise_signal(signal.SIGINT)
    interrupts.check()
    before, passed = signal.getsignal(signal.SIGINT), []
    with interrupts.deferred():
        interrupts.hold()
        signal.raise_signal(signal.SIGINT)
        passed.append("the next line")
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
        interrupts.answer()
        signal.raise_signal(signal.SIGINT)
        interrupts.check()
        assert interrupts.requested()
    assert passed
    assert not interrupts.requested()
    assert signal.getsignal(signal.SIGINT) is before


def test_a_second_request_ends_what_does_not_look(monkeypatch):
    monkeypatch.setattr(interrupts, "SAME_REQUEST", 0.0)
    with interrupts.deferred():
        interrupts.hold()
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_the_outer_block_keeps_a_request_of_the_inner_one():
    with interrupts.deferred():
        with interrupts.deferred():
            interrupts.request()
            interrupts.answer()
        assert interrupts.requested()
        interrupts.check()


def test_a_deadline_is_the_earlier_of_two_and_ends_with_its_block():
    with interrupts.limited(0.0):
        time.sleep(1e-3)
        with pytest.raises(interrupts.OutOfTime), interrupts.limited(60.0):
            interrupts.check()
        with interrupts.grace(60.0):
            interrupts.check()
    interrupts.check()


def test_what_is_short_runs_in_spite_of_a_request():
    with interrupts.deferred():
        interrupts.request()
        with interrupts.grace(60.0):
            interrupts.check()
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
