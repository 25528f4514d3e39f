"""Confidence: the textbook's intervals, directions that the motion does not show, coverage, every method, samples, and
covariances from blocks of frames where the model differs.
"""

from dataclasses import asdict, replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import strangers
from helpers.fits import Watching, estimate
from helpers.scenes import cloth, document, even, trial
from scipy import stats

from clothfit import degrade, load
from clothfit.cli.parts.estimate_results import certainty
from clothfit.fit import confidence, posterior, result
from clothfit.fit.confidence import null_space_of
from clothfit.fit.estimate import looked_at, record_target
from clothfit.fit.options import OWN_METHODS, Request
from clothfit.fit.posterior import blocks_of, half_width, inverse_outside, null_space
from clothfit.fit.routes import ALIKE
from clothfit.optimise import trajectory
from clothfit.optimise.scipy_methods import METHODS
from clothfit.optimise.trajectory import Kept
from clothfit.report import findings
from clothfit.scene.fit_vector import LOWER, UPPER, parameters, with_parameters
from clothfit.scene.kinds import KIND

pytestmark = pytest.mark.slow


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


@pytest.fixture(scope="module")
def sheet():
    """A small sheet of one stiffness, and a noisy motion of it."""
    scene = load(even("nG", 10, 3, 3))
    return scene, degrade(record_target(scene), 1e-3, seed=2)


@pytest.fixture(scope="module")
def minimum(sheet):
    """The interval of its stiffness where L-BFGS-B ends."""
    return intervals(estimate(*sheet, start=20.0, method="l-bfgs-b"))[0]


@pytest.fixture
def certain(monkeypatch):
    """What the scene says of all that is not fitted is right, as in textbooks."""
    monkeypatch.setattr(result, "alternatives", lambda search: None)


def intervals(found):
    """The intervals (P, 2), NaN where there is none."""
    return np.array([pair or (np.nan, np.nan) for block in found.parameters for pair in block.interval])


# --- the textbook


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


@pytest.mark.usefixtures("certain")
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


@pytest.mark.parametrize("seed", range(3))
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
    K = inverse_outside(H, null)
    np.testing.assert_allclose(K[2:5, 2:5], np.linalg.pinv(J.T @ J)[2:5, 2:5] / np.outer(scale[2:5], scale[2:5]))


@pytest.mark.parametrize("least", [1e-6, 1e-13, 0.0])
def test_the_short_way_to_the_null_space_and_beside_it_is_the_long_one(least, monkeypatch):
    """An eigenvalue far above, about and below the rounding of the largest."""
    Q = np.linalg.qr(np.random.default_rng(1).normal(size=(8, 8)))[0]
    H = (Q * np.append(np.linspace(1.0, 2.0, 7), least)) @ Q.T
    null = null_space(H)
    K = inverse_outside(H, null)
    monkeypatch.setattr(posterior, "is_regular", lambda unit: False)
    assert null_space(H).shape == null.shape == (8, int(least < 1e-12))
    wanted = np.linalg.pinv(H, rcond=1e-10, hermitian=True)
    np.testing.assert_allclose(K, wanted, rtol=1e-6, atol=1e-7 * np.abs(K).max())  # the ridge over the least is 1e-7


# --- intervals of cloths


@pytest.mark.usefixtures("certain")
def test_intervals_of_a_cloth_cover_its_masses():
    scene = load(trial("Ln", 15))
    inside = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        truth = with_parameters(scene, 0.02 * np.exp(rng.normal(0.0, 0.3, 16)))
        found = estimate(scene, degrade(record_target(truth), 1e-3, seed=seed))
        ends, true = intervals(found), parameters(truth)
        kept = np.isfinite(ends[:, 0])
        assert np.flatnonzero(~kept).tolist() == found.parameters[0].unidentifiable == [0, 3]  # what is held
        inside.append(((ends[:, 0] <= true) & (true <= ends[:, 1]))[kept])
    # 140 intervals, 14 of each fit correlated: a standard error of about 0.035
    assert 0.87 <= np.mean(inside) < 1.0


@pytest.mark.parametrize("method", [*OWN_METHODS, *METHODS])
def test_every_method_has_intervals(sheet, minimum, method):
    found = estimate(*sheet, start=20.0, method=method)
    ((low, high),) = intervals(found)
    (k,) = parameters(found.scene)
    assert low <= k <= high  # the momentum fit of so much noise ends at a bound, and its interval goes inwards
    # Wherever a fit ended, its interval holds the minimum of the cost.
    assert low < np.sqrt(minimum.prod()) < high
    assert found.rank == 1


