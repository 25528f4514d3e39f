"""Costs of one's own: their gradients by Taylor ladders, and that they are what the built-in ones are."""

import re

import numpy as np
import pytest
from helpers.derivatives import assert_right
from helpers.fits import estimate
from helpers.paths import ROOT
from helpers.physics import TIGHT, scene
from helpers.scenes import cloth, document, even

from clothfit import InvalidInput, Residuals, as_motion, load, parameters, simulate, with_parameters
from clothfit.engine import tape
from clothfit.motion.times import interpolated
from clothfit.objective.memory_needs import snapshot_bytes, state_bytes
from clothfit.objective.objective import Objective

pytestmark = pytest.mark.slow

FRAMES = 12


def sheet(nx, ny, settings):
    return cloth(nx, ny, vertMass=[0.05 + 0.005 * i for i in range(nx * ny)], optimizationSettings=settings)


SCENES = {
    "one object": [sheet(3, 3, "LL")],
    "one of two is fitted": [sheet(3, 3, "LL"), sheet(3, 2, "nn")],
    "the second of two is fitted": [sheet(3, 2, "nn"), sheet(3, 3, "GL")],
    "several": [sheet(2, 3, "GL"), sheet(3, 2, "nn"), sheet(2, 2, "LG")],
}


def made(kind, **fields):
    return scene(*SCENES[kind], optimizationIterations=FRAMES, delta=0.02, **fields)


def mixed(motion):
    """A cost that joins all vertices of all objects and all frames: of a weighted sum u and the squared speeds v,
    c = u² + v² + eᵘ."""
    x = motion.positions
    weights = np.random.default_rng(3).normal(size=x.shape) / np.sqrt(x.size)
    u, steps = float((weights * x).sum()), np.diff(x, axis=0)
    v = float((steps**2).sum())
    by_v = np.zeros_like(x)
    by_v[1:] += 2.0 * steps
    by_v[:-1] -= 2.0 * steps
    return u**2 + v**2 + np.exp(u), (2.0 * u + np.exp(u)) * weights + 2.0 * v * by_v


def squares(goal):
    """The squared distances from positions (F, N, 3), as a cost of one's own."""
    return lambda motion: (((motion.positions - goal) ** 2).sum(), 2.0 * (motion.positions - goal))


@pytest.mark.parametrize("method", [1, 2, 3])
@pytest.mark.parametrize("kind", SCENES)
def test_the_gradient_is_the_derivative(kind, method):
    own = made(kind, integrationMethod=method, windVel={"x": 3.0, "y": 0.0, "z": 1.0})
    assert_right(Objective(own, None, objective=mixed), parameters(own))


@pytest.mark.parametrize("kind", ["one object", "several"])
def test_so_it_is_where_frames_lie_between_steps(kind):
    own = made(kind)
    times = np.linspace(0.0, 0.2, 8)  # 0.2 s are 10 steps, in sevenths
    goal = as_motion(own, np.zeros((8, sum(own.vertex_counts), 3)), times)
    seen = []

    def watched(motion):
        seen.append(motion)
        return mixed(motion)

    assert_right(Objective(own, goal, objective=watched), parameters(own))
    np.testing.assert_array_equal(seen[0].times, times)


def test_so_it_is_where_states_are_computed_again():
    own = load(even("nL", 60, 8, 8))
    whole = Objective(own, None, objective=mixed)
    (run,) = whole.runs
    least = tape.least_bytes(run.steps, state_bytes(run.system), snapshot_bytes(run.system))
    tight = Objective(own, None, objective=mixed, memory=whole.needs.held + least)
    assert tight.needs.snapshots is not None
    p = 1.1 * parameters(own)
    np.testing.assert_array_equal(tight.cost_and_gradient(p)[1], whole.cost_and_gradient(p)[1])


