"""A job: what travels, what it does, and that nothing which happens in it is raised."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.scenes import cloth, document, even, trial, write_scene

from clothfit.base import interrupts
from clothfit.base.errors import InvalidInput
from clothfit.fit.estimate import record_target
from clothfit.fit.options import Request
from clothfit.many import warmup
from clothfit.many.cluster import stop, work
from clothfit.many.job import FACTOR, NOT_STARTED, File, Job, drawn, failed, numbered, read_file, run
from clothfit.many.processes import is_cold
from clothfit.motion.motion import save_motion
from clothfit.objective.identifiability import identifiable
from clothfit.scene.fit_vector import bounds, parameters
from clothfit.scene.scene import dumps, load

pytestmark = pytest.mark.slow

FEW = {"method": "l-bfgs-b", "max_evaluations": 5}


def packed(scene):
    return File(json.dumps(scene).encode(), "a.json")


def test_a_job_and_its_outcome_survive_a_journey_and_give_the_fit_of_its_files(tmp_path):
    path = write_scene(tmp_path, trial("LL"))
    guess = write_scene(tmp_path, trial("nn", vertMass=[0.03] * 16), "guess.json")
    save_motion(record_target(load(path)), str(tmp_path / "t.npz"))
    goals = ((read_file(tmp_path / "t.npz"), None), (read_file(tmp_path / "t.npz"), read_file(path)))
    job = pickle.loads(pickle.dumps(Job(read_file(path), goals, read_file(guess), options=Request(**FEW))))
    outcome = pickle.loads(pickle.dumps(run(job)))
    motion = record_target(load(path))
    same = estimate(load(path), [motion, motion], load(guess), **FEW)
    assert (outcome.exit_code, outcome.error, outcome.status) == (5, None, "limit")
    assert (outcome.fit.cost, outcome.fit.evaluations) == (same.cost, same.evaluations)
    assert dumps(outcome.fit.scene) == dumps(same.scene)
    assert outcome.fit.scene.name == "scene.json"


@pytest.mark.parametrize(
    ("scene", "code", "status", "message"),
    [(trial("nn"), 3, "failed", "a.json: nothing to fit"), ({"objects": 1}, 3, "failed", "a.json: "),
     (even("nG", 60, integrationMethod=0, delta=0.004, springStiffness=[1e3] * 33), 4, "diverged", "a.json: the")],
)  # fmt: skip
def test_what_goes_wrong_is_an_outcome(scene, code, status, message):
    outcome = run(Job(packed(scene)))
    assert (outcome.fit, outcome.exit_code, outcome.status) == (None, code, status)
    assert outcome.error.startswith(message)


def test_a_target_that_does_not_fit_a_file_that_is_not_there_and_another_version_are_named():
    other = packed(trial("Ln", nx=3))
    motion = record_target(load(trial("Ln", nx=3)))
    assert run(Job(packed(trial("Ln")), ((motion, None),))).error.startswith("scene: its objects")
    assert run(Job(packed(trial("Ln")), ((File(b"x", "t.npz"), other),))).error.startswith("t.npz: cannot be read")
    with pytest.raises(InvalidInput, match=r"^none\.json: there is no such file"):
        read_file("none.json")
    outcome = run(replace(Job(packed(trial("Ln"))), version="0.0.1"))
    assert (outcome.exit_code, "the job comes from 0.0.1" in outcome.error) == (3, True)


def test_all_errors_have_a_sentence():
    assert failed(MemoryError()).error == "out of memory; try fewer frames (optimizationIterations)"
    assert failed(KeyboardInterrupt()).error == "interrupted before there was a result"
    assert failed(ZeroDivisionError("x")).error == "a fault of the program: ZeroDivisionError: x"
    assert (failed(KeyboardInterrupt()).exit_code, failed(KeyboardInterrupt()).status) == (130, "interrupted")
    assert (failed(InvalidInput("no")).exit_code, failed(InvalidInput("no")).error) == (3, "no")


def test_on_a_cluster_a_batch_that_was_ended_begins_nothing_more_and_others_go_on():
    job = Job(packed(trial("Ln")), options=Request(**FEW))
    stop("this")
    assert work(job, "this") == NOT_STARTED
    assert work(job, "that").fit is not None
    interrupts.check()  # no request is left behind


def test_whether_fits_are_compiled_is_known_from_the_cache(tmp_path, monkeypatch):
    warmup.warm()
    assert not is_cold()
    monkeypatch.setattr("clothfit.kernels.cache.folders", lambda: (tmp_path / "none",))
    assert is_cold()


def values(scene, number, seed=0, start=None):
    """The drawn start (P,) of a scene with a target."""
    return parameters(numbered(scene, record_target(scene), start, number, seed), flags=scene)


def test_the_first_start_is_what_was_given_and_others_depend_on_seed_and_number_only():
    scene = load(trial("LL"))
    for start in (None, 0.3, scene):
        assert numbered(scene, record_target(scene), start, 0, 7) is start
    again, other, seeded = values(scene, 3), values(scene, 2), values(scene, 3, seed=1)
    np.testing.assert_array_equal(values(scene, 3), again)
    assert (values(scene, 3) != other)[identifiable(scene)].all()
    assert (values(scene, 3) != seeded)[identifiable(scene)].all()


def test_one_factor_for_each_kind_of_each_cloth_within_a_decade_either_way():
    scene = load(document(cloth(optimizationSettings="LL"), cloth(optimizationSettings="nL")))
    ratios = values(scene, 1) / parameters(scene)
    masses, stiffnesses, others = ratios[1:3], ratios[13:35], ratios[-20:]
    for part in (masses, stiffnesses, others):
        np.testing.assert_allclose(part, part[0], rtol=1e-14)  # one product each
        assert 1 / FACTOR < part[0] < FACTOR
    assert len({masses[0], stiffnesses[0], others[0]}) == 3


def test_factors_fill_the_decades_evenly_in_the_logarithm():
    scene = load(even("nG"))
    draw = np.random.default_rng(0)
    logs = np.log10([drawn(scene, np.array([1.0]), draw)[0] for _ in range(2000)])
    # a uniform distribution over (−1, 1): mean 0 ± 3 standard errors of 0.013, variance 1/3
    assert abs(logs.mean()) < 0.04
    assert logs.var() == pytest.approx(1 / 3, rel=0.06)


def test_what_no_motion_shows_keeps_its_value_and_the_rest_stays_within_the_bounds():
    heavy = [9e3] * 16
    scene = load(trial("Ln", vertMass=heavy))
    lower, upper = bounds(scene)
    for number in range(1, 6):
        p = values(scene, number)
        assert p[[0, 3]].tolist() == [9e3, 9e3]
        assert ((lower <= p) & (p <= upper)).all()


def test_vectors_are_shifted_by_their_size_at_most():
    scene = load({**even("nn"), "fit": {"windVel": True}})
    p = values(scene, 1)
    assert (p != 0).all()
    assert (np.abs(p) <= 5.0).all()  # m/s: the typical size of a wind


def test_of_a_hidden_truth_only_its_motion_matters():
    # masses and stiffnesses all times 4 move alike where there is no air: the same starts, the truth being unknown
    light, heavy = (
        load(even("nG", dragCoefficient=0.0, vertMass=[0.02 * k] * 16, springStiffness=[30.0 * k] * 33)) for k in (1, 4)
    )
    starts = [parameters(numbered(scene, None, None, 2, 0), flags=scene)[0] for scene in (light, heavy)]
    assert 4 * starts[0] / starts[1] == pytest.approx(1, rel=0.4)  # the coarse search's step is an eighth of a decade
    assert starts[0] != parameters(light)[0]