def test_a_fit_that_did_not_arrive_has_intervals_that_reach_there_unless_they_are_left_out(sheet):
    scene, _ = sheet
    found = estimate(scene, start=27.0, method="l-bfgs-b", max_evaluations=1)
    assert (found.status, found.parameters[0].unmoved) == ("limit", [0])
    ((low, high),) = intervals(found)
    assert low < 30.0 < high
    arrived, without = (estimate(scene, start=27.0, intervals=asked) for asked in (True, False))
    assert arrived.parameters[0].unmoved == []
    assert arrived.evaluations == without.evaluations  # they do not count
    assert (without.rank, without.sigma, without.parameters[0].interval, without.warnings) == (None, None, [None], [])


@pytest.mark.parametrize(("true", "bound"), [(1e-6, LOWER), (3e4, UPPER)])
def test_at_a_bound_the_interval_goes_inwards(true, bound):
    scene = load(even("nG", springStiffness=[true] * 33, damping=0.5, fit={"bounds": {"stiffness": [LOWER, UPPER]}}))
    found = estimate(scene, start=10.0)
    ((low, high),) = intervals(found)
    assert found.parameters[0].at_bound == [0]
    assert parameters(found.scene) == pytest.approx(bound, rel=1e-9)  # rounding of log and exp
    assert LOWER <= low < high <= UPPER
    assert bound == pytest.approx(low if bound == LOWER else high, rel=1e-9)  # rounding of exp and log


def test_the_prior_is_told():
    scene = load(trial("Ln", 15))
    motion = degrade(record_target(scene), 1e-3, seed=0)
    learned, given, none = (estimate(scene, motion, start=0.02, prior=each).prior for each in ("auto", 0.25, "none"))
    assert [(each.object, each.name) for each in learned] == [(0, "mass")]
    assert 1e-3 <= learned[0].tau <= 3.0
    assert [each.tau for each in given] == [0.25]
    assert none is None


def test_a_target_without_noise_at_the_truth_has_intervals_of_rounding(sheet):
    ends = intervals(estimate(sheet[0], record_target(sheet[0])))
    np.testing.assert_allclose(ends, 30.0, rtol=1e-7)  # the tolerance of the linear systems is 1e-10


def test_variances_beyond_numbers_hide_what_they_belong_to():
    local = SimpleNamespace(width=np.ones(3))
    never = np.zeros((3, 0))
    known = SimpleNamespace(
        local=local, free=np.arange(3), null=never, deviation=np.array([np.inf, 0.1, np.inf]),
        at_minimum=np.ones(3, bool), sigma2=1.0, K=np.diag([np.inf, 0.01, np.nan]),
    )  # fmt: skip
    hidden = null_space_of(known, True)
    assert hidden.flags.tolist() == [True, False, True]
    np.testing.assert_allclose(np.abs(hidden.directions), [[1, 0], [0, 0], [0, 1]])


def singular(*given):
    raise np.linalg.LinAlgError("Singular matrix")


def test_a_fit_that_cannot_be_looked_at_is_kept_with_a_warning(sheet):
    found = estimate(sheet[0], max_evaluations=1, intervals=False)
    kept = looked_at(found, singular, options=Request())
    assert kept.scene is found.scene
    assert kept.warnings == [*found.warnings, f"the fit could not be looked at in full: {ALIKE}"]


@pytest.mark.parametrize(("of", "name", "value"), [(trajectory, "LARGEST", 0.0),
                                                   (trajectory.Trajectory, "model", singular)])  # fmt: skip
def test_of_a_cloth_that_is_too_large_and_where_a_step_is_singular_there_are_none(monkeypatch, sheet, of, name, value):
    monkeypatch.setattr(of, name, value)
    found = estimate(*sheet, start=20.0, method="l-bfgs-b", max_evaluations=2)
    assert (found.rank, found.parameters[0].interval) == (None, [None])
    assert any("no intervals" in warning for warning in found.warnings)


def test_without_trusted_intervals_only_what_changes_nothing_is_not_shown():
    """Masses and stiffness have a common factor; that the four fixed masses are nowhere in the motion is certain."""
    own = strangers.small("LG", 10, dragCoefficient=0.0)
    target = strangers.with_finer_steps(own, 4)
    found = estimate(own, target, prior="none", method="gauss-newton", max_evaluations=1)
    assert confidence.UNTRUSTED in found.warnings
    assert [block.unidentifiable for block in found.parameters] == [[0, 1, 2, 3], []]


# --- by samples


K = confidence.SAMPLES


@pytest.fixture(scope="module")
def sparse():
    """A scene and a sparse target of its own motion."""
    made = load(trial("nL", 40))
    return made, degrade(record_target(made), 1e-3, observed=0.8, seed=1)


