"""First guesses: exact for motions that are polynomials, the last solution where solutions jump."""

import numpy as np
import pytest

from clothfit.engine.solve.guess import TERMS, next_guess, past

TIMES = range(12)


def guesses(solutions):
    """What is guessed before each of a series of solutions (n, 3)."""
    memory, x, made = past(len(solutions[0])), np.full_like(solutions[0], 7.0), []
    for count, solution in enumerate(solutions):
        next_guess(memory, count, x)
        made.append(x.copy())
        x[:] = solution
    return made


def polynomial(degree, seed=0):
    """Solutions (5, 3) at TIMES that are polynomials of whole numbers in time: sums are exact."""
    coefficients = np.random.default_rng(seed).integers(-9, 10, size=(degree + 1, 5, 3)).astype(float)
    return [sum(c * float(t) ** k for k, c in enumerate(coefficients)) for t in TIMES]


@pytest.mark.parametrize("degree", range(TERMS))
def test_a_polynomial_is_continued_exactly_once_it_is_known(degree):
    series = polynomial(degree)
    made = guesses(series)
    np.testing.assert_array_equal(made[degree + 1 :], series[degree + 1 :])  # whole numbers: no rounding
    # the first guesses are zero, the last solution, and a line
    assert (made[0] == 0).all()
    np.testing.assert_array_equal(made[1], series[0])
    np.testing.assert_array_equal(made[2], 2 * series[1] - series[0])


def test_a_smooth_series_is_guessed_by_all_differences():
    h = 0.3
    series = [np.full((1, 3), np.exp(h * t)) for t in TIMES]
    # the backward difference of order K of exp is (1 − exp(−h))ᴷ exp; rounding of 2ᴷ terms
    wrong = [(now - made)[0, 0] for made, now in zip(guesses(series), series, strict=True)][TERMS:]
    expected = [(1 - np.exp(-h)) ** TERMS * np.exp(h * t) for t in TIMES[TERMS:]]
    np.testing.assert_allclose(wrong, expected, rtol=1e-9)


def test_solutions_that_jump_are_guessed_by_the_last():
    rng = np.random.default_rng(3)
    series = [(-1.0) ** t * np.ones((5, 3)) + 0.01 * rng.normal(size=(5, 3)) for t in TIMES]
    made = guesses(series)
    for t in TIMES[3:]:  # two differences were compared by then
        np.testing.assert_array_equal(made[t], series[t - 1])


def test_noise_on_a_line_is_not_taken_for_curvature():
    rng = np.random.default_rng(4)
    series = [float(t) * np.ones((50, 3)) + 0.01 * rng.normal(size=(50, 3)) for t in TIMES]
    # the line through the last two adds less than three times the noise, a longer rule much more
    for t in TIMES[4:]:
        assert np.linalg.norm(guesses(series)[t] - series[t]) < 4 * np.linalg.norm(0.01 * np.ones((50, 3)))
