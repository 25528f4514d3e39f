"""Many scenes in processes: the same bytes as one by one, whatever their number; a process that is killed."""

import os
import signal
from functools import partial

import numba
import pytest
from scenes import trial, write_scene

import clothfit
from clothfit.errors import InvalidInput
from clothfit.fit import estimate, record_target
from clothfit.job import Job, Outcome, read
from clothfit.many import estimate_many, fit_all, result
from clothfit.pool import Processes
from clothfit.scene import dumps, load
from clothfit.starts import numbered

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="hundreds of simulations need compilation")

FEW = {"method": "l-bfgs-b", "budget": 8}


@pytest.fixture
def paths(tmp_path):
    """Three scenes of different sizes."""
    return [write_scene(tmp_path, trial("LL", 20, 4, 4 + i), f"{i}.json") for i in range(3)]


def bytes_of(results):
    return [dumps(one.fit.scene) for one in results]


def test_results_are_those_of_single_fits_to_the_last_bit_whatever_the_number_of_processes(paths):
    motions = [clothfit.degrade(record_target(load(path)), noise=1e-3, seed=1) for path in paths]
    single = [dumps(estimate(load(path), motion).scene) for path, motion in zip(paths, motions, strict=True)]
    one = estimate_many([load(path) for path in paths], motions, jobs=1)
    two = estimate_many(paths, motions, jobs=2)
    assert bytes_of(one) == single
    assert bytes_of(two) == single
    assert [r.exit_code for r in two] == [0, 0, 0]


def test_the_best_of_several_starts_does_not_depend_on_the_number_of_processes(paths):
    runs = [estimate_many(paths[:2], start=3.0, starts=3, seed=5, jobs=n, **FEW) for n in (1, 2)]
    assert bytes_of(runs[0]) == bytes_of(runs[1])
    for index, one in enumerate(runs[0]):
        scene = load(paths[index])
        costs = [estimate(scene, None, numbered(scene, None, 3.0, k, 5), **FEW).cost for k in range(3)]
        assert [o.fit.cost for o in one.outcomes] == costs
        assert one.best == costs.index(min(costs))
        assert one.fit.cost == min(costs)


def test_what_fails_is_a_result_and_the_others_are_fitted(paths, tmp_path):
    told = []
    results = estimate_many([paths[0], str(tmp_path / "none.json")], jobs=2, done=lambda i, r: told.append(i), **FEW)
    assert [r.exit_code for r in results] == [5, 3]
    assert results[1].fit is None
    assert results[1].error == "none.json: cannot be read: No such file or directory"
    assert sorted(told) == [0, 1]


class Killing(Processes):
    """Kills the process that does a job, each time until it has done so often enough."""

    def __init__(self, width, victim, times):
        super().__init__(width)
        self.victim, self.times, self.begun = victim, times, []

    def submit(self, number, job, done):
        super().submit(number, job, done)
        self.begun.append(number)
        if number == self.victim and self.times:
            self.times -= 1
            for pid in list(self._busy[number]._processes):
                os.kill(pid, signal.SIGKILL)


def makers(paths):
    return [partial(lambda path, number: Job(read(path), number=number, options=FEW), path) for path in paths]


def test_a_killed_process_costs_time_only(paths):
    expected = bytes_of(estimate_many(paths, jobs=2, **FEW))
    died, pool = [], Killing(2, 1, 1)
    results = fit_all(makers(paths), 1, pool, died=died.append)
    assert bytes_of(results) == expected
    assert (died, pool.begun) == ([1], [0, 1, 2, 1])


def test_one_that_is_killed_again_is_a_fault_and_the_others_are_fitted(paths):
    results = fit_all(makers(paths[:2]), 1, Killing(2, 0, 2))
    assert [r.exit_code for r in results] == [1, 5]
    assert results[0].error == "the process that fitted it died, out of memory or killed, and again when it was alone"


def test_no_result_is_better_than_a_usable_one_and_ties_go_to_the_first():
    class Fit:
        status, cost = "limit", 2.0

    class Cheaper(Fit):
        cost = 1.0

    bad, some, low = Outcome(None, 4, "no"), Outcome(Fit(), 5), Outcome(Cheaper(), 5)
    assert result([bad, some, low, low]).best == 2
    assert result([bad, some, some]).best == 1
    assert (result([bad, bad]).best, result([bad, bad]).error) == (0, "no")
    assert result([some, Outcome(None, 130, "not started")]).exit_code == 130


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"starts": 0}, "starts: 0 is not possible"),
        ({"seed": -1}, "seed: -1 is not possible"),
        ({"jobs": 0}, "jobs: 0 is not possible"),
        ({"targets": []}, "targets: 0 are given for 1 scenes"),
        ({"cluster": "here"}, "--cluster: here is no address of a scheduler"),
    ],
)
def test_arguments_that_cannot_be(options, message):
    with pytest.raises(InvalidInput, match=message):
        estimate_many(["a.json"], **options)