@pytest.fixture(scope="module")
def by_samples(sparse):
    """A fit whose confidence may use no matrix."""
    with pytest.MonkeyPatch.context() as patch:
        return by_products(patch, *sparse)


def by_products(monkeypatch, scene, target, prior=0.5, **options):
    """The same, of any target."""
    monkeypatch.setattr(trajectory, "LARGEST", 0.0)
    return estimate(scene, target, start=20.0, prior=prior, **options)


def test_they_are_those_of_the_matrix_as_far_as_samples_know(sparse, by_samples):
    exact, found = estimate(*sparse, start=20.0, prior=0.5), by_samples
    assert exact.samples is None
    assert found.samples == confidence.Samples(K, pytest.approx(1.0 / np.sqrt(2.0 * K)))
    assert found.cost == pytest.approx(exact.cost, rel=1e-9)  # the fit itself is the same
    assert found.sigma == pytest.approx(exact.sigma, rel=1e-2)  # by a γ of samples, of some 1,300 residuals
    known = np.isfinite(intervals(exact)).all(axis=1)
    np.testing.assert_array_equal(np.isfinite(intervals(found)).all(axis=1), known)
    mine, theirs = (np.log(pairs[known, 1] / pairs[known, 0]) / 2.0 for pairs in (intervals(found), intervals(exact)))
    ratio = mine / half_width(K) / (theirs / half_width(1e3))
    low, high = stats.chi2.ppf([1e-5 / len(ratio), 1 - 1e-5 / len(ratio)], K) / K
    # what the last round left, a twentieth of a deviation, and the step that is left, up to a fifth of one
    assert (ratio > 0.9 * np.sqrt(low)).all()
    assert (ratio < 1.2 * np.sqrt(high)).all()


def test_they_say_so_wherever_intervals_are_shown(by_samples):
    found = by_samples
    text = certainty(found.parameters[0], KIND["stiffness"], found.samples)
    assert text.endswith(f"(median 95 % interval, by {K} samples, to 18 %, for this model only)")
    assert "samples" not in certainty(found.parameters[0], KIND["stiffness"])
    given = {"samples": asdict(found.samples), "verdict": {"model": "adequate"}}
    assert findings.scope(given) == f"{findings.ONLY}; they are by {K} samples of the posterior, to 18%"
    for wrong in (None, [], {}, {"count": K}, {"count": "x", "accuracy": 0.1}, {"count": 16, "accuracy": 1e400}):
        assert findings.scope({"samples": wrong}) == ""
        assert findings.scope({**given, "samples": wrong}) == findings.ONLY


@pytest.mark.parametrize(("prior", "seconds"), [("none", confidence.LEAST_SECONDS), (0.5, 0.0)])
def test_without_a_prior_or_time_to_settle_there_are_none(monkeypatch, sparse, prior, seconds):
    monkeypatch.setattr(confidence, "SHARE", 0.0)
    monkeypatch.setattr(confidence, "LEAST_SECONDS", seconds)
    found = by_products(monkeypatch, *sparse, prior=prior)
    assert found.samples is None
    assert np.isnan(intervals(found)).all()
    assert any(text.startswith("no intervals") for text in found.warnings)


def test_a_request_ends_them_and_keeps_the_fit(monkeypatch, sparse):
    stages = []

    def end(progress):
        stages.append(progress.stage)
        if progress.stage == "intervals":
            raise KeyboardInterrupt

    found = by_products(monkeypatch, *sparse, observer=Watching(progress=end))
    assert stages[-1] == "intervals"
    assert found.status in ("converged", "stalled")
    assert found.samples is None
    assert found.rmse < 2.5e-3  # noise of 1 mm in three directions
    assert any("interrupted" in text for text in found.warnings)


# --- by blocks of frames


def kept(J, r):
    """The scores of one run with all coordinates, from J (T, R, Q) and r (T, R) of its steps."""
    made = Kept()
    scores = made.keep(np.arange(J.shape[2]))
    for each, left in zip(J, r, strict=True):
        scores.add(each, left, np.ones((1, 3, J.shape[2])))
    return made


def regression(seed, steps=42, rows=5, values=3):
    """Rows of a linear problem, in steps, with their residuals at the minimum, and K."""
    rng = np.random.default_rng(seed)
    J, y = rng.standard_normal((steps, rows, values)), rng.standard_normal((steps, rows))
    K = np.linalg.inv(np.einsum("trq,trp->qp", J, J))
    return J, np.einsum("trq,q->tr", J, K @ np.einsum("trq,tr->q", J, y)) - y, K


