"""Gauss–Newton in a trust region on problems whose minimum is known."""

from dataclasses import replace

import numpy as np
import pytest

from clothfit.optimise.gauss_newton import (
    LEFT,
    SMALL_GAIN,
    SMALLEST,
    Model,
    Patience,
    Problem,
    Quadratic,
    descend,
    minimise,
    quadratic,
)
from clothfit.optimise.prior import first, none

pytestmark = pytest.mark.slow  # compiles a fit

WIDE = np.full(2, 1e3)


class Synthetic:
    """Residuals r(y) with derivative J(y), and every point that is asked for."""

    def __init__(self, residual, jacobian, lower=-WIDE, upper=WIDE, diverges=lambda y: False):
        self.residual, self.jacobian = residual, jacobian
        self.lower, self.upper, self.diverges = lower, upper, diverges
        self.models, self.trials = [], []

    def model(self, y):
        self.models.append(y)
        r, J = self.residual(y), self.jacobian(y)
        return Model(y, float(r @ r), J.T @ J, J.T @ r)

    def cost(self, y):
        self.trials.append(y)
        if self.diverges(y):
            return np.inf
        return float((self.residual(y) ** 2).sum())

    @property
    def problem(self):
        count = len(self.residual(np.zeros(len(self.lower))))
        return Problem(self.model, self.cost, self.lower, self.upper, count)


def rosenbrock(**options):
    """Zero at (1, 1), at the end of a bent valley."""
    return Synthetic(
        lambda y: np.array([10 * (y[1] - y[0] ** 2), 1 - y[0]]),
        lambda y: np.array([[-20 * y[0], 10.0], [-1.0, 0.0]]),
        **options,
    )


def decay(noise=0.0, **options):
    """Two rates of a sum of exponentials, seen at 40 times: residuals remain where there is noise."""
    t = np.linspace(0, 3, 40)
    truth = np.array([0.2, -0.4])
    goal = sum(np.exp(-np.exp(k) * t) for k in truth) + noise * np.random.default_rng(3).normal(size=40)
    made = Synthetic(
        lambda y: sum(np.exp(-np.exp(np.minimum(k, 50.0)) * t) for k in y) - goal,
        lambda y: np.stack([-np.exp(k) * t * np.exp(-np.exp(k) * t) for k in y], axis=1),
        **options,
    )
    return made, truth


def run(made, y, prior=None, **options):
    return minimise(made.problem, np.array(y, float), prior or none(len(y)), **options)


@pytest.mark.parametrize(
    ("made", "start", "end"),
    [*((rosenbrock(), start, [1.0, 1.0]) for start in ((-1.2, 1.0), (5.0, -5.0), (0.0, 0.0))),
     *((decay()[0], start, decay()[1]) for start in ((3.0, -3.0), (-4.0, 2.5)))],
)  # fmt: skip
def test_a_bent_valley_is_followed_to_its_end_and_rates_are_found_from_far_away(made, start, end):
    model, _, status = run(made, start)
    assert status == "converged"
    # It ends when the rest would save a hundredth of the variance of a residual, here a share of what is left itself:
    # close to the minimum, where each step squares the error.
    np.testing.assert_allclose(np.sort(model.y), np.sort(end), atol=1e-6)
    assert len(made.models) < 40


def test_with_noise_it_ends_within_a_tenth_of_a_standard_error():
    made, _ = decay(0.01)
    model, _, status = run(made, [1.5, -1.0])
    assert status == "converged"
    step = -np.linalg.solve(model.H, model.g)
    sigma2 = model.cost / (40 - 2)
    assert step @ model.H @ step <= LEFT * sigma2 * (1 + 1e-6)


@pytest.mark.parametrize(("lower", "upper"), [((-2.0, -2.0), (0.5, 2.0)), ((1.3, -2.0), (2.0, 3.0))])
def test_a_minimum_at_a_bound_is_found(lower, upper):
    made = rosenbrock(lower=np.array(lower), upper=np.array(upper))
    model, _, status = run(made, np.clip((-1.2, 1.8), lower, upper))
    assert status == "converged"
    low, high = model.y <= made.lower, model.y >= made.upper
    assert (low | high).sum() == 1
    assert np.abs(model.g[~low & ~high]).max() < 1e-3  # against slopes of 10 … 100
    assert (model.g[low] >= 0).all()
    assert (model.g[high] <= 0).all()
    for y in (*made.models, *made.trials):
        assert ((y >= made.lower) & (y <= made.upper)).all()


