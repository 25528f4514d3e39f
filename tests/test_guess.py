"""First guesses: exact for motions that are parabolas, and never out of memory."""

import numpy as np
import pytest

from clothfit.guess import advance, past

TIMES = range(8)


def guesses(solutions):
    """What is guessed before each of a series of solutions (n, 3)."""
    memory, x, made = past(len(solutions[0])), np.full_like(solutions[0], 7.0), []
    for count, solution in enumerate(solutions):
        advance(memory, count, x)
        made.append(x.copy())
        x[:] = solution
    return made


def polynomial(degree, seed=0):
    """Solutions (5, 3) at TIMES that are polynomials of whole numbers in time: sums are exact."""
    coefficients = np.random.default_rng(seed).integers(-9, 10, size=(degree + 1, 5, 3)).astype(float)
    return [sum(c * float(t) ** k for k, c in enumerate(coefficients)) for t in TIMES]


@pytest.mark.parametrize(("degree", "known"), [(0, 1), (1, 2), (2, 3)])
def test_a_polynomial_is_continued_exactly_once_it_is_known(degree, known):
    series = polynomial(degree)
    made = guesses(series)
    for t in range(known, len(series)):
        np.testing.assert_array_equal(made[t], series[t])  # whole numbers: no rounding


def test_the_first_guesses_are_zero_the_last_solution_and_a_line():
    series = polynomial(3)
    made = guesses(series)
    assert (made[0] == 0).all()
    np.testing.assert_array_equal(made[1], series[0])
    np.testing.assert_array_equal(made[2], 2 * series[1] - series[0])


def test_the_error_is_of_third_order():
    def error(h):
        series = [np.full((1, 3), np.sin(h * t)) for t in range(12)]
        return abs(guesses(series)[-1] - series[-1]).max() / abs(np.cos(h * 9.5))

    # Of h³ sin'''; 0.1: the next order, at h = 0.01 and half of it.
    assert np.log2(error(0.01) / error(0.005)) == pytest.approx(3.0, abs=0.1)


def test_a_guess_of_other_solutions_is_not_influenced():
    one, two = polynomial(2, seed=1), polynomial(2, seed=2)
    first = guesses(one)
    guesses(two)
    for a, b in zip(guesses(one), first, strict=True):
        np.testing.assert_array_equal(a, b)