def test_of_a_linear_problem_it_is_the_jackknife_of_refits():
    J, r, K = regression(0)
    found = blocks_of(kept(J, r), np.ones(3)).covariance(np.arange(3), K)
    refits = []
    for b in range(3):
        rest = np.flatnonzero(np.arange(42) // 14 != b)
        refits.append(np.linalg.lstsq(J[rest].reshape(-1, 3), r[rest].reshape(-1), rcond=None)[0])
    spread = np.array(refits)  # of the steps from the minimum of all
    np.testing.assert_allclose(found, 2.0 * 2 / 3 * spread.T @ spread, rtol=1e-9)  # rounding


def test_what_one_block_alone_shows_is_not_known():
    J, r, _ = regression(1)
    J[14:, :, 2] = 0.0  # the third value acts in the first block only
    K = np.linalg.inv(np.einsum("trq,trp->qp", J, J))
    found = blocks_of(kept(J, r), np.ones(3)).covariance(np.arange(3), K)
    assert not found[2, 2] < 1e12 * K[2, 2]


def test_coordinates_scale_and_too_few_frames_say_nothing():
    J, r, K = regression(2, values=2)
    scale = np.array([2.0, 0.5])
    one = blocks_of(kept(J, r), np.ones(2)).covariance(np.arange(2), K)
    other = blocks_of(kept(J, r), scale).covariance(np.arange(2), K / np.outer(scale, scale))
    np.testing.assert_allclose(other, one / np.outer(scale, scale), rtol=1e-9)  # rounding
    assert blocks_of(kept(J[:11], r[:11]), scale) is None  # two blocks of four frames
    unseen = np.zeros((31, 0, 2)), np.zeros((31, 0))
    made = kept(J[:11], r[:11])
    for each, left in zip(*unseen, strict=True):
        made.runs[0][1].add(each, left, np.ones((1, 3, 2)))
    assert blocks_of(made, scale) is None  # steps between frames are no frames
    assert blocks_of(Kept(), np.ones(posterior.MOST_VALUES + 1)) is None


def test_several_motions_share_the_blocks():
    J, r, _ = regression(3)
    made = Kept()
    for part in np.array_split(np.arange(42), 3):
        scores = made.keep(np.arange(3))
        for t in part:
            scores.add(J[t], r[t], np.ones((1, 3, 3)))
    one, other = blocks_of(made, np.ones(3)), blocks_of(kept(J, r), np.ones(3))
    np.testing.assert_allclose(one.scores, other.scores, rtol=1e-12)  # the same blocks
    np.testing.assert_allclose(one.information, other.information, rtol=1e-12)


def test_growth_is_that_of_the_run_that_grows_most():
    made = Kept()
    for rate in (1.0, 1.2):
        scores = made.keep(np.arange(1))
        for t in range(101):
            scores.add(np.zeros((0, 1)), np.zeros(0), np.full((1, 1, 1), rate**t))
    assert made.growth == pytest.approx(1.2**75, rel=1e-9)  # from a quarter of 101 steps to the last


@cache
def other_model(settings="nG"):
    """A scene with one stiffness, and a noisy motion of the same cloth with a stiffness for each spring."""
    scattered = load(trial(settings, 40, 5, 5, vertMass=[0.02] * 25))
    return load(even(settings, 40, 5, 5)), degrade(record_target(scattered), 1e-4, seed=1)


def test_where_the_model_differs_intervals_are_wide_and_never_without_the_verdict():
    scene, motion = other_model()
    found = estimate(scene, motion)
    assert found.verdict.model == "differs"
    ((low, high),) = found.parameters[0].interval
    assert found.sigma > 3e-4  # far above the noise
    assert high / low > 1.1
    # Other frames give another value, which the interval contains.
    early = replace(motion, positions=motion.positions[:25], times=motion.times[:25])
    ((other_low, other_high),) = estimate(scene, early).parameters[0].interval
    assert max(low, other_low) < min(high, other_high)


def test_for_many_values_of_a_wrong_model_there_are_none():
    scene, motion = other_model("nL")
    wrong = replace(scene, gravity=scene.gravity * 0.8)
    found = estimate(wrong, motion, max_evaluations=30)
    assert found.verdict.model == "differs"
    assert not any(found.parameters[0].interval)
    assert found.parameters[0].unidentifiable == []
    assert any("the model differs" in text for text in found.warnings)


def test_a_chaotic_motion_is_called_so(monkeypatch):
    scene, motion = other_model()
    monkeypatch.setattr("clothfit.fit.confidence.CHAOS", 1.0)
    found = estimate(scene, motion)
    assert any("chaotic" in text for text in found.warnings)
    assert found.rank is None
    assert (found.parameters[0].unidentifiable, found.parameters[0].interval) == ([], [None])
