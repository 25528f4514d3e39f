"""The model of a whole motion's cost: its slope, its Jacobian, its residuals, its prior, its normal equations."""

import numpy as np
import pytest
from helpers.costs import jacobian, residual, simulate_all
from helpers.physics import METHODS, TIGHT, scene, xyz
from helpers.scenes import cloth, even, trial

from clothfit.derivative import sensitivity
from clothfit.derivative.sensitivity import columns, sweep
from clothfit.kernels import parallel
from clothfit.motion.degrade import degrade
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.objective.run import residual_count
from clothfit.objective.running_cost import MatrixResiduals, free_columns
from clothfit.optimise import trajectory as normal
from clothfit.optimise.prior import FIRST_TAU, first
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.fit_vector import acting, parameters, with_parameters
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow

FITS = {"damping": "G", "vertVel": "G", "springRestLength": "L"}
SETTINGS = {
    "LL": [cloth(3, 3, optimizationSettings="LL")],
    "several": [
        cloth(3, 3, optimizationSettings="GL", fit=FITS),
        cloth(2, 3, optimizationSettings="nn"),
        cloth(2, 2, optimizationSettings="nG"),
    ],
    "one": [cloth(3, 3, optimizationSettings="nG")],
}


def trajectory(kind, objective="position", method="implicit", loss="linear", **fields):
    """A search of a scene against the degraded motion of other parameters, and its coordinates."""
    delta = 0.02 if method == "implicit" else 0.002
    whole = {"windVel": True} if kind == "several" else {}
    made = scene(
        *SETTINGS[kind],
        optimizationIterations=9,
        windVel=xyz((3, 1, -2)),
        integrationMethod=METHODS[method],
        delta=delta,
        fit=whole,
        **fields,
    )
    p = parameters(made)
    motion = simulate(with_parameters(made, 1.2 * p), tolerance=TIGHT)
    if objective != "spectrum":
        motion = degrade(motion, observed=0.8, seed=2)
    scale = None if loss == "linear" else 1e-3
    aim = Objective(made, motion, TIGHT, objective=objective, loss=loss, loss_scale=scale)
    return Trajectory(Search(aim, p, 0.0, 10**6), aim)


def at(part):
    return part.y(part.search.best.p)


VARIANTS = [
    *(("LL", objective, "implicit", "linear") for objective in ("position", "velocity", "edge-length", "spectrum")),
    *(("LL", "position", method, "linear") for method in ("explicit", "symplectic")),
    ("several", "position", "implicit", "linear"),
    ("several", {"position": 1.0, "edge-length": 3.0}, "implicit", "linear"),
    ("LL", "position", "implicit", "huber"),
    ("one", "position", "implicit", "linear"),
]


@pytest.mark.parametrize(("kind", "objective", "method", "loss"), VARIANTS, ids=str)
def test_g_is_half_the_slope_of_the_cost(kind, objective, method, loss):
    part = trajectory(kind, objective, method, loss)
    y, t = at(part), 1e-5
    model = part.model(y)
    assert model.cost == pytest.approx(part.cost(y), rel=1e-12)  # the same motion
    direction = np.random.default_rng(1).normal(size=part.size)
    measured = (part.cost(y + t * direction) - part.cost(y - t * direction)) / (2 * t)
    # Central difference: error t² and rounding 1e-16 / t, relative, a few digits lost in distances
    assert 2 * model.g @ direction == pytest.approx(measured, rel=1e-6)


@pytest.mark.parametrize(("kind", "objective", "method"), [(*v[:3],) for v in VARIANTS if v[3] == "linear"], ids=str)
def test_h_is_that_of_the_residuals_slopes(kind, objective, method):
    part = trajectory(kind, objective, method)
    y, t = at(part), 1e-5

    def residuals(y):
        p = part.search.parameters(y)
        runs = part.objective.runs
        return np.concatenate([residual(run.comparison, simulate_all(part.objective, run, p)[1].x) for run in runs])

    J = np.stack([(residuals(y + t * e) - residuals(y - t * e)) / (2 * t) for e in np.eye(part.size)], axis=1)
    H = part.model(y).H
    # rounding of positions, 1e-15 / 1e-5, against slopes of 1e-2; error t² = 1e-10
    np.testing.assert_allclose(H, J.T @ J, atol=1e-6 * np.abs(H).max())


def test_a_sweep_for_each_of_a_few_and_one_for_many_are_the_same(monkeypatch):
    part = trajectory("LL")
    monkeypatch.setattr(sensitivity, "CALLS", 0.0)
    model = part.model(at(part))
    monkeypatch.setattr(sensitivity, "CALLS", 1e9)
    other = part.model(at(part))
    assert not np.array_equal(other.H, model.H)
    np.testing.assert_allclose(other.H, model.H, atol=1e-12 * np.abs(model.H).max())  # solves to 1e-14
    np.testing.assert_allclose(other.g, model.g, atol=1e-12 * np.abs(model.g).max())


def test_a_model_where_the_simulation_diverges_raises_and_the_cost_is_infinite():
    made = load(even("nG", 60, integrationMethod=0, delta=0.004))
    aim = Objective(made, simulate(made), TIGHT)
    part = Trajectory(Search(aim, np.array([30.0]), 0.0, 100), aim)
    far = part.y(np.array([1e4]))
    assert part.cost(far) == np.inf
    with pytest.raises(Diverged):
        part.model(far)


def test_every_cost_and_every_model_is_an_evaluation():
    part = trajectory("one")
    part.cost(at(part))
    part.model(at(part))
    assert part.search.budget.evaluations == 2


