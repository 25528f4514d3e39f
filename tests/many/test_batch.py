"""Many jobs: each is told once, whatever becomes of the others, of their processes and of the pool."""

import os
import signal

import pytest

from clothfit.base.errors import InvalidInput
from clothfit.many.batch import CUT_SHORT, Batch
from clothfit.many.job import FAULT, NOT_STARTED, PREPARATION, Died, File, Job, Lost, Outcome

pytestmark = pytest.mark.slow  # compiles a fit

JOB = Job(File(b"", "a"))
DONE = Outcome(None, 0)
BEST = Outcome(None, 130, "best so far")


class Plain:
    """A pool whose jobs end at once, but for those of which `fates` says something else, each time they are begun."""

    retried_alone = True
    width = 2

    def __init__(self, **fates):
        self.fates = {int(name[1:]): list(fate) for name, fate in fates.items()}
        self.begun, self.together, self.running, self.held = [], [], set(), []
        self.calls = []

    def prepare(self, done):
        return False

    def submit(self, number, job, done):
        self.begun.append(number)
        self.running.add(number)
        self.together.append(set(self.running))
        fate = self.fates.get(number, [None])[0]
        if fate == "hangs":
            self.held.append((number, done))
        else:
            done(number)
        if fate == "asks":
            os.kill(os.getpid(), signal.SIGINT)

    def outcome(self, number):
        self.running.discard(number)
        fate = self.fates.get(number, [None]).pop(0) if self.fates.get(number) else None
        if fate == "hangs":
            return BEST
        if isinstance(fate, Exception):
            raise fate
        return DONE

    def check(self):
        pass

    def interrupt(self):
        self.calls.append("interrupt")
        for number, done in self.held:
            done(number)

    def close(self, kill=False):
        self.calls.append(f"close {kill}")


def told(pool, count=4, makers=None):
    """What a batch of jobs tells: (number, outcome), in order."""
    found = []
    Batch(pool, makers or [lambda: JOB] * count, lambda *what: found.append(what)).run()
    return found


def outcomes(found):
    """By number, each of which must have come once."""
    final = [(number, outcome) for number, outcome in found if outcome is not None]
    assert len(dict(final)) == len(final)
    return [dict(final)[number] for number in range(len(final))]


def test_all_jobs_are_done_and_no_more_at_a_time_than_there_is_room_for():
    pool = Plain()
    assert outcomes(told(pool, 5)) == [DONE] * 5
    assert pool.begun == [0, 1, 2, 3, 4]
    assert max(map(len, pool.together)) == 2


def test_a_job_that_cannot_be_made_is_told_and_the_others_are_done():
    def broken():
        raise InvalidInput("a.json: cannot be read")

    made = [lambda: JOB, broken, lambda: JOB]
    assert outcomes(told(Plain(), makers=made)) == [DONE, Outcome(None, 3, "a.json: cannot be read"), DONE]


def test_a_job_whose_process_died_is_begun_once_more_alone_after_all_others():
    pool = Plain(j0=[Died("it died"), None])
    found = told(pool)
    assert found[0] == (0, None)
    assert found[-1] == (0, DONE)
    assert outcomes(found) == [DONE] * 4
    assert (pool.begun[-1], pool.together[-1]) == (0, {0})


@pytest.mark.parametrize(
    ("again", "times", "error"), [(True, 2, "it died, and again when it was alone"), (False, 1, "it died")]
)
def test_one_that_dies_again_or_in_a_pool_that_has_tried_again_is_a_fault_of_its_own(again, times, error):
    pool = Plain(j1=[Died("it died")] * times)
    pool.retried_alone = again
    assert outcomes(told(pool)) == [DONE, Outcome(None, FAULT, error), DONE, DONE]
    assert pool.begun.count(1) == times


def test_a_lost_pool_ends_what_is_not_done():
    class Silent(Plain):
        def check(self):
            raise Lost("it is gone")

    gone = Outcome(None, 3, "it is gone")
    assert outcomes(told(Plain(j1=[Lost("it is gone")]), 4)) == [DONE, gone, gone, gone]
    assert outcomes(told(Silent(j0=["hangs"], j1=["hangs"]), 3)) == [gone] * 3


def test_a_request_to_end_lets_what_runs_end_and_begins_no_more():
    pool = Plain(j0=["hangs"], j1=["asks"])
    found = outcomes(told(pool, 4))
    assert (found[0], found[-1], pool.calls) == (BEST, NOT_STARTED, ["interrupt"])
    with pytest.raises(KeyboardInterrupt):  # the handler is back
        os.kill(os.getpid(), signal.SIGINT)


def test_a_request_to_end_leaves_no_second_try_to_one_that_died():
    found = outcomes(told(Plain(j0=[Died("it died")], j1=["asks"]), 4))
    assert found[0] == Outcome(None, 130, "its process died; there was no second try")


def test_a_second_request_ends_at_once(monkeypatch):
    monkeypatch.setattr("clothfit.many.batch.SAME_REQUEST", -1.0)

    class Deaf(Plain):
        def interrupt(self):
            os.kill(os.getpid(), signal.SIGINT)

    pool = Deaf(j0=["hangs"], j1=["asks"])
    found = outcomes(told(pool, 4))
    assert found[0] == CUT_SHORT == Outcome(None, 130, "ended at once, by a second request; nothing is written")
    assert pool.calls == ["close True"]


def test_what_must_be_done_before_is_done_alone():
    class Cold(Plain):
        def prepare(self, done):
            self.begun.append(PREPARATION)
            self.held.append(done)
            return True

        def check(self):
            self.held.pop()(PREPARATION)

    pool = Cold()
    assert outcomes(told(pool, 3)) == [DONE] * 3
    assert pool.begun == [PREPARATION, 0, 1, 2]