@pytest.mark.parametrize("kind", SCENES)
def test_squared_distances_of_ones_own_are_those_of_the_program(kind):
    own = made(kind)
    goal = simulate(with_parameters(own, 1.2 * parameters(own)))
    p = parameters(own)
    cost, gradient = Objective(own, goal, TIGHT, objective=squares(goal.positions)).cost_and_gradient(p)
    expected, by_p = Objective(own, goal, TIGHT).cost_and_gradient(p)
    # an object that is not fitted adds its own squares, which no value changes, and is 0 as its motion is the scene's
    assert cost == pytest.approx(expected, rel=1e-9)
    np.testing.assert_allclose(gradient, by_p, rtol=1e-9, atol=1e-12 * np.abs(by_p).max())


def test_the_function_sees_the_motion_of_all_objects():
    own = made("the second of two is fitted")
    seen = []

    def watched(motion):
        seen.append(motion.positions.copy())
        motion.positions[:] = 0.0  # it may do with it what it likes
        return 0.0, np.zeros_like(seen[-1])

    p = 1.3 * parameters(own)
    objective = Objective(own, None, TIGHT, objective=watched)
    objective.cost(p)
    objective.cost(p)
    motion = simulate(with_parameters(own, p), tolerance=TIGHT).positions
    # the object that is not fitted is solved to the scene's tolerance
    np.testing.assert_allclose(seen[0], motion, atol=10 * own.tolerance)
    np.testing.assert_array_equal(seen[-1], seen[0])


def test_costs_of_several_targets_add_up():
    own = made("several")
    goal = simulate(own)
    p = 1.2 * parameters(own)
    one, two = (Objective(own, goals, objective=mixed) for goals in (goal, [goal, goal]))
    assert two.cost(p) == pytest.approx(2.0 * one.cost(p), rel=1e-12)
    np.testing.assert_allclose(two.cost_and_gradient(p)[1], 2.0 * one.cost_and_gradient(p)[1], rtol=1e-12)


def distances(goal):
    """The distances from positions (F, N, 3) of every second vertex, as residuals with a sparse derivative."""
    from scipy.sparse import eye_array

    chosen = np.arange(goal.size).reshape(goal.shape)[:, ::2].ravel()
    pick = eye_array(goal.size, format="csr")[chosen]
    return Residuals(lambda motion: (pick @ (motion.positions - goal).ravel(), pick))


@pytest.mark.parametrize("kind", ["one object", "one of two is fitted", "the second of two is fitted"])
def test_residuals_of_ones_own_are_least_squares(kind):
    own = made(kind)
    goal = simulate(with_parameters(own, 1.2 * parameters(own)))
    residuals = distances(goal.positions)
    assert_right(Objective(own, None, objective=residuals), parameters(own))
    run = Objective(own, goal, objective=residuals).runs[0]
    cloth = SCENES[kind][run.cloth]
    s = interpolated(goal.of(run.cloth), run.comparison.goal.step, run.comparison.goal.fraction)
    s = s + 0.01 * np.random.default_rng(0).normal(size=s.shape)
    r, J = run.comparison.residual_of(s), run.comparison.jacobian_of(s)
    assert J.shape == (len(r), 3 * len(cloth["vertMass"]) * FRAMES)
    np.testing.assert_allclose(2.0 * (J.T @ r), run.comparison.derivative_of(s).ravel(), rtol=1e-12, atol=1e-15)


def height(motion):
    """How far the middle of the last frame is from 0.25 m below the start, squared."""
    last, derivative = motion.positions[-1, :, 1], np.zeros_like(motion.positions)
    gap = last.mean() + 0.25
    derivative[-1, :, 1] = 2.0 * gap / len(last)
    return gap**2, derivative


@pytest.mark.parametrize("method", ["auto", "l-bfgs-b", "nelder-mead"])
def test_a_fit_without_a_target_reaches_what_the_cost_asks_for(method):
    own = load(even("nG", 15, 4, 4))
    fit = estimate(own, objective=height, method=method)
    assert fit.status == "converged"
    assert fit.method == ("l-bfgs-b" if method == "auto" else method)
    assert fit.cost < 1e-12  # a micrometre; the start is 11 mm off
    assert simulate(fit.scene, tolerance=1e-10).positions[-1, :, 1].mean() == pytest.approx(-0.25, abs=2e-6)
    assert np.isnan(fit.rmse)  # there is no target from which it could be
    assert (fit.verdict, fit.hints, fit.rank) == (None, [], None)
    assert "cost" in repr(fit)


