"""The default way to fit: it finds the truth of small cloths, and never returns worse than what it has seen."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.fits import Watching, estimate
from helpers.physics import scene, xyz
from helpers.scenes import cloth, document, even, trial

from clothfit.fit import auto, trajectory_fit
from clothfit.fit.auto import SolvedLoosely, balances_can_hold, by_hierarchy, by_momentum, check_tolerance
from clothfit.fit.estimate import record_target
from clothfit.meshes.mesh import plane
from clothfit.meshes.new_scene import at_side, new_scene
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import as_motion, at_frames
from clothfit.motion.simulate import simulate
from clothfit.objective.identifiability import identifiable
from clothfit.objective.objective import Objective
from clothfit.optimise import trajectory
from clothfit.optimise.momentum import TREATMENTS, Momentum
from clothfit.optimise.search import Search
from clothfit.optimise.status import Stop
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow

NEVER = 0.0  # an RMSE that no fit reaches


def searching(settings="nL", frames=20, noise=0.0, budget=10**4, start=None, rmse=NEVER, make=trial, **degraded):
    """A search of a scene's own motion, degraded, from a start that is off."""
    made = load(make(settings, frames))
    motion = degrade(record_target(made), noise, seed=3, **degraded)
    p = parameters(made)
    begin = p * np.exp(0.4 * np.random.default_rng(5).normal(size=len(p))) if start is None else start
    return Search(Objective(made, motion, 1e-10), begin, rmse, budget), begin


# --- the truth


@pytest.mark.parametrize("settings", ["nL", "LL"])
def test_gauss_newton_finds_the_truth_from_a_start_that_is_off(settings):
    search, start = searching(settings, rmse=1e-8)
    kept, true = search.fitted, parameters(search.objective.scene)
    with pytest.raises(Stop) as stop:
        trajectory_fit.by_gauss_newton(search, start, start, np.inf)
    assert stop.value.status == "converged"
    np.testing.assert_allclose(search.best.p[kept], true[kept], rtol=1e-2)  # 1e-8 m of what the motion hardly shows
    assert np.median(np.abs(search.best.p[kept] / true[kept] - 1)) < 1e-5


def test_one_value_in_the_wind_is_found_among_many_minima():
    own = cloth(4, 3, 0.3, vertMass=[0.01] * 12, springStiffness=[30.0] * 23, dragCoefficient=1.5, damping=0.02)
    own["optimizationSettings"] = "nG"
    made = scene(own, optimizationIterations=80, windVel=xyz((9, 0.5, 4)))
    for start in (1e-3, 5.0, 3e3):
        found = estimate(made, degrade(record_target(made), every=2), start=start)
        assert found.status == "converged"
        assert parameters(found.scene)[0] == pytest.approx(30.0, rel=1e-4)


@pytest.mark.parametrize("prior", ["auto", "none", 0.5])
def test_noise_is_fitted_down_to_its_own_size(prior):
    made, noise = load(trial("nL", 40)), 1e-4
    target = degrade(record_target(made), noise, seed=1)
    found = estimate(made, target, start=10.0, prior=prior)
    assert found.status == "converged"
    # 40 × 14 × 3 numbers, 33 fitted: the mean of so many squares scatters by 3.5 %; fixed vertices are exact in x0
    assert noise * np.sqrt(3) * 0.9 < found.rmse < noise * np.sqrt(3) * 1.1


# --- the steps of the way


def test_the_momentum_fits_come_best_last():
    search, start = searching("nL", 40, 1e-3)
    found = by_momentum(search, start)
    assert len(found) == len(TREATMENTS)
    costs = [search.objective.cost(p) for p in found]
    assert costs == sorted(costs, reverse=True)
    assert search.best.cost == pytest.approx(costs[-1], rel=1e-9)


