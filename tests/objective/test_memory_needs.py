"""What an objective holds, and fits that must do with less: the same result to the last bit, or a word."""


import numpy as np
import pytest
from helpers.fits import estimate
from helpers.scenes import trial

from clothfit import InvalidInput, as_motion, load, parameters, simulate, with_parameters
from clothfit.base.memory import human
from clothfit.engine import tape
from clothfit.engine.rollout import state_bytes
from clothfit.fit import trajectory_fit
from clothfit.objective import objective as objectives
from clothfit.objective.memory_needs import snapshot_bytes
from clothfit.objective.objective import Objective, cost_and_gradient

pytestmark = pytest.mark.slow  # compiles a fit

FRAMES = 80
PLENTY = 10**9
OBJECTIVES = ["position", "velocity", "edge-length", "spectrum", {"position": 2.0, "edge-length": 0.5}]


def guess(settings="nL", **fields):
    """A scene to fit, off its target, and the target."""
    truth = load(trial(settings, FRAMES, **fields))
    return with_parameters(truth, 1.2 * parameters(truth)), simulate(truth, tolerance=1e-10)


def tightest(made, motion, **options):
    """A budget in which a few states fit beside what is held anyway."""
    aim = Objective(made, motion, memory=PLENTY, **options)
    system = aim.runs[0].system
    return aim.needs.held + tape.least_bytes(aim.steps, state_bytes(system), snapshot_bytes(system))


@pytest.mark.parametrize("newton", [1, 3])
@pytest.mark.parametrize("objective", OBJECTIVES, ids=str)
def test_cost_and_gradient_are_the_same_to_the_last_bit(objective, newton):
    made, motion = guess(forwardSubSteps=newton)
    tight = tightest(made, motion, objective=objective)
    aim = Objective(made, motion, memory=tight, objective=objective)
    assert aim.needs.snapshots > 0
    assert len(aim.plan(aim.runs[0]).strides) > 1
    found = cost_and_gradient(made, motion, memory=tight, objective=objective)
    expected = cost_and_gradient(made, motion, memory=PLENTY, objective=objective)
    assert found[0] == expected[0] == aim.cost(parameters(made))
    np.testing.assert_array_equal(found[1], expected[1])
    p, direction = parameters(made), np.linspace(-1, 1, len(found[1]))
    whole = Objective(made, motion, memory=PLENTY, objective=objective)
    np.testing.assert_array_equal(aim.tangent(p, direction), whole.tangent(p, direction))


@pytest.mark.parametrize(
    ("settings", "method"), [("nL", "l-bfgs-b"), ("GG", "gauss-newton"), ("LL", "auto")]
)
def test_a_fit_in_little_memory_is_the_same_fit(settings, method):
    made, motion = guess(settings)
    noisy = as_motion(made, motion.positions + np.random.default_rng(4).normal(scale=1e-3, size=motion.positions.shape))
    tight = tightest(made, as_motion(made, noisy.positions[: FRAMES - FRAMES // 5]))
    found, expected = (
        estimate(made, noisy, method=method, max_evaluations=12, memory=size, holdout=0.2) for size in (tight, PLENTY)
    )
    assert (found.memory.snapshots or 0) > 0
    assert expected.memory.snapshots is None
    assert (found.cost, found.status, found.sigma) == (expected.cost, expected.status, expected.sigma)
    np.testing.assert_array_equal(parameters(found.scene), parameters(expected.scene))
    assert found.holdout == expected.holdout
    assert [block.interval for block in found.parameters] == [block.interval for block in expected.parameters]


def test_what_is_foreseen():
    made, motion = guess()
    needs = Objective(made, motion, memory="1GB").needs
    n, steps = 16, FRAMES - 1
    state = 24 * n * 2 + 31  # a position, a velocity, three counters, three flags, the part that was taken, the budget
    assert needs.held >= motion.positions.nbytes + 16 * FRAMES  # … and what was observed
    assert needs.predicted == needs.held + steps * state
    assert needs.summary() == {"foreseen": needs.predicted, "budget": 10**9, "snapshots": None}
    robust = Objective(made, motion, memory="1GB", loss="huber").needs
    assert robust.held >= needs.held + 5 * motion.positions.nbytes


def test_too_little_memory_is_refused_with_what_is_needed():
    made, motion = guess()
    tight = tightest(made, motion)
    for work in (lambda: cost_and_gradient(made, motion, memory=30_000), lambda: estimate(made, motion, memory="30kB")):
        with pytest.raises(InvalidInput) as caught:
            work()
        assert str(caught.value).startswith("memory: 30 kB is too little: the targets take ")
        assert str(caught.value).endswith(f"needs {human(tight)} in all")


def test_the_matrix_free_fit_in_little_memory_is_the_same(monkeypatch):
    made, motion = guess()
    monkeypatch.setattr(trajectory_fit, "LARGEST", 0.0)
    found, expected = (
        estimate(made, motion, method="gauss-newton", max_evaluations=8, memory=size, intervals=False)
        for size in (tightest(made, motion), PLENTY)
    )
    assert (found.memory.snapshots or 0) > 0
    assert (found.cost, found.evaluations) == (expected.cost, expected.evaluations)
    np.testing.assert_array_equal(parameters(found.scene), parameters(expected.scene))


def test_matrices_that_do_not_fit_give_way_with_a_word(monkeypatch):
    made, motion = guess("LL")
    monkeypatch.setattr(objectives, "NEGLIGIBLE_BYTES", 0)
    found = estimate(made, motion, max_evaluations=30, memory=tightest(made, motion))
    assert any(text.startswith("too little memory for the balance of momentum") for text in found.warnings)
    assert any(text.startswith("too little memory for the matrices") for text in found.warnings)
    assert any(text.startswith("no intervals") for text in found.warnings)
    assert found.rmse < 0.5 * Objective(made, motion).rmse(Objective(made, motion).cost(parameters(made)))
    with pytest.raises(InvalidInput, match="too little for the balance of momentum"):
        estimate(made, motion, method="momentum", memory=tightest(made, motion))


def test_too_little_memory_is_refused_before_the_scenes_own_motion_is_simulated(monkeypatch):
    monkeypatch.setattr("clothfit.fit.estimate.simulate_cloths", lambda *_, **__: pytest.fail("it was simulated"))
    with pytest.raises(InvalidInput, match=r"^memory: 100 kB is too little: the targets take "):
        estimate(load(trial("nG", 200, 12, 12)), memory="100kB")
