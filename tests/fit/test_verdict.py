"""The verdict on a fit's model, and that no interval leaves the program without it."""

import json
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.interrupting import interrupt_after
from helpers.scenes import even, trial

from clothfit import Diverged, degrade, load
from clothfit.base import interrupts
from clothfit.cli.common.output import Output
from clothfit.cli.parts.estimate_results import certainty, summary
from clothfit.fit.confidence import Confidence
from clothfit.fit.estimate import record_target
from clothfit.fit.result import HARDLY, FittedBlock, fitted_block
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.report.log import intervals
from clothfit.scene.fit_vector import parameters
from clothfit.scene.kinds import KIND

pytestmark = pytest.mark.slow


@cache
def noisy(noise=1e-3):
    scene = load(even("nG", 20))
    return scene, degrade(record_target(scene), noise, seed=3)


@cache
def other_model(settings="nG"):
    """One stiffness for a motion of a cloth with different ones."""
    return load(even(settings, 30)), degrade(record_target(load(trial(settings, 30))), 1e-4, seed=1)


def without_gravity():
    scene, motion = other_model()
    return replace(scene, gravity=0.0 * scene.gravity), motion


FITS = {
    "exact": (partial(noisy, 0.0), {"start": 20.0}),
    "noisy": (noisy, {}),
    "noisy, vertices kept out": (noisy, {"holdout": 0.25, "holdout_of": "vertices"}),
    "another model": (other_model, {}),
    "another model, frames kept out": (other_model, {"holdout": 0.3}),
    "another model, good enough": (other_model, {"rmse": 0.1}),
    "another model, one evaluation": (other_model, {"max_evaluations": 1}),
    "another model, no time": (other_model, {"time_limit": 1e-3}),
    "another model, huber": (other_model, {"loss": "huber"}),
    "its clock": (other_model, {"fit_time": True}),
    "velocities": (other_model, {"objective": {"velocity": 1.0}}),
    "spectra": (noisy, {"objective": {"spectrum": 1.0}}),
    "without weight": (without_gravity, {}),
    "l-bfgs-b": (other_model, {"method": "l-bfgs-b"}),
}


def shows_no_interval_alone(scene, found):
    """Fails where an interval is in the result, its text, its JSON or what the page reads of it, without a verdict."""
    told = summary(scene, found, Output("x.json"))
    said = any(any(block.interval) for block in found.parameters)
    assert said == any("95 %" in certainty(block, KIND[block.name]) for block in found.parameters)
    for block in found.parameters:
        read = intervals(json.loads(json.dumps(told)), block.object, block.name, block.mode, block.count)
        assert any(read or []) == any(block.interval)
    assert not said or (found.verdict is not None and told["verdict"]["model"] in ("adequate", "differs"))
    return said


@pytest.mark.parametrize("name", FITS)
def test_no_interval_without_the_verdict(name):
    made, options = FITS[name]
    scene, motion = made()
    found = estimate(scene, motion, **options)
    said = shows_no_interval_alone(scene, found)
    assert said or any("no intervals" in w for w in found.warnings)
    assert said or name not in ("exact", "noisy")
    assert name != "spectra" or (found.verdict, found.parameters[0].interval) == (None, [None])


@pytest.mark.parametrize("simulations", [1, 8, 16, 24, 40])
def test_no_interval_without_the_verdict_of_a_fit_that_is_interrupted(monkeypatch, simulations):
    scene, motion = other_model()
    with interrupts.deferred():
        interrupt_after(monkeypatch, simulations)
        found = estimate(scene, motion)
    monkeypatch.undo()
    shows_no_interval_alone(scene, found)


def test_no_interval_where_the_verdict_fails(monkeypatch):
    def fails(*_):
        raise Diverged("far away", 1)

    scene, motion = other_model()
    monkeypatch.setattr("clothfit.fit.result.residual_test", fails)
    found = estimate(scene, motion)
    assert found.verdict is None
    assert not shows_no_interval_alone(scene, found)


def test_a_trial_that_its_model_cannot_reproduce_says_so():
    scene = load(trial("nG", 30))
    found = estimate(scene)
    assert found.verdict.differs
    assert estimate(load(even("nG", 30))).verdict.model == "adequate"
    assert np.isfinite(found.relative_rmse)


def vector(x, y, z):
    return {"x": x, "y": y, "z": z}


@pytest.mark.parametrize(
    ("hidden", "noise", "model"),
    [
        ({}, 1e-3, "adequate"),
        ({}, 2e-2, "adequate"),
        ({"windVel": vector(0.0, 0.0, 0.3)}, 1e-3, "differs"),
        ({"gravity": vector(0.0, -9.75, 0.0)}, 2e-2, "differs"),
    ],
)
def test_what_the_model_lacks_is_seen_below_the_noise_and_the_true_model_is_not_blamed(hidden, noise, model):
    scene = load(even("nG", 60))
    motion = record_target(load(even("nG", 60, **hidden)))
    for seed in range(2):  # frames beside each other show the wind, but not the gravity: only their sums do
        assert estimate(scene, degrade(motion, noise, seed=seed)).verdict.model == model


def test_groups_that_a_target_hardly_shows_are_named():
    block = FittedBlock(0, "stiffness", "R", 2, [], [], [], [None, None], groups=["edges", "bending"], hardly_shown=[1])
    assert ", bending hardly shown, " in certainty(block, KIND["stiffness"])
    assert "hardly" not in certainty(replace(block, interval=[(0.8, 1.2), None], hardly_shown=[]), KIND["stiffness"])


@pytest.mark.parametrize(("within", "hardly"), [(0.99 * HARDLY, []), (1.01 * HARDLY, [0]), (np.nan, [])])
def test_a_value_whose_interval_goes_beyond_a_factor_of_2_is_hardly_shown(within, hardly):
    scene, motion = noisy()
    search, p = Search(Objective(scene, motion), parameters(scene), 1e-8, 100), parameters(scene)
    known = Confidence(p, 0.0, p / within, p * within, np.isnan(p), len(p), 1e-3)
    assert fitted_block(search, scene, scene.blocks[0], p, known).hardly_shown == hardly
