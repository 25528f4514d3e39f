"""Confidence: the textbook's intervals, directions that the motion does not show, coverage, every method."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers.marks import FITS
from helpers.scenes import cloth, document, even, trial
from scipy import stats

from clothfit.fit import posterior
from clothfit.fit.confidence import not_shown
from clothfit.fit.estimate import estimate, looked_at, record_target
from clothfit.fit.options import OWN_METHODS, FitOptions
from clothfit.fit.posterior import half_width, inverse_beside, null_space
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import as_motion
from clothfit.motion.simulate import simulate
from clothfit.optimise import trajectory
from clothfit.optimise.scipy_methods import METHODS
from clothfit.scene.fit_vector import LOWER, UPPER, parameters, with_parameters
from clothfit.scene.kinds import KIND
from clothfit.scene.scene import load

pytestmark = FITS


def chain(ends, fixed, settings="nL", **fields):
    """An object of vertices at (i, 0, 0) with springs between these pairs, and neither air nor damping."""
    made = {
        "vertPos": [{"x": float(i), "y": 0.0, "z": 0.0} for i in range(len(fixed))],
        "vertIsFixed": fixed,
        "vertMass": [0.01] * len(fixed),
        "springs": [vertex for pair in ends for vertex in pair],
        "springStiffness": [20.0 + 3.0 * s for s in range(len(ends))],
        "triangles": [],
        "dragCoefficient": 0.0,
        "damping": 0.0,
        "optimizationSettings": settings,
    }
    return {**cloth(2, 2), **made, **fields}


def intervals(found):
    """The intervals (P, 2), NaN where there is none."""
    return np.array([pair or (np.nan, np.nan) for block in found.parameters for pair in block.interval])


# --- the textbook


def test_half_an_interval_of_one_and_two_degrees_has_closed_forms():
    assert half_width(1.0) == pytest.approx(np.tan(np.pi * 0.95 / 2), rel=1e-11)  # Cauchy
    assert half_width(2.0) == pytest.approx(0.95 * np.sqrt(2 / (1 - 0.95**2)), rel=1e-11)


def ballistic(frames=8):
    """One vertex without springs, thrown with a velocity that is fitted: its positions are linear in that."""
    return load(document(chain([], [False], "nn", fit={"vertVel": "L"}), optimizationIterations=frames))


def thrown(scene, noise, seed):
    """A noisy target of that scene, and the interval of each velocity that linear regression gives."""
    motion = degrade(record_target(scene), noise, seed=seed)
    times, steps = motion.times[1:], len(motion.times) - 1
    away = (motion.positions - record_target(scene).positions)[1:, 0]  # of the truth 0 m/s
    slope = times @ away / (times @ times)
    rest = away - times[:, None] * slope
    spread = np.sqrt((rest**2).sum() / (3 * steps - 3))
    half = stats.t.ppf(0.975, 3 * steps - 3) * spread / np.sqrt(times @ times)
    return motion, np.stack([slope - half, slope + half], axis=1), spread


@pytest.mark.parametrize("method", ["auto", "l-bfgs-b"])
def test_a_linear_problem_has_the_intervals_of_regression(method):
    scene = ballistic()
    motion, expected, spread = thrown(scene, 1e-3, seed=3)
    found = estimate(scene, motion, method=method)
    # The end of a fit leaves a tenth of a standard deviation at most, L-BFGS-B much less; linear systems 1e-10.
    np.testing.assert_allclose(intervals(found), expected, atol=0.2 * spread)
    assert found.sigma == pytest.approx(spread, rel=1e-2)
    assert found.rank == 3
    assert found.parameters[0].unidentifiable == []


def test_intervals_of_a_linear_problem_cover_the_truth():
    scene = ballistic(4)
    ends = [intervals(estimate(scene, thrown(scene, 1e-3, seed)[0], method="gauss-newton")) for seed in range(80)]
    covered = np.mean([(low <= 0.0) & (high >= 0.0) for low, high in (pairs.T for pairs in ends)])
    # 240 intervals, three of each share σ: a standard error of 0.02 at most, and three of them
    assert 0.89 <= covered <= 1.0
    assert covered < 1.0  # six degrees of freedom: the normal distribution's 1.96 would cover 0.90


def test_one_mass_on_one_spring():
    scene = load(document(chain([(0, 1)], [True, False], vertMass=[0.1, 0.1]), optimizationIterations=30))
    motion = degrade(record_target(scene), 1e-3, seed=1)
    found = estimate(scene, motion)
    k = parameters(found.scene)
    tried = {step: with_parameters(scene, k * np.exp(step)) for step in (-1e-5, 0, 1e-5)}
    x = {step: simulate(changed, tolerance=1e-13).positions for step, changed in tried.items()}
    J = (x[1e-5] - x[-1e-5])[1:, 1].ravel() / 2e-5  # by log k; differences are good to 1e-8
    count = 3 * 29  # the initial state and the fixed vertex say nothing
    spread = np.sqrt((((x[0] - motion.positions)[1:, 1]) ** 2).sum() / (count - 1))
    half = stats.t.ppf(0.975, count - 1) * spread / np.linalg.norm(J)
    ((low, high),) = intervals(found)
    # Up to a tenth of a standard deviation is left of the way where a fit ends.
    np.testing.assert_allclose(np.log([low, high] / k), [-half, half], rtol=0.06)
    assert found.sigma == pytest.approx(spread, rel=1e-6)


# --- what the motion does not show


def test_of_a_common_factor_nothing_is_determined_and_the_start_keeps_its_mean():
    scene = load(trial("LL", dragCoefficient=0.0))
    start = np.concatenate([np.full(16, 0.03), np.full(33, 20.0)])
    found = estimate(scene, start=start)
    mass, stiffness = found.parameters
    assert (mass.unidentifiable, stiffness.unidentifiable) == (list(range(16)), list(range(33)))
    assert np.isnan(intervals(found)).all()
    assert found.rank == 16 - 2 + 33 - 1  # two masses are fixed, one factor is free
    p = parameters(found.scene)
    free = np.delete(np.arange(49), [0, 3])
    assert np.log(p[free]).mean() == pytest.approx(np.log(start[free]).mean(), abs=1e-9)  # rounding of the null space
    ratio = p[free] / parameters(scene)[free]
    np.testing.assert_allclose(ratio, ratio.mean(), rtol=1e-4)  # RMSE below 1e-8 m: all but the factor is found


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("ends", [(0.01, 1.0), (1e-4, 0.01)])
def test_a_bound_that_the_data_do_not_push_against_determines_nothing(ends, seed):
    made = chain([(0, 1)], [True, False], "LL", fit={"bounds": {"mass": ends}})
    scene = load(document(made, optimizationIterations=30))  # the mass, 0.01 kg, is at one of its bounds
    found = estimate(scene, degrade(record_target(scene), 1e-3, seed=seed), prior="none")
    assert [block.unidentifiable for block in found.parameters] == [[0, 1], [0]]
    assert np.isnan(intervals(found)).all()


def test_a_spring_that_is_never_stretched_keeps_its_start_and_no_other_is_lost():
    made = chain([(0, 1), (2, 3)], [True, False, False, False])  # the second pair falls freely
    scene = load(document(made, optimizationIterations=20))
    found = estimate(scene, start=35.0, method="l-bfgs-b")
    (block,) = found.parameters
    assert (block.unidentifiable, found.rank) == ([1], 1)
    assert block.interval[1] is None
    first, second = parameters(found.scene)
    assert second == 35.0
    low, high = block.interval[0]
    assert low <= 20.0 <= high
    assert first == pytest.approx(20.0, rel=1e-4)  # RMSE below 1e-8 m


@pytest.mark.parametrize("method", ["auto", "l-bfgs-b"])
def test_of_two_springs_side_by_side_only_the_sum_is_seen(method):
    made = chain([(0, 1), (0, 1), (1, 2)], [True, False, False])
    scene = load(document(made, optimizationIterations=20))
    found = estimate(scene, start=35.0, method=method)
    (block,) = found.parameters
    assert (block.unidentifiable, found.rank) == ([0, 1], 2)
    assert [pair is None for pair in block.interval] == [True, True, False]
    assert found.status == "converged"
    assert found.rmse <= 1e-8  # what is listed was not set back where that would cost
    assert parameters(found.scene)[:2].sum() == pytest.approx(43.0, rel=1e-4)


def test_what_is_hidden_by_its_place_is_listed_as_well():
    found = estimate(load(trial("Ln")), start=0.03)
    assert found.parameters[0].unidentifiable == [0, 3]
    assert np.isnan(intervals(found)[[0, 3]]).all()
    assert np.isfinite(np.delete(intervals(found), [0, 3], axis=0)).all()


def test_the_null_space_does_not_depend_on_units():
    rng = np.random.default_rng(0)
    J = rng.normal(size=(30, 6))
    J[:, 5] = J[:, 0] + J[:, 1]
    scale = 10.0 ** np.array([-6.0, 6.0, 0.0, 3.0, -3.0, 1.0])
    H = (J * scale).T @ (J * scale)
    null = null_space(H)
    expected = np.array([1.0, 1.0, 0.0, 0.0, 0.0, -1.0]) / scale
    # The vector is dominated by its first entry; 1e-8 is the square root of rounding.
    np.testing.assert_allclose(np.abs(null[:, 0]), np.abs(expected / np.linalg.norm(expected)), atol=1e-8)
    assert null.shape == (6, 1)
    K = inverse_beside(H, null)
    np.testing.assert_allclose(K[2:5, 2:5], np.linalg.pinv(J.T @ J)[2:5, 2:5] / np.outer(scale[2:5], scale[2:5]))


@pytest.mark.parametrize("least", [1e-6, 1e-13, 0.0])
def test_the_short_way_to_the_null_space_and_beside_it_is_the_long_one(least, monkeypatch):
    """An eigenvalue far above, about and below the rounding of the largest."""
    Q = np.linalg.qr(np.random.default_rng(1).normal(size=(8, 8)))[0]
    H = (Q * np.append(np.linspace(1.0, 2.0, 7), least)) @ Q.T
    null = null_space(H)
    K = inverse_beside(H, null)
    monkeypatch.setattr(posterior, "is_regular", lambda unit: False)
    assert null_space(H).shape == null.shape == (8, int(least < 1e-12))
    wanted = np.linalg.pinv(H, rcond=1e-10, hermitian=True)
    np.testing.assert_allclose(K, wanted, rtol=1e-6, atol=1e-7 * np.abs(K).max())  # the ridge over the least is 1e-7


# --- intervals of cloths


def test_intervals_of_a_cloth_cover_its_masses():
    scene = load(trial("Ln", 15))
    inside = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        truth = with_parameters(scene, 0.02 * np.exp(rng.normal(0.0, 0.3, 16)))
        found = estimate(scene, degrade(record_target(truth), 1e-3, seed=seed))
        ends, true = intervals(found), parameters(truth)
        kept = np.isfinite(ends[:, 0])
        inside.append(((ends[:, 0] <= true) & (true <= ends[:, 1]))[kept])
    # 280 intervals, 14 of each fit correlated: a standard error of about 0.025
    assert 0.87 <= np.mean(inside) < 1.0


@pytest.mark.parametrize("method", [*OWN_METHODS, *METHODS])
def test_every_method_has_intervals(method):
    scene = load(even("nG", 10, 3, 3))
    motion = degrade(record_target(scene), 1e-3, seed=2)
    found = estimate(scene, motion, start=20.0, method=method)
    ((low, high),) = intervals(found)
    (k,) = parameters(found.scene)
    reference = intervals(estimate(scene, motion, start=20.0, method="l-bfgs-b"))[0]
    assert low <= k <= high  # the momentum fit of so much noise ends at a bound, and its interval goes inwards
    # Wherever a fit ended, its interval holds the minimum of the cost.
    assert low < np.sqrt(reference.prod()) < high
    assert found.rank == 1


def test_a_fit_that_did_not_arrive_has_intervals_that_reach_there():
    scene = load(even("nG", 10, 3, 3))
    found = estimate(scene, start=27.0, method="l-bfgs-b", max_evaluations=1)
    assert (found.status, found.parameters[0].unmoved) == ("limit", [0])
    ((low, high),) = intervals(found)
    assert low < 30.0 < high
    assert estimate(scene, start=27.0).parameters[0].unmoved == []


@pytest.mark.parametrize(("true", "bound"), [(1e-6, LOWER), (3e4, UPPER)])
def test_at_a_bound_the_interval_goes_inwards(true, bound):
    scene = load(even("nG", springStiffness=[true] * 33, damping=0.5, fit={"bounds": {"stiffness": [LOWER, UPPER]}}))
    found = estimate(scene, start=10.0)
    ((low, high),) = intervals(found)
    assert found.parameters[0].at_bound == [0]
    assert parameters(found.scene) == pytest.approx(bound, rel=1e-9)  # rounding of log and exp
    assert LOWER <= low < high <= UPPER
    assert bound == pytest.approx(low if bound == LOWER else high, rel=1e-9)  # rounding of exp and log


def test_a_cloth_that_is_too_large_has_none_and_says_so(monkeypatch):
    monkeypatch.setattr(trajectory, "LARGEST", 0.0)
    scene = load(even("nG", 10, 3, 3))
    found = estimate(scene, degrade(record_target(scene), 1e-3), start=20.0, method="l-bfgs-b")
    assert (found.rank, found.parameters[0].interval) == (None, [None])
    assert any("no intervals" in warning for warning in found.warnings)


def test_they_can_be_left_out():
    found = estimate(load(even("nG", 10, 3, 3)), start=20.0, intervals=False)
    assert (found.rank, found.sigma, found.parameters[0].interval, found.warnings) == (None, None, [None], [])


def test_they_count_neither_as_evaluations_nor_as_time():
    scene = load(even("nG", 10, 3, 3))
    counts = [estimate(scene, start=20.0, intervals=asked).evaluations for asked in (True, False)]
    assert counts[0] == counts[1]


def test_the_prior_is_told():
    scene = load(trial("Ln", 15))
    motion = degrade(record_target(scene), 1e-3, seed=0)
    (learned,) = estimate(scene, motion, start=0.02).prior
    assert (learned.object, learned.name) == (0, "mass")
    assert 1e-3 <= learned.tau <= 3.0
    (given,) = estimate(scene, motion, start=0.02, prior=0.25).prior
    assert given.tau == 0.25
    assert estimate(scene, motion, start=0.02, prior="none").prior is None


def test_a_linear_kind_is_cut_at_its_bounds():
    made = document(cloth(3, 3, damping=1e-4, fit={"damping": "G"}), optimizationIterations=8)
    motion = degrade(record_target(load(made)), 5e-3, seed=1)
    ((low, high),) = intervals(estimate(load(made), motion))
    assert low == KIND["damping"].lower == 0.0
    assert high > 0.0


def test_a_target_without_noise_at_the_truth_has_intervals_of_rounding():
    scene = load(even("nG", 10, 3, 3))
    found = estimate(scene, as_motion(scene, record_target(scene).positions))
    ((low, high),) = intervals(found)
    assert low == pytest.approx(30.0, rel=1e-7)  # the tolerance of the linear systems is 1e-10
    assert high == pytest.approx(30.0, rel=1e-7)


def test_variances_beyond_numbers_hide_what_they_belong_to():
    local = SimpleNamespace(width=np.ones(3))
    never = np.zeros((3, 0))
    known = SimpleNamespace(
        local=local, free=np.arange(3), null=never, deviation=np.array([np.inf, 0.1, np.inf]),
        at_minimum=np.ones(3, bool), sigma2=1.0, K=np.diag([np.inf, 0.01, np.nan]),
    )  # fmt: skip
    hidden = not_shown(known, True)
    assert hidden.flags.tolist() == [True, False, True]
    np.testing.assert_allclose(np.abs(hidden.directions), [[1, 0], [0, 0], [0, 1]])


def test_a_fit_that_cannot_be_looked_at_is_kept_with_a_warning():
    made = document(chain([(0, 1)], [True, False]), optimizationIterations=4)
    found = estimate(load(made), max_evaluations=1, intervals=False)

    def look(found):
        raise np.linalg.LinAlgError("Singular matrix")

    kept = looked_at(found, look, options=FitOptions())
    assert kept.scene is found.scene
    assert kept.warnings == [*found.warnings, "the fit could not be looked at in full: Singular matrix"]


def test_where_a_step_of_the_motion_is_singular_there_are_no_intervals(monkeypatch):
    def singular(*given):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(trajectory.Trajectory, "model", singular)
    made = document(chain([(0, 1)], [True, False]), optimizationIterations=4)
    target = simulate(load(made).with_values([[0.01, 0.01]], [[15.0]]))  # of no balance, so that the model is asked for
    found = estimate(load(made), degrade(target, noise=1e-4, seed=1), method="l-bfgs-b", max_evaluations=2)
    assert found.parameters[0].interval is None or not any(found.parameters[0].interval)