def test_a_target_that_only_another_tolerance_reproduces_is_fitted_with_that():
    """As a cloth that buckles to one side or the other by the error of a solver: here that error is made large."""
    given = load(trial("nL", 30))
    aim, p = Objective(given, simulate(given, 30, 1e-3), 1e-10), parameters(given)
    search = Search(aim, p, NEVER, 100)
    search.loose_tolerance = 1e-3
    with pytest.raises(SolvedLoosely) as found:
        check_tolerance(search, p)
    assert found.value.tolerance == 1e-3
    np.testing.assert_array_equal(found.value.p, p)
    search.loose_tolerance = None  # as where the user chose one
    check_tolerance(search, p)
    search.loose_tolerance = 1e-3
    check_tolerance(search, 3.0 * p)  # no tolerance makes the motion of these values the target's


def test_windows_grow_to_the_whole():
    assert trajectory_fit.window_lengths(10, 100) == [10, 20, 40, 100]
    assert trajectory_fit.window_lengths(10, 8) == [8]
    assert trajectory_fit.window_lengths(60, 100) == [60, 100]
    for last in range(2, 200, 7):
        lengths = trajectory_fit.window_lengths(10, last)
        assert lengths[-1] == last
        assert (np.diff(lengths) > 0).all()


def test_the_first_window_begins_where_something_is_seen():
    made = load(even("nL", 80))
    motion = simulate(made)
    late = at_frames(motion, slice(50, None))
    assert trajectory_fit.first_window(Objective(made, motion)) == 1 + trajectory_fit.FIRST_WINDOW
    assert trajectory_fit.first_window(Objective(made, late)) == 50 + trajectory_fit.FIRST_WINDOW


def test_a_window_ends_where_its_steps_save_what_noise_gives_away():
    search, _ = searching("nL", 80, 1e-3)
    parts = trajectory_fit.stages(search, near=False, windows=True)[:-1]
    first = trajectory_fit.first_window(search.objective)
    assert [part.objective.frames for part in parts] == trajectory_fit.window_lengths(first, 80)[:-1]
    free = int((~search.objective.scene.cloths[0].fixed).sum())
    for part in parts:  # all vertices are seen; the initial state cannot change
        share = search.fitted.sum() / (3 * free * (part.objective.frames - 1))
        assert part.least == pytest.approx(np.clip(share, trajectory_fit.WINDOW_SAVING, trajectory_fit.NOISE_SAVING))


@pytest.mark.parametrize(
    ("made", "change", "start"),
    [
        *[(trial(settings), {name: value}, None) for settings, name, value in (
            ("Ln", "every", 2), ("nL", "observed", 0.6), ("LL", "observed", 0.6), ("LL", "every", 2))],
        (even("nL", 60), slice(40, None), np.exp(0.05) * 30.0),
        (even("GG", 60), slice(40, None), np.exp(0.05) * np.array([0.02, 30.0])),
        (even("nL", 60, integrationMethod=0, delta=0.004), slice(None, None, 2), 2e3),  # which diverges
    ],
)  # fmt: skip
def test_a_target_with_gaps_or_that_begins_late_is_fitted_and_a_start_that_diverges_is_left(made, change, start):
    made = load(made)
    exact = record_target(made)
    found = estimate(made, at_frames(exact, change) if isinstance(change, slice) else degrade(exact, **change), start)
    assert found.status == "converged"
    assert found.rmse < 1e-6  # it ends at 1e-8, or where a step saves nothing against the scatter of what is left


# --- long fits, here of small cloths that are taken for long ones


def wide(monkeypatch):
    """Take every fit for a long one with more values than a dense model has room for."""
    monkeypatch.setattr(trajectory_fit, "LONG_POSITIONS", 0)
    monkeypatch.setattr(trajectory_fit, "LARGEST", 0.0)


def squeezed(made):
    """The motion of a scene, and one that it cannot make."""
    true = record_target(made)
    return true, as_motion(made, true.positions * np.array([1.0, 0.7, 1.0]), true.times)


