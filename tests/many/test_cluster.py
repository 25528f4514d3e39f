"""A real Dask scheduler with two workers, one of which is killed in the middle of a job: nothing is lost."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from helpers.fits import estimate
from helpers.scenes import environment, trial, write_scene

from clothfit import InvalidInput
from clothfit.cli.program import run
from clothfit.many.cluster import Cluster
from clothfit.many.estimate_many import fit_all
from clothfit.scene.scene import dumps, load

distributed = pytest.importorskip("distributed", reason="distributed is not installed; there is no cluster")
pytestmark = pytest.mark.slow

FEW = {"method": "l-bfgs-b", "intervals": False, "max_evaluations": 40}


@pytest.fixture(scope="module")
def cluster():
    """A scheduler in this process, two workers in processes of their own, which a nanny starts again."""
    estimate(load(trial("LL", 5, 3, 3)), **{**FEW, "max_evaluations": 2})  # no worker is killed while it compiles
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as made:
        yield made


@pytest.fixture
def paths(tmp_path):
    """Three scenes that take about a second each."""
    return [write_scene(tmp_path, trial("LL", 60, 8, 6 + i), f"{i}.json") for i in range(3)]


class Killing(Cluster):
    """Once all jobs are begun, kills a worker that does one, so many times."""

    def __init__(self, address, last, times=1):
        super().__init__(address)
        self.last, self.times, self.killed = last, times, []

    def submit(self, number, job, done):
        super().submit(number, job, done)
        while number == self.last and len(self.killed) < self.times:
            keys = self._client.processing()
            busy = [worker for worker, found in keys.items() if any(self.batch in key for key in found)]
            if busy:
                pid = self._client.run(os.getpid, workers=busy[:1])[busy[0]]
                os.kill(pid, signal.SIGKILL)
                self.killed.append(pid)
            time.sleep(0.02)


def test_a_killed_worker_loses_nothing_and_the_results_are_those_of_this_machine(cluster, paths, makers):
    pool = Killing(cluster.scheduler_address, 2)
    results = fit_all(makers(paths, 1.0, **FEW), 1, pool)
    assert len(pool.killed) == 1
    assert [r.exit_code for r in results] == [5, 5, 5]  # the budget is spent
    expected = [estimate(load(path), None, 1.0, **FEW) for path in paths]
    assert [dumps(r.fit.scene) for r in results] == [dumps(fit.scene) for fit in expected]


def test_a_job_whose_workers_die_as_often_as_the_scheduler_allows_is_a_fault(cluster, paths, makers, monkeypatch):
    monkeypatch.setattr(cluster.scheduler, "allowed_failures", 0)
    (result,) = fit_all(makers(paths[:1], 1.0, **FEW), 1, Killing(cluster.scheduler_address, 0))
    assert (result.exit_code, result.fit) == (1, None)
    assert result.error == "every worker that fitted it died, out of memory or killed"


def test_the_command_writes_what_it_writes_without_a_cluster(cluster, paths, tmp_path, capsys):
    options = ["--start", "1", "--max-evaluations", "3", "--method", "l-bfgs-b", "--no-intervals"]
    bad = write_scene(tmp_path, {"objects": 1}, "bad.json")
    there = ["--cluster", cluster.scheduler_address, "--json", "-q", "-o"]
    assert run(["estimate", *paths[:2], bad, *options, *there, str(tmp_path / "there")]) == 3
    found = json.loads(capsys.readouterr().out)
    assert [one["exit_code"] for one in found["scenes"]] == [5, 5, 3]
    assert run(["estimate", paths[1], *options, *there, str(tmp_path / "one.json")]) == 5
    assert json.loads(capsys.readouterr().out)["status"] == "limit"
    assert run(["estimate", paths[1], *options, "-q", "-o", str(tmp_path / "here.json")]) == 5
    here = (tmp_path / "here.json").read_bytes()
    assert (tmp_path / "there" / "1.fitted.json").read_bytes() == here
    assert (tmp_path / "one.json").read_bytes() == here


def test_a_worker_with_another_version_is_named(cluster, monkeypatch):
    monkeypatch.setattr("clothfit.many.cluster.__version__", "99.0")
    with pytest.raises(InvalidInput, match=r"the worker tcp://.* has clothfit 0\.1\.0; install 99\.0, as here"):
        Cluster(cluster.scheduler_address)


def test_a_scheduler_that_dies_is_told_and_ends_the_run(paths, makers):
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    call = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--no-dashboard", "--host", address]
    process = subprocess.Popen(call, env=environment(), stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    try:
        pool = connected(address)
        submit = pool.submit

        def submit_and_kill(number, job, done):
            submit(number, job, done)
            process.kill()

        pool.submit = submit_and_kill
        results = fit_all(makers(paths[:2], 1.0, **FEW), 1, pool)
    finally:
        process.kill()
        process.wait()
    assert [r.exit_code for r in results] == [3, 3]
    assert results[0].error == f"the scheduler at {address} was lost"


def connected(address):
    """The cluster at an address where a scheduler is just being started."""
    until = time.monotonic() + 20
    while True:
        try:
            return Cluster(address)
        except InvalidInput:
            if time.monotonic() > until:
                raise
            time.sleep(0.1)


@pytest.mark.parametrize(
    ("address", "message"),
    [("localhost", "localhost is no address of a scheduler; one looks like tcp://host:8786"),
     ("http://localhost:8786", "is no address of a scheduler"),
     ("tcp://localhost:1", "no scheduler answers at tcp://localhost:1")],
)  # fmt: skip
def test_where_no_scheduler_is_the_command_ends(tmp_path, address, message, capsys):
    assert run(["estimate", write_scene(tmp_path, trial("Ln")), "--cluster", address]) == 3
    assert message in capsys.readouterr().err


def test_what_this_machine_or_a_worker_lacks_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InvalidInput, match=r"install clothfit\[cluster\]"):
        Cluster("tcp://localhost:1")
    monkeypatch.undo()
    lacking = Cluster.__new__(Cluster)
    lacking._results = {0: ModuleNotFoundError("No module named 'numba'")}
    lacking._futures = {0: SimpleNamespace(release=lambda: None)}
    outcome = lacking.outcome(0)
    assert (outcome.exit_code, outcome.error) == (3, "a worker of the cluster lacks something: No module named 'numba'")
