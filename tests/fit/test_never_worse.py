"""Whatever ends a fit, and whenever, its result is the best point that it visited, and costs no more than its start."""

from unittest.mock import Mock

import numpy as np
import pytest
from helpers.fits import Watching, estimate
from helpers.scenes import trial
from helpers.strangers import small

from clothfit import Diverged, Scene, degrade, load, parameters, simulate, with_parameters
from clothfit.fit import result
from clothfit.fit.hierarchy import as_model
from clothfit.objective.objective import Objective
from clothfit.optimise.search import BestSoFar

pytestmark = pytest.mark.slow

FRAMES = 24
ROUNDING = 1e-9
"""Relative: the cost of a trial and that of the model at the same point are sums in another order."""

FITS = {
    "auto, noise": ("nL", 1e-3, 1, {}),
    "auto, exact": ("LL", 0.0, 1, {}),
    "scan": ("GG", 1e-3, 1, {}),
    "windows": ("nL", 1e-3, 1, {"method": "gauss-newton", "prior": "none"}),
    "held by the prior": ("nL", 1e-3, 1, {"method": "gauss-newton", "prior": 0.05}),
    "two targets": ("nL", 1e-3, 2, {}),
    "momentum": ("nL", 1e-3, 1, {"method": "momentum"}),
    "l-bfgs-b": ("nL", 1e-3, 1, {"method": "l-bfgs-b", "max_evaluations": 40}),
    "nelder-mead": ("nG", 1e-3, 1, {"method": "nelder-mead", "max_evaluations": 40}),
}


class Log:
    """The costs over all frames that the fits asked for, until one simulation is the last."""

    def __init__(self, monkeypatch, last=None):
        self.points, self.simulations, self.last = [], 0, last
        self.believed = None  # how many points were known when a prior was first believed
        for name in ("cost_or_infinity", "cost_and_gradient"):
            monkeypatch.setattr(Objective, name, self.noting(getattr(Objective, name)))
        simulate_run, believe = Objective.simulate, BestSoFar.believe

        def simulate_until(objective, *given, **options):
            self.simulations += 1
            if self.last is not None and self.simulations > self.last:
                raise KeyboardInterrupt
            return simulate_run(objective, *given, **options)

        def note_belief(best, *given):
            self.believed = len(self.points) if self.believed is None else self.believed
            believe(best, *given)

        monkeypatch.setattr(Objective, "simulate", simulate_until)
        monkeypatch.setattr(BestSoFar, "believe", note_belief)

    def noting(self, original):
        """A function that notes what it answers."""

        def noted(objective, p, *more):
            found = original(objective, p, *more)
            if objective.steps == FRAMES - 1 and objective.tolerance <= 1e-10:  # of the whole, as the fit solves it
                self.points.append((np.array(p), found if np.isscalar(found) else found[0]))
            return found

        return noted


def given(kind):
    """The arguments of a fit."""
    settings, noise, targets, options = FITS[kind]
    made = load(trial(settings, FRAMES, 3, 3))
    truth = parameters(made)
    exact = simulate(made, tolerance=1e-12)
    motions = [degrade(exact, noise=noise, seed=seed) if noise else exact for seed in range(targets)]
    spread = np.exp(0.3 * np.random.default_rng(3).standard_normal(len(truth)))
    return (with_parameters(made, truth * spread), motions), {"intervals": False, **options}


def ended_at(last, start):
    """A fit that is interrupted at its simulation `last`, and the points that it visited."""
    arguments, options = start
    with pytest.MonkeyPatch.context() as patch:
        log = Log(patch, last)
        try:
            found = estimate(*arguments, **options)
        except (KeyboardInterrupt, Diverged):
            found = None
    return found, log


@pytest.mark.parametrize("kind", FITS)
def test_a_fit_that_ends_at_any_simulation_leaves_the_best_point(kind):
    start = given(kind)
    scene, motions = start[0]
    whole, log = ended_at(None, start)
    most = log.simulations
    goal = Objective(scene, motions, 1e-10)
    first = goal.cost(parameters(scene))
    assert whole.cost <= first
    for last in (1, 2, 3, *range(4, most, max(1, most // 4))):
        found, log = ended_at(last, start)
        costs = [cost for _, cost in log.points]
        assert (found is None) == (not costs)  # only before the first cost there is nothing to give
        before = costs if log.believed is None else costs[: log.believed]
        worst = min([*before, first]) if found else np.inf
        cost = found.cost if found else -np.inf
        assert cost <= worst * (1 + ROUNDING), (last, costs)
        p = parameters(found.scene) if found else log.points
        assert not found or goal.cost(p) == pytest.approx(cost, rel=1e-6)  # the values are those of that cost


def test_a_cost_alone_is_best_where_it_is_lowest():
    costs = np.random.default_rng(0).random(50)
    best = BestSoFar(np.zeros(1))
    taken = [best.offer(np.array([cost]), cost) for cost in costs]
    assert (best.cost, best.p[0]) == (costs.min(), costs.min())
    lowest = np.minimum.accumulate(costs)
    assert taken == [True, *(lowest[1:] < lowest[:-1]).tolist()]


def test_the_found_scene_is_given_before_anything_else_is_looked_at(monkeypatch):
    (scene, motions), options = given("l-bfgs-b")
    said = []
    monkeypatch.setattr(result, "confidence", Mock(side_effect=KeyboardInterrupt))
    watching = Watching(result=said.append)
    fit = estimate(scene, motions, **{**options, "intervals": True, "holdout": 0.2}, observer=watching)
    assert [parameters(one).tolist() for one in said] == [parameters(fit.scene).tolist()]
    assert (fit.status, fit.holdout) == ("limit", None)
    assert fit.warnings == ["no intervals, as their computation was interrupted", "no holdout, as the fit was ended"]


def test_the_time_ends_a_fit_with_its_best_point_or_with_the_start():
    (scene, motions), options = given("nelder-mead")
    fit = estimate(scene, motions, **{**options, "max_evaluations": 10**6, "rmse": 0.0, "time_limit": 0.2})
    assert fit.status in ("limit", "converged", "stalled")  # it may end by itself
    assert fit.cost <= Objective(scene, motions, 1e-10).cost(parameters(scene))
    fit = estimate(scene, motions, **options, time_limit=1e-9)  # not enough for one evaluation
    assert (fit.status, fit.cost) == ("limit", Objective(scene, motions, 1e-10).cost(parameters(scene)))
    assert parameters(fit.scene).tolist() == parameters(scene).tolist()
    assert "the time was used up before the first step, so the values are those of the start" in fit.warnings
    found = estimate(scene, motions, **{**options, "rmse": 1.0}, time_limit=1e-9)  # begins where it may end
    assert (found.status, found.evaluations) == ("limit", 1)


def test_one_value_for_all_never_replaces_a_pattern_that_is_nearer():
    pattern = np.random.default_rng(0).uniform(5.0, 50.0, 33).tolist()
    scene = small("nG", FRAMES, springStiffness=pattern)
    target = degrade(simulate(scene), noise=1e-4)
    written: list[Scene] = []
    found = estimate(scene, target, observer=Watching(result=written.append))
    assert found.cost <= Objective(scene, target, 1e-10).flagging(as_model(scene, "F", exactly=True)).cost(np.ones(1))
    assert np.array_equal(written[0].cloths[0].stiffness, scene.cloths[0].stiffness)  # before anything is looked at
    assert np.array_equal(found.scene.cloths[0].stiffness, scene.cloths[0].stiffness)
    assert "pattern" in [hint.code for hint in found.hints]