def test_gauss_newton_fits_residuals_of_ones_own():
    own = load(even("nL", 20, 4, 4))
    p = parameters(own)
    truth = p * np.exp(0.2 * np.random.default_rng(5).normal(size=p.shape))
    goal = simulate(with_parameters(own, truth), tolerance=1e-10)
    fit = estimate(own, goal, objective=distances(goal.positions))
    assert (fit.method, fit.status) == ("gauss-newton", "converged")
    assert fit.rmse < 1e-7  # of all vertices, though every second was compared
    shown = [value for value in range(len(p)) if value not in fit.parameters[0].unidentifiable]
    assert parameters(fit.scene)[shown] == pytest.approx(truth[shown], rel=1e-4)
    assert fit.parameters[0].interval[shown[0]] is not None


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"method": "momentum"}, "momentum needs an objective of this program"),
        ({"method": "gauss-newton"}, "gauss-newton needs Residuals of one object"),
        ({"holdout": 0.2}, "holdout: does not go with a cost of one's own"),
        *[(option, "{}: does not go".format(*option)) for option in ({"fit_time": True}, {"loss": "huber"})],
        *[({name: "auto"}, f"{name} auto: does not go") for name in ("model", "substeps")],
        *[({"objective": function}, text) for function, text in (
            (lambda motion: 1.0, r"must return a cost and its derivative \(5, 9, 3\); it returned neither"),
            (lambda motion: (1.0, np.zeros((9, 3))), r"the derivative has the shape \(9, 3\)"),
            (lambda motion: (-1.0, np.zeros((5, 9, 3))), "it returned -1; add a constant"),
            (lambda motion: ("much", np.zeros((5, 9, 3))), "it returned neither"),
            (Residuals(lambda motion: 1.0), r"residuals \(R,\) and their derivative \(R, 3 F N\); it returned neither"),
            (Residuals(lambda motion: (np.zeros(2), np.zeros((2, 9)))), r"they have the shapes \(2,\) and \(2, 9\)"))],
    ],
)  # fmt: skip
def test_what_does_not_go_with_it_and_what_it_must_not_return_is_refused(options, text):
    with pytest.raises(InvalidInput, match=text):
        estimate(load(even("nG", 5, 3, 3)), **{"objective": height, **options})


def test_an_error_of_the_function_is_the_users_to_see():
    with pytest.raises(IndexError):
        estimate(load(even("nG", 5, 3, 3)), objective=lambda motion: (motion.positions[99], None))


def test_a_fit_goes_on_from_its_checkpoint_by_the_name_of_the_function(tmp_path):
    own = load(document(cloth(4, 4, optimizationSettings="nL"), optimizationIterations=15))
    file = tmp_path / "c"
    first = estimate(own, objective=height, max_evaluations=2, rmse=0.0, checkpoint=file)
    again = estimate(own, objective=height, max_evaluations=9, rmse=0.0, checkpoint=file, resume=True)
    assert again.evaluations > first.evaluations
    assert again.cost <= first.cost
    with pytest.raises(InvalidInput, match="objective"):
        estimate(own, objective=mixed, checkpoint=file, resume=True)


def test_the_cost_of_the_documents_is_fitted(monkeypatch):
    text = (ROOT / "docs" / "from-python.md").read_text("utf-8")
    _, block = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    monkeypatch.chdir(ROOT)
    names = {}
    exec(block, names)
    fit = names["fit"]
    assert fit.status == "converged"
    assert simulate(fit.scene).positions[-1, :, 1].mean() == pytest.approx(-3.0, abs=2e-3)  # `rmse` of a millimetre