def test_a_long_fit_of_many_values_finds_the_factor_first(monkeypatch):
    wide(monkeypatch)
    made = load(even("nL", 20))
    target = degrade(record_target(made), every=2)  # no balance of momentum
    found = estimate(made, target, start=10.0, intervals=False)
    assert found.rmse < 1e-5  # the truth is even: the factor 3 alone comes to it, as far as loose systems tell


def test_a_target_that_cannot_be_reproduced_ends_a_long_fit_after_some_steps(monkeypatch):
    wide(monkeypatch)
    made = load(even("nL", 20))
    _, other = squeezed(made)
    found = estimate(made, other, start=10.0, intervals=False)
    objective = Objective(made, other, 1e-10)
    first = objective.cost(np.full(33, 10.0))
    assert found.status in ("converged", "stalled")
    assert found.evaluations < 200
    assert trajectory_fit.FAR_ERROR**2 * objective.cost_at_rest < found.cost < first


def test_balances_that_cannot_be_fulfilled_at_first_are_not_solved_for_all_frames(monkeypatch):
    wide(monkeypatch)
    made = load(even("nL", 20))
    for target, worth in zip(squeezed(made), (True, False), strict=True):
        search = Search(Objective(made, target, 1e-10), np.full(33, 10.0), 1e-8, 100)
        early = search.objective.until(trajectory_fit.first_window(search.objective))
        balances = Momentum(search.objective, np.full(33, 10.0), search.fitted)
        assert balances_can_hold(search, balances, early) == worth


# --- rounded targets


def rounded(motion, kind):
    """A motion as a file with fewer digits holds it."""
    x = motion.positions
    return replace(motion, positions=x.astype(np.float32).astype(float) if kind == "float32" else np.round(x, kind))


@pytest.mark.parametrize(("settings", "kind"), [("nL", "float32"), ("nL", 4), ("Ln", "float32"), ("Ln", 5)])
def test_a_rounded_target_is_fitted_to_its_rounding_and_no_further(settings, kind):
    made = load(trial(settings, 30))
    target = rounded(record_target(made), kind)
    found = estimate(made, target, start=10.0 if settings == "nL" else 0.1)
    assert found.status == "converged"
    assert found.rmse <= Objective(made, target).rounding
    assert found.evaluations <= 30  # without the floor it needs more than 60, and far more for larger cloths


def test_an_error_that_is_asked_for_is_not_replaced_by_the_rounding():
    made = load(trial("nL", 30))
    target = rounded(record_target(made), 4)
    floor, fine, rough = (estimate(made, target, start=10.0, rmse=asked) for asked in (None, 1e-9, 1e-3))
    # below the rounding the prior moves what is left up or down
    assert max(fine.rmse, floor.rmse) <= Objective(made, target).rounding < rough.rmse <= 1e-3
    assert rough.evaluations <= floor.evaluations < fine.evaluations


def test_an_exact_momentum_fit_ends_a_long_fit_of_many_values(monkeypatch):
    monkeypatch.setattr(trajectory_fit, "LONG_POSITIONS", 100)
    monkeypatch.setattr("clothfit.fit.auto.LARGEST", 0.0)  # no dense model is small enough
    made = load(trial("nL", windVel=xyz((3.0, 1.0, 2.0))))
    target = record_target(made)
    fit = estimate(made, target, start=7.0, rmse=1e-300)
    assert fit.status == "converged"
    assert fit.evaluations <= 4  # the start, two balances, none of the whole motion's derivatives
    known = identifiable(made)
    # solved to 1e-10, which the balances magnify
    np.testing.assert_allclose(parameters(fit.scene)[known], parameters(made)[known], rtol=1e-5)
    noisy = estimate(made, degrade(target, noise=1e-3), start=7.0, max_evaluations=12)
    assert noisy.evaluations > 4


