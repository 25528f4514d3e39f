"""A job: what travels, what it does, and that nothing which happens in it is raised."""

import json
import pickle
from dataclasses import replace

import numba
import pytest
from helpers.scenes import even, trial, write_scene

from clothfit.base import interrupts
from clothfit.base.errors import InvalidInput
from clothfit.fit.estimate import estimate, record_target
from clothfit.fit.options import options_of
from clothfit.many import warmup
from clothfit.many.cluster import stop, work
from clothfit.many.job import NOT_STARTED, File, Job, failed, read, run
from clothfit.many.processes import is_cold
from clothfit.motion.motion import save_motion
from clothfit.scene.scene import dumps, load

pytestmark = [
    pytest.mark.slow,  # compiles a fit
    pytest.mark.skipif(numba.config.DISABLE_JIT, reason="hundreds of simulations need compilation"),
]

FEW = {"method": "l-bfgs-b", "max_evaluations": 5}


def packed(scene):
    return File(json.dumps(scene).encode(), "a.json")


def test_a_job_and_its_outcome_survive_a_journey_and_give_the_fit_of_its_files(tmp_path):
    path = write_scene(tmp_path, trial("LL"))
    guess = write_scene(tmp_path, trial("nn", vertMass=[0.03] * 16), "guess.json")
    save_motion(record_target(load(path)), str(tmp_path / "t.npz"))
    goals = ((read(tmp_path / "t.npz"), None), (read(tmp_path / "t.npz"), read(path)))
    job = pickle.loads(pickle.dumps(Job(read(path), goals, read(guess), options=options_of("estimate", FEW))))
    outcome = pickle.loads(pickle.dumps(run(job)))
    motion = record_target(load(path))
    same = estimate(load(path), [motion, motion], load(guess), **FEW)
    assert (outcome.exit_code, outcome.error, outcome.status) == (5, None, "limit")
    assert (outcome.fit.cost, outcome.fit.evaluations) == (same.cost, same.evaluations)
    assert dumps(outcome.fit.scene) == dumps(same.scene)
    assert outcome.fit.scene.name == "scene.json"


@pytest.mark.parametrize(
    ("scene", "code", "status", "message"),
    [
        (trial("nn"), 3, "failed", "a.json: nothing to fit"),
        ({"objects": 1}, 3, "failed", "a.json: "),
        (even("nG", 60, integrationMethod=0, delta=0.004, springStiffness=[1e3] * 33), 4, "diverged", "a.json: the"),
    ],
)
def test_what_goes_wrong_is_an_outcome(scene, code, status, message):
    outcome = run(Job(packed(scene)))
    assert (outcome.fit, outcome.exit_code, outcome.status) == (None, code, status)
    assert outcome.error.startswith(message)


def test_a_target_that_does_not_fit_is_named():
    other = packed(trial("Ln", nx=3))
    motion = record_target(load(trial("Ln", nx=3)))
    assert run(Job(packed(trial("Ln")), ((motion, None),))).error.startswith("scene: its objects")
    assert run(Job(packed(trial("Ln")), ((File(b"x", "t.npz"), other),))).error.startswith("t.npz: cannot be read")


def test_a_job_of_another_version_is_refused():
    outcome = run(replace(Job(packed(trial("Ln"))), version="0.0.1"))
    assert outcome.exit_code == 3
    assert "the job comes from 0.0.1" in outcome.error


def test_all_errors_have_a_sentence():
    assert failed(MemoryError()).error == "out of memory; try fewer frames (optimizationIterations)"
    assert failed(KeyboardInterrupt()).error == "interrupted before there was a result"
    assert failed(ZeroDivisionError("x")).error == "a fault of the program: ZeroDivisionError: x"
    assert (failed(KeyboardInterrupt()).exit_code, failed(KeyboardInterrupt()).status) == (130, "interrupted")
    assert (failed(InvalidInput("no")).exit_code, failed(InvalidInput("no")).error) == (3, "no")


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(InvalidInput, match=r"^none\.json: there is no such file"):
        read(tmp_path / "none.json")


def test_on_a_cluster_a_batch_that_was_ended_begins_nothing_more_and_others_go_on():
    job = Job(packed(trial("Ln")), options=options_of("estimate", FEW))
    stop("this")
    assert work(job, "this") == NOT_STARTED
    assert work(job, "that").fit is not None
    interrupts.check()  # no request is left behind


def test_whether_fits_are_compiled_is_known_from_the_cache(tmp_path, monkeypatch):
    warmup.warm()
    assert not is_cold()
    monkeypatch.setattr("clothfit.kernels.cache.folders", lambda: (tmp_path / "none",))
    assert is_cold()