def test_where_the_simulation_diverges_it_steps_back():
    made, truth = decay(diverges=lambda y: y.max() > 1.6)
    model, _, status = run(made, [1.5, -3.0])
    assert status == "converged"
    assert any(made.diverges(y) for y in made.trials)
    np.testing.assert_allclose(np.sort(model.y), np.sort(truth), atol=1e-6)  # as above


def test_a_point_that_nothing_improves_is_a_stall():
    # The derivative says down, the cost says up, everywhere: a wrong model.
    made = Synthetic(lambda y: 1.0 + np.abs(y), lambda y: np.eye(2), lower=-WIDE, upper=WIDE)
    model, _, status = run(made, [0.0, 0.0])
    assert status == "stalled"
    assert (model.y == 0.0).all()


def test_the_iterations_are_a_limit():
    made = rosenbrock()
    model, _, status = run(made, (-1.2, 1.0), iterations=2)
    assert status == "limit"
    assert len(made.models) == 3
    np.testing.assert_array_equal(model.y, made.models[-1])


def test_a_tight_prior_holds_the_start():
    made, truth = decay(0.01)
    start = np.array([0.5, -0.1])
    model, prior, _ = run(made, start, first(start, [np.arange(2)], 1e-4))
    assert prior.tau == (1e-4,)
    assert np.abs(model.y - start).max() < 1e-3 < np.abs(truth - start).min()


def test_nothing_to_fit_is_converged():
    made = Synthetic(lambda y: np.ones(3), lambda y: np.zeros((3, 0)), np.zeros(0), np.zeros(0))
    model, _, status = run(made, [])
    assert (status, model.cost) == ("converged", 3.0)


# --- one descent


def bowl(y=(0.0, 0.0), H=((2.0, 0.0), (0.0, 2.0)), g=(-2.0, 0.0), bound=10.0):
    H, g, y = np.array(H), np.array(g), np.array(y)
    return Quadratic(y, H, g, np.full(2, -bound), np.full(2, bound))


@pytest.mark.parametrize(("kept", "first"), [(1.0, 0.3), (0.1, 0.5)])
def test_a_right_model_is_followed_beyond_the_radius_and_one_that_promises_too_much_shrinks_it(kept, first):
    model = bowl()
    step, radius, good = descend(lambda y: kept * float(2 * model.g @ y + y @ model.H @ y), 0.0, model, first)
    assert good
    if kept == 1.0:
        assert min(np.linalg.norm(step), radius) > first
    else:
        assert np.linalg.norm(step) <= first * 1.01
        assert radius == first / 2


def test_without_descent_the_radius_ends_and_nothing_moves():
    step, radius, good = descend(lambda y: 1.0 + float(y @ y), 1.0, bowl(), 1.0)
    assert not good
    assert not step.any()
    assert radius <= SMALLEST * np.sqrt(2)


# --- a trust region that is as wide along each coordinate as the residuals are flat


def in_units(made, units):
    """The same problem in coordinates y units."""
    units = np.array(units)
    return Synthetic(
        lambda y: made.residual(y / units), lambda y: made.jacobian(y / units) / units,
        lower=units * made.lower, upper=units * made.upper,
    )  # fmt: skip


def test_the_points_of_a_scaled_trust_region_are_the_same_in_other_units():
    made, _ = decay(0.01)
    found = []
    for units in ((1.0, 1.0), (1e-2, 1e-4)):
        part, units = in_units(made, units), np.array(units)
        problem = replace(part.problem, widths=2.0 * units)
        model, _, status = minimise(problem, units * (1.5, -1.0), none(2))
        assert status == "converged"
        found.append(np.array([*part.trials, model.y]) / units)
    np.testing.assert_allclose(*found, rtol=1e-6)  # rounding, of steps that are divided by differences


def test_a_scaled_step_changes_neither_residuals_nor_coordinates_by_more_than_the_radius_says():
    made = rosenbrock()
    y = np.array([-1.2, 1.0])
    model, problem = made.model(y), replace(made.problem, widths=np.array([0.5, 2.0]))
    near = quadratic(problem, model, none(2), 1.0)
    for radius in (1e-3, 0.1):
        step = near.within(radius)
        assert near.length(step) == pytest.approx(radius, rel=0.02)  # within a percent, by its own account
        assert np.linalg.norm(made.jacobian(y) * step / np.sqrt(model.cost)) <= 1.02 * radius
        assert np.linalg.norm(step / problem.widths) <= 1.02 * radius
    assert quadratic(made.problem, model, none(2), 1.0).scale is None
    nothing = made.model(np.ones(2))  # is left that a change could be relative to
    assert quadratic(problem, nothing, none(2), 1.0).scale is None