@pytest.mark.parametrize("method", [2, 3])
def test_a_fit_ends_where_each_single_step_of_its_target_is_taken(method, monkeypatch):
    """As one of a chaotic cloth, whose motion never comes to the target: here no motion is near enough."""
    for name in ("EXACT", "ACCURATE"):
        monkeypatch.setattr(auto, name, 0.0)
    monkeypatch.setattr(trajectory_fit, "LONG_POSITIONS", 100)
    made = load(trial("nL", windVel=xyz((3.0, 1.0, 2.0)), integrationMethod=method))
    found = estimate(made, record_target(made), start=7.0, rmse=1e-300)
    assert (found.status, found.stage, found.verdict.model) == ("converged", "momentum", "adequate")
    assert found.evaluations <= 4
    assert found.single_steps.largest <= 1e-10  # linear systems solved to 1e-10 of steps of decimetres


def test_a_fit_of_many_values_to_a_rounded_motion_of_its_model_ends_along_the_target(monkeypatch):
    monkeypatch.setattr(auto, "MANY", 0)
    made = load(trial("nL", windVel=xyz((3.0, 1.0, 2.0)), integrationMethod=3))
    target = record_target(made)
    found = estimate(made, replace(target, positions=np.round(target.positions, 7)), start=7.0, intervals=False)
    assert (found.status, found.stage) == ("converged", "momentum")
    assert found.rmse < 8.7e-8  # half a unit in each coordinate


def test_steps_are_not_taken_by_other_values():
    search, _ = searching("nL", 20, start=1.01 * parameters(load(trial("nL", 20))))
    search.visit(search.start)
    assert not auto.takes_each_step(search)
    search.visit((1.0 + 1e-9) * parameters(search.objective.scene))
    assert auto.takes_each_step(search)
    assert search.subsearch(search.objective, search.best.p, search.best.cost).proven is not None
    search.visit(search.start)
    assert search.proven is not None  # of the best point


def test_a_fit_that_visibly_misses_a_motion_of_its_own_model_has_not_converged():
    search, _ = searching("nL", 20, start=1.5 * parameters(load(trial("nL", 20))))
    search.visit(search.start)
    assert search.objective.rmse(search.best.cost) > 1e-3
    assert search.finish("converged") == "converged"  # the target may be another model's
    search.own = True
    assert search.finish("converged") == "stalled"
    search.rmse_tolerance = 1.0  # m: good enough for the user
    assert search.finish("converged") == "converged"
    search.rmse_tolerance = NEVER
    search.visit((1.0 + 1e-9) * parameters(search.objective.scene))
    assert search.finish("converged") == "converged"


def test_too_many_values_for_a_matrix_go_on_from_smooth_maps_by_products(monkeypatch):
    noise, made = 1e-3, load(trial("nL", 40))
    for module in (trajectory, trajectory_fit, auto):
        monkeypatch.setattr(module, "LARGEST", 0.0)
    stages = []
    found = estimate(made, degrade(record_target(made), noise, seed=1), start=10.0,
                     observer=Watching(progress=lambda progress: stages.append(progress.stage)))  # fmt: skip
    assert found.status == "converged"
    assert "matrix-free" in stages
    assert "gauss-newton" not in stages[stages.index("matrix-free") :]
    assert [rung.model for rung in found.ladder][-1] == "L"
    assert found.ladder[-1].rmse == pytest.approx(found.rmse, rel=1e-9)  # nothing comes after it
    # 40 × 14 × 3 numbers, 33 fitted: the mean of so many squares scatters by 3.5 %
    assert noise * np.sqrt(3) * 0.9 < found.rmse < noise * np.sqrt(3) * 1.1
    assert found.samples is not None
    ends = np.array([pair or (-np.inf, np.inf) for pair in found.parameters[0].interval])
    true = parameters(made)
    assert np.mean((ends[:, 0] <= true) & (true <= ends[:, 1])) > 0.8  # 95 % of 33, that depend on each other


# --- few markers, from starts that are decades off


NOISE = 1e-3  # m, of a coordinate
SIDE = 5  # vertices along each side


