"""What each objective depends on, what it ignores, and what a fit with it recovers."""

import numpy as np
import pytest
from helpers.costs import cost, cost_and_derivative, jacobian, residual
from helpers.fits import estimate
from helpers.physics import rotation, scene
from helpers.scenes import cloth, even, trial

from clothfit import InvalidMotion, Motion, degrade, load, parameters, simulate, with_parameters
from clothfit.derivative.verify import check
from clothfit.engine.system import build
from clothfit.fit.estimate import record_target
from clothfit.objective.comparison import OBJECTIVES, Comparison
from clothfit.objective.measures import basis
from clothfit.objective.objective import Objective
from clothfit.objective.target import target

pytestmark = pytest.mark.slow  # compiles a fit

RNG = np.random.default_rng(31)
SYSTEM = build(scene(cloth(3, 2)), 0)
N, FRAMES, DELTA = 6, 12, 0.02


def against(positions, objective, times=None, seen=None, weights=None):
    """A comparison of the small cloth with these positions."""
    times = DELTA * np.arange(len(positions)) if times is None else np.asarray(times)
    goal = target(Motion(positions, times, (N,), seen, "walk.npz", weights=weights), 0, DELTA)
    return Comparison(goal, SYSTEM, {objective: 1.0}, name="walk.npz")


def walk():
    return SYSTEM.x0 + 0.1 * RNG.normal(size=(FRAMES, N, 3))


# --- what they see


def test_velocity_is_blind_to_an_offset_and_sees_a_drift():
    x, drift = walk(), np.array([0.3, 0.0, -0.4])
    made = against(x, "velocity")
    assert cost(made, x + 5.0) < 1e-25  # rounding of 5 m, over 0.02 s, of 200 numbers
    times = DELTA * np.arange(FRAMES)[:, None, None]
    assert cost(made, x + times * drift) == pytest.approx(0.25 * (FRAMES - 1) * N, rel=1e-10)  # (0.5 m/s)² each


def test_velocity_needs_both_frames():
    seen = np.ones((FRAMES, N), bool)
    seen[4, 2] = False
    made = against(walk(), "velocity", seen=seen)
    assert made.total_weight == (FRAMES - 1) * N - 2
    made = against(walk(), "velocity", seen=np.arange(FRAMES)[:, None] % 2 == np.zeros(N))
    assert made.total_weight == 0.0  # every second frame: no two successive ones
    assert not made.seen.any()


def test_two_frames_that_count_as_one_step_have_no_velocity():
    made = against(walk()[:3], "velocity", [0.02, 0.02 + 1e-7, 0.04])
    assert made.total_weight == N


def test_edge_lengths_are_blind_to_rigid_motion_and_see_a_stretch():
    x = walk()
    made = against(x, "edge-length")
    assert cost(made, x @ rotation((1, 2, 3), 0.7).T + 2.0) < 1e-25  # rounding of metres
    ends = SYSTEM.springs.ends
    lengths = np.linalg.norm(x[:, ends[:, 0]] - x[:, ends[:, 1]], axis=2)
    assert cost(made, 1.1 * x) == pytest.approx(0.01 * (lengths**2).sum(), rel=1e-12)  # rounding
    assert made.total_weight == FRAMES * len(ends)


@pytest.mark.parametrize("objective", ["edge-length", "spectrum"])
def test_an_edge_of_no_length_has_no_direction_and_at_amplitude_zero_the_tip_of_the_spectrum_is_round(objective):
    still = np.zeros((FRAMES, N, 3)) + (SYSTEM.x0 if objective == "spectrum" else 0.0)
    made = against(walk(), objective)
    value, derivative = cost_and_derivative(made, still)
    J = jacobian(made, still).data
    assert value > 0
    assert np.abs(derivative).max() == 0.0
    assert not J.any() if objective == "spectrum" else np.isfinite(J).all()


@pytest.mark.parametrize("frames", [4, 11, 12])
def test_the_sum_of_squared_amplitudes_is_that_of_the_windowed_positions(frames):
    x = walk()[:frames]
    still = np.broadcast_to(SYSTEM.x0, x.shape)
    made = against(still, "spectrum")
    hann = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(frames) / frames)
    windowed = hann[:, None, None] * (x - SYSTEM.x0)
    # the tip is rounded off by a micrometre: 2e-6 of amplitudes of 0.1
    assert cost(made, x) == pytest.approx((windowed**2).sum() / (hann**2).mean(), rel=1e-4)
    # no constant is lost: without the window's shape the rows are orthonormal
    C, S = basis(frames)
    assert ((C**2).sum() + (S**2).sum()) == pytest.approx(frames, rel=1e-12)


def test_the_spectrum_is_blind_to_phase():
    # four periods in 32 frames: under the window only frequencies 3, 4, 5 answer, whatever the phase
    t = np.arange(32)[:, None, None]
    waves = [SYSTEM.x0 + 0.1 * np.sin(2 * np.pi * 4 * t / 32 + phase) * np.ones((N, 3)) for phase in (0.0, 1.3, 2.9)]
    made = against(waves[0], "spectrum")
    assert max(cost(made, wave) for wave in waves) < 1e-25  # rounding
    assert cost(made, SYSTEM.x0 + 2 * (waves[0] - SYSTEM.x0)) > 0.1
    moved = residual(made, 2 * waves[1] - SYSTEM.x0).reshape(17, N, 3)
    assert np.flatnonzero(np.abs(moved).max(axis=(1, 2)) > 1e-6).tolist() == [3, 4, 5]