def test_a_coordinate_that_no_residual_shows_is_not_moved_far():
    made = Synthetic(lambda y: np.array([y[0] - 1.0, 1e-9 * y[1] - 1.0]), lambda y: np.diag([1.0, 1e-9]))
    model, _, _ = minimise(replace(made.problem, widths=np.full(2, 0.3)), np.zeros(2), none(2), iterations=1)
    assert abs(model.y[1]) <= 2.0 * 0.3 * 1.01  # the radius is 1, and may have doubled


# --- where the residuals stay large


def misfit(left=100.0):
    """A problem whose residuals stay large, with a slow way to its minimum: Gauss–Newton leaves out their curvature."""
    return Synthetic(
        lambda y: np.array([y[0] - 1.0, left + 0.45 * (y[0] - 1.0) ** 2 / left, y[1]]),
        lambda y: np.array([[1.0, 0.0], [0.9 * (y[0] - 1.0) / left, 0.0], [0.0, 1.0]]),
    )


def many(made):
    """The problem, one of very many residuals, so that their noise would let it go on."""
    return replace(made.problem, residuals=10**9)


def test_two_steps_that_would_save_next_to_nothing_are_the_end():
    made = misfit()
    found, _, status = minimise(many(made), np.array([3.0, 1.0]), none(2))
    assert status == "converged"
    # each step would save (1.9 d)² of 1e4, 1.9 d² are left, with d the distance to the minimum: less than half of it
    assert 1e4 < found.cost < 1e4 * (1 + SMALL_GAIN)
    assert len(made.models) > 4  # a problem without such residuals takes two


@pytest.mark.parametrize(("flat", "status"), [(0.5, "converged"), (1e-9, "stalled")])
def test_patience_that_ends_tells_whether_the_last_step_was_worth_it(flat, status):
    valley = rosenbrock()
    short = replace(valley.problem, patience=Patience(2, 0.999, flat))
    assert minimise(short, np.array([-1.2, 1.0]), none(2))[2] == status


@pytest.mark.parametrize("is_noise", [True, False])
def test_the_width_of_the_prior_is_held_where_residuals_are_no_noise(is_noise):
    made, _ = decay(0.1)
    start = np.array([0.5, -0.9])
    belief = first(start, [np.arange(2)], None)
    problem = replace(made.problem, is_noise=lambda y: is_noise)
    _, prior, status = minimise(problem, start, belief)
    assert status == "converged"
    assert (prior.tau == belief.tau) == (not is_noise)


def among(noise):
    """The valley, beside residuals that nothing changes."""
    bent = rosenbrock()
    return Synthetic(
        lambda y: np.concatenate([bent.residual(y), noise]),
        lambda y: np.concatenate([bent.jacobian(y), np.zeros((len(noise), 2))]),
    )


@pytest.mark.parametrize(
    ("noisy", "is_noise", "ends"), [(True, True, True), (True, False, False), (False, True, False)]
)
def test_a_step_within_the_noise_of_each_combination_ends_it_where_residuals_are_noise(noisy, is_noise, ends):
    noise = np.random.default_rng(0).normal(size=400 if noisy else 0)
    begin = np.array([0.8, 0.64])  # 0.2 from the end of the valley: 0.04 of the cost is left, for 2 values
    problem = replace(among(noise).problem, is_noise=lambda y: is_noise)
    model, _, status = minimise(problem, begin, none(2))
    assert status == "converged"
    assert np.array_equal(model.y, begin) == ends
    assert ends or abs(model.y[0] - 1.0) < 0.1  # where less than 0.01 is left


def test_a_problem_that_asks_for_little_ends_where_its_last_model_says_that_no_more_is_left():
    """The residuals are linear: what one model foretells is so, and a second one is not asked for."""
    rng = np.random.default_rng(5)
    J, b = rng.normal(size=(30, 2)), rng.normal(size=30)
    made = Synthetic(lambda y: J @ y - b, lambda y: J)
    wide = 1e3  # the radius
    models = []
    for least in (0.0, 1e-3):
        made.models.clear()
        problem = replace(made.problem, least=least)
        found, _, status = minimise(problem, np.array([3.0, -4.0]), none(2), radius=wide)
        models.append(len(made.models))
        assert status == "converged"
        best = np.linalg.lstsq(J, b, rcond=None)[0]
        np.testing.assert_allclose(found.y, best, rtol=1e-9)
        assert found.cost == pytest.approx(np.sum((J @ best - b) ** 2), rel=1e-9)
    assert models == [2, 1]