@pytest.fixture(scope="module")
def hanging():
    """A fabric that hangs from one side, of one stiffness along, across and between, and what five markers show."""
    made = cloth(SIDE, SIDE, 0.2, optimizationSettings="nL", damping=0.02, vertMass=[0.01] * SIDE**2,
                 vertIsFixed=[i % SIDE == 0 for i in range(SIDE**2)])  # fmt: skip
    ends = np.array(made["springs"]).reshape(-1, 2)
    along = {1: 50.0, SIDE: 25.0}
    made["springStiffness"] = [along.get(int(gap), 2.5) for gap in abs(ends[:, 1] - ends[:, 0])]
    scene = load(document(made, optimizationIterations=60))
    truth = simulate(scene, tolerance=1e-10)
    return scene, truth, degrade(truth, NOISE, observed=0.2, seed=3, fps=30.0)


def distance(scene, truth):
    """Root mean square distance of a scene's motion from the true one, m, over all vertices."""
    away = simulate(scene, tolerance=1e-10).positions - truth.positions
    return np.sqrt((away * away).sum(axis=-1).mean())


@pytest.mark.parametrize("start", [1e-3, 0.02, 1e4])
def test_a_start_that_is_decades_off_leads_to_the_truth(hanging, start):
    scene, truth, target = hanging
    found = estimate(scene, target, start=start)
    ends = [(-np.inf, np.inf) if pair is None else pair for block in found.parameters for pair in block.interval]
    lower, upper = np.array(ends).T
    within = (lower <= parameters(scene)) & (parameters(scene) <= upper)
    assert distance(found.scene, truth) < NOISE  # 240 readings of few combinations: better than one of them
    assert np.mean(within) > 0.8  # of 95 %; values are of few families, so not apart


def test_a_ladder_comes_to_the_truth_and_not_to_the_noise(hanging):
    scene, truth, target = hanging
    start = np.full(len(parameters(scene)), 0.02)
    search = Search(Objective(scene, target, 1e-10), start, 0.0, 10**4)
    by_hierarchy(search, None, [start])
    assert distance(with_parameters(scene, search.best.p), truth) < NOISE


# --- where windows lead astray: a compressed cloth, whose motion grows small differences


def compressed(integrator, seed, divisions=4):
    """A plane between two held sides whose rest lengths are about a tenth longer than it is: the scene, values of
    single springs, and their motion with 1 mm of noise.
    """
    grid = plane(divisions, 1.0)
    fixed = at_side(grid.positions, "left") | at_side(grid.positions, "right")
    made = new_scene(grid, fixed, fit="nn", fits={"rest": "L"}, integrator=integrator, frames=60)
    p = 1.1 * parameters(made)
    truth = p * np.exp(0.03 * np.random.default_rng(seed).normal(size=len(p)))
    scene = with_parameters(made, p)
    return scene, truth, degrade(simulate(with_parameters(scene, truth), tolerance=1e-10), 1e-3, seed=seed)


def test_a_cloth_that_buckles_is_fitted_to_its_noise():
    scene, truth, motion = compressed("bdf2", 2)
    fit = estimate(scene, motion)
    # free values take their share of the noise: the best ones cost less than the truth; other minima twice as much
    assert fit.cost < Objective(scene, motion).cost(truth)
    found = parameters(fit.scene) / truth
    known = Objective(scene, motion).identifiable
    assert np.median(np.abs(np.log(found[known]))) < 5e-3  # an eighth of how far they begin


@pytest.mark.parametrize(("seed", "shortened"), [(38, True), (10, False)])
def test_steps_that_switch_their_form_do_not_stall_it(seed, shortened):
    scene, truth, motion = compressed("implicit", seed, 3)
    aim = Objective(scene, motion, 1e-10)
    assert aim.remedies(truth).clamped_steps > 0
    assert (aim.remedies(truth).shortened_steps > 0) == shortened
    search = Search(aim, parameters(scene), (1.0 - 1e-9) * aim.rmse(aim.cost(truth)), 2000)
    with pytest.raises(Stop):  # it may end where it costs less than the truth
        trajectory_fit.by_gauss_newton(search, search.best.p, search.best.p, None)
    assert search.best.cost < aim.cost(truth)  # as above
