"""Many scenes in processes: the same bytes as one by one, whatever their number; a process that is killed."""

import os
import signal
from types import SimpleNamespace

import pytest
from helpers.fits import estimate, estimate_many
from helpers.scenes import trial, write_scene

from clothfit import InvalidInput, degrade
from clothfit.fit.estimate import record_target
from clothfit.many.estimate_many import fit_all, result
from clothfit.many.job import Outcome, numbered
from clothfit.many.processes import Processes
from clothfit.scene.scene import dumps, load

pytestmark = pytest.mark.slow

FEW = {"method": "l-bfgs-b", "max_evaluations": 8}
SOME = {"max_evaluations": 9, "intervals": False}


@pytest.fixture
def paths(tmp_path):
    """Three scenes of different sizes."""
    return [write_scene(tmp_path, trial("LL", 10, 4, 4 + i), f"{i}.json") for i in range(3)]


def test_results_are_those_of_single_fits_to_the_last_bit_whatever_the_number_of_processes(paths, tmp_path):
    scenes = [load(path) for path in paths[:2]]
    motions = [degrade(record_target(scene), noise=1e-3, seed=1) for scene in scenes]
    fits = [
        [estimate(scene, motion, numbered(scene, motion, None, start, 5), **SOME) for start in range(2)]
        for scene, motion in zip(scenes, motions, strict=True)
    ]
    for jobs, given in ((1, scenes), (2, paths)):
        told = []
        many = [*given[:2], str(tmp_path / "none.json")]
        results = estimate_many(
            many, [*motions, None], starts=2, seed=5, jobs=jobs, done=lambda i, r, told=told: told.append(i), **SOME
        )
        assert sorted(told) == [0, 1, 2]
        assert [[o.fit.cost for o in r.outcomes] for r in results[:2]] == [[fit.cost for fit in own] for own in fits]
        for one, own in zip(results, fits, strict=False):
            cheapest = min(own, key=lambda fit: fit.cost)
            assert dumps(one.fit.scene) == dumps(cheapest.scene)
            assert own[one.best] is cheapest
        assert (results[2].exit_code, results[2].fit) == (3, None)
        assert results[2].error == "none.json: there is no such file"


class Killing(Processes):
    """Kills the processes that do some jobs, each so many times."""

    def __init__(self, width, times):
        super().__init__(width)
        self.times, self.begun = times, []

    def submit(self, number, job, done):
        super().submit(number, job, done)
        self.begun.append(number)
        if self.times.get(number):
            self.times[number] -= 1
            for pid in list(self._busy[number]._processes):
                os.kill(pid, signal.SIGKILL)


def test_a_killed_process_costs_time_only_and_one_that_is_killed_again_is_a_fault(paths, makers):
    died, pool = [], Killing(2, {0: 2, 1: 1})
    results = fit_all(makers(paths, **FEW), 1, pool, died=died.append)
    assert (sorted(died), sorted(pool.begun)) == ([0, 1], [0, 0, 1, 1, 2])
    assert [r.exit_code for r in results] == [1, 5, 5]
    assert results[0].error == "the process that fitted it died, out of memory or killed, and again when it was alone"
    expected = [dumps(estimate(load(path), **FEW).scene) for path in paths[1:]]
    assert [dumps(r.fit.scene) for r in results[1:]] == expected


def test_no_result_is_better_than_a_usable_one_and_ties_go_to_the_first():
    some, low = (Outcome(SimpleNamespace(status="limit", cost=cost), 5) for cost in (2.0, 1.0))
    bad = Outcome(None, 4, "no")
    assert [result(each).best for each in ([bad, some, low, low], [bad, some, some], [bad, bad])] == [2, 1, 0]
    assert result([bad, bad]).error == "no"
    assert result([some, Outcome(None, 130, "not started")]).exit_code == 130


@pytest.mark.parametrize(
    ("options", "message"),
    [({"starts": 0}, "starts must be at least 1; 0 was given"), ({"seed": -1}, "seed must be at least 0; -1 was given"),
     ({"jobs": 0}, "jobs must be at least 1; 0 was given"), ({"targets": []}, "targets: 0 are given for 1 scenes"),
     ({"cluster": "here"}, "--cluster: here is no address of a scheduler")],
)  # fmt: skip
def test_arguments_that_cannot_be(options, message):
    with pytest.raises(InvalidInput, match=message):
        estimate_many(["a.json"], **options)