def test_with_a_prior_the_best_point_has_the_least_cost_and_penalty_and_costs_no_more_than_before():
    part = trajectory("one")
    y, best = at(part), part.search.best
    start = part.cost(y)  # the minimum is at y + 4 log 1.2
    prior = first(y + 0.2, [np.arange(part.size)], tau=1.0)
    part.believe(prior, 1e6 * start)  # the penalty outweighs the cost
    for away in (0.4, 0.1, 0.25, 0.3):
        part.cost(y + away)
    np.testing.assert_allclose(part.search.y, y + 0.25, rtol=1e-12)  # rounding of log and exp
    assert best.prior is prior
    part.believe(first(y - 2.0, [np.arange(part.size)], tau=1.0), 1e6 * start)
    assert part.cost(y - 1.9) > start  # nearer to the centre, but worse than before
    np.testing.assert_allclose(part.search.y, y + 0.25, rtol=1e-12)
    best.belief = None
    lowest = part.cost(y + 0.7)
    assert (best.cost, best.prior) == (lowest, None)


def test_the_residuals_are_those_that_a_parameter_can_change():
    made = load(trial("LL", 9, 3, 3))
    motion = degrade(simulate(made), observed=0.7, seed=1)
    (run,) = Objective(made, motion).runs
    shown = run.comparison.goal.observed[1:, ~made.cloths[0].fixed]
    assert residual_count(run) == 3 * shown.sum()
    part = Trajectory(Search(Objective(made, motion), parameters(made), 0.0, 10), Objective(made, motion))
    assert part.residuals() == 3 * shown.sum()


def test_the_prior_groups_what_scatters_around_a_fabric():
    part = trajectory("several")
    sizes = [16, 16]  # stiffnesses and rest lengths of the first cloth; one value each does not scatter
    prior = part.prior(at(part), None)
    assert [len(group) for group in prior.groups] == sizes
    assert {own for own, *_ in prior.widths} == {FIRST_TAU}
    names = np.concatenate([[b.name] * b.count for b in part.objective.blocks])[part.fitted]
    assert [set(names[group]) for group in prior.groups] == [{"stiffness"}, {"rest"}]
    every = part.prior(at(part), 0.2)
    assert sorted(np.concatenate(every.groups).tolist()) == list(range(part.size))
    assert set(every.tau) == {0.2}


@pytest.mark.parametrize("method", ["implicit", "bdf2"])
def test_with_two_threads_a_model_is_the_same_to_the_last_bit(method, monkeypatch):
    found = []
    for count in (1, 2):
        monkeypatch.setattr(parallel, "processors", lambda count=count: count)
        part = trajectory("several", method=method)
        found.append(part.model(part.y(part.search.start)))
    assert found[0].cost == found[1].cost
    np.testing.assert_array_equal(found[0].H, found[1].H)
    np.testing.assert_array_equal(found[0].g, found[1].g)


# --- the normal equations, a few steps at a time, against the whole Jacobian


FRAMES, DELTA = 12, 0.02
OBJECTIVES = ["position", "velocity", "edge-length", "spectrum", {"position": 1.0, "edge-length": 2.0, "velocity": 0.1}]
TIMES = {
    "steps": np.arange(FRAMES) * DELTA,
    "between": (np.arange(FRAMES - 1) + 0.3) * DELTA,
    "every second": np.arange(0, FRAMES, 2) * DELTA,
    "two in a step": np.arange(20) * 0.5 * DELTA,
}


def objective(kind, times):
    """A small cloth in the wind against the motion of other parameters, seen at some times."""
    made = scene(
        cloth(3, 3, optimizationSettings="LG", dragCoefficient=0.3, fit={"springRestLength": "L"}),
        optimizationIterations=FRAMES,
        windVel=xyz((3, 1, -2)),
    )
    p = parameters(made)
    x = simulate(with_parameters(made, 1.3 * p), tolerance=TIGHT).positions
    places = times / DELTA
    below = np.minimum(places.astype(int), FRAMES - 2)
    share = (places - below)[:, None, None]
    seen = np.random.default_rng(5).uniform(size=(len(times), 9)) < (1.0 if kind == "spectrum" else 0.8)
    motion = Motion((1 - share) * x[below] + share * x[below + 1], times, (9,), seen)
    return Objective(made, motion, TIGHT, objective=kind), p


def parts(aim, p):
    """∂r/∂x of the free coordinates, r, the sweep, and its size."""
    (run,) = aim.runs
    system, memory = simulate_all(aim, run, p)
    wanted = columns(system, acting(aim.scene, 0), p, np.arange(len(p), dtype=np.int32), np.ones(len(p)), len(p))
    by_position = jacobian(run.comparison, memory.x)[:, free_columns(system.vertex.free, run.steps)]
    size = (3 * int(system.vertex.free.sum()), len(p))
    return by_position, residual(run.comparison, memory.x), lambda: sweep(system, memory, wanted), size


@pytest.mark.parametrize("times", TIMES)
@pytest.mark.parametrize("kind", OBJECTIVES, ids=str)
def test_it_is_the_product_of_the_whole_jacobian(kind, times, monkeypatch):
    aim, p = objective(kind, TIMES[times])
    by_position, r, steps, size = parts(aim, p)
    J = by_position @ np.concatenate([step.copy() for step in steps()])
    assert np.abs(J).max() > 0
    for chunk in (1, 250, 10**9):  # a step, two steps and all: 19 columns of 21 coordinates
        monkeypatch.setattr(normal, "CHUNK", chunk)
        H, g = normal.accumulate(MatrixResiduals(by_position, r, size[0]), steps(), np.zeros(size))
        # sums of some hundred products in another order
        np.testing.assert_allclose(H, J.T @ J, atol=1e-13 * np.abs(J.T @ J).max())
        np.testing.assert_allclose(g, J.T @ r, atol=1e-13 * np.abs(J).max() * np.abs(r).sum())