def test_a_vertex_that_is_not_seen_throughout_has_no_spectrum():
    seen = np.ones((FRAMES, N), bool)
    seen[3, 1] = False
    made = against(walk(), "spectrum", seen=seen)
    assert np.flatnonzero(~made.seen).tolist() == [1]
    assert made.total_weight == (FRAMES // 2 + 1) * (N - 1)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0, 0.02, 0.04, 0.07, 0.08], "walk.npz: times[3]: the spectrum needs frames at equal distances in time"),
        ([0, 0.02, 0.04], "walk.npz: 3 of its frames are compared; the spectrum needs at least 4"),
    ],
)
def test_frames_that_have_no_spectrum_are_refused(times, message):
    with pytest.raises(InvalidMotion) as caught:
        against(walk()[: len(times)], "spectrum", times)
    assert str(caught.value) == message


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_one_weight_for_all_is_a_factor(objective):
    x, other = walk(), walk()
    plain, heavy = (against(x, objective, weights=w) for w in (None, np.full((FRAMES, N), 3.0)))
    assert cost(heavy, other) == pytest.approx(3.0 * cost(plain, other), rel=1e-13)  # rounding
    assert heavy.total_weight == pytest.approx(3.0 * plain.total_weight, rel=1e-13)


# --- through the simulation


CAPTURES = {"every step": {}, "every third": {"every": 3}, "30 a second": {"fps": 30}}
MIXED = {"position": 1.0, "velocity": 0.01, "edge-length": 2.0, "spectrum": 0.5}


@pytest.mark.parametrize("loss", ["linear", "huber", "soft_l1"])
@pytest.mark.parametrize("objective", [*OBJECTIVES, MIXED], ids=str)
def test_the_gradient_through_the_simulation(objective, loss):
    made = load(trial("LL", 16, 3, 3, vertMass=[0.05 + 0.005 * i for i in range(9)]))
    p = parameters(made)
    truth = with_parameters(made, 1.2 * p * np.exp(0.2 * RNG.normal(size=p.shape)))
    goal = degrade(simulate(truth, tolerance=1e-14), fps=37)
    scale = None if loss == "linear" else 0.01
    objective = Objective(made, goal, objective=objective, loss=loss, loss_scale=scale)
    report = check(objective, p, seed=4)
    assert loss != "linear" or report.order > 1.9
    assert report.difference < 1e-6  # rounding of the cost, 1e-13, over the step
    assert report.product < 1e-12  # linear systems are solved to 1e-14


@pytest.mark.parametrize(
    ("objective", "capture"),
    [("position", "every step"), ("position", "every third"),
     *((each, "30 a second") for each in (*OBJECTIVES, MIXED))],
    ids=str,
)  # fmt: skip
def test_a_fit_recovers_what_is_hidden(objective, capture):
    made = load(even("GG", 31))
    goal = degrade(record_target(made), **CAPTURES[capture])
    found = estimate(made, goal, start=[0.03, 20.0], method="l-bfgs-b", objective=objective)
    np.testing.assert_allclose(parameters(found.scene), [0.02, 30.0], rtol=1e-4)  # the motion is solved to 1e-10
    assert found.rmse < 1e-5


def test_the_rmse_of_a_fit_is_that_of_positions():
    made = load(even("nG"))
    goal = record_target(made)
    goal.positions[1:] += [0.0, 0.1, 0.0]
    found = estimate(made, goal, start=25.0, method="l-bfgs-b", objective="edge-length")
    np.testing.assert_allclose(parameters(found.scene), 30.0, rtol=1e-4)  # blind to the shift
    assert found.rmse == pytest.approx(0.1 * np.sqrt(19 / 20), rel=1e-3)
    assert found.cost < 1e-6


@pytest.mark.parametrize("loss", ["huber", "soft_l1"])
def test_outliers_do_not_decide_a_robust_fit(loss):
    made = load(even("GG", 31))
    goal = record_target(made)
    wild = np.random.default_rng(5).random(goal.positions.shape[:2]) < 0.05
    wild[0] = False
    goal.positions[wild] += [0.5, 0.5, -0.3]
    given = {"start": [0.03, 20.0], "method": "l-bfgs-b", "keep_markers": True}  # else single jumps are left out
    plain = estimate(made, goal, **given)
    robust = estimate(made, goal, **given, loss=loss, loss_scale=1e-3)
    errors = [np.abs(parameters(fit.scene) / [0.02, 30.0] - 1).max() for fit in (plain, robust)]
    assert errors[1] < 0.01  # a gap of 0.8 m pulls as one of a millimetre does: 5 % of them, of a motion of 0.1 m
    assert errors[1] < 0.1 * errors[0]
