"""The widths that make data most likely: against the likelihood itself, and the factorisation that finds the data."""

import numpy as np
import pytest

from clothfit.optimise.evidence import Seen, most_likely, separate

NOISE = 0.05


def problem(widths, seed=0, size=60, rows=90):
    """Data of values that scatter along two patterns and each by itself: J, their residuals at 0, patterns, truth."""
    rng = np.random.default_rng(seed)
    patterns = [np.eye(size), rng.normal(size=(size, 20)), rng.normal(size=(size, 15))]
    truth = 0.4 + sum(t * B @ rng.normal(size=B.shape[1]) for t, B in zip(widths, patterns, strict=True))
    J = rng.normal(size=(rows, size))
    return J, -J @ truth - NOISE * rng.normal(size=rows), patterns, truth


def likelihood(J, r, patterns, tau, sigma2):
    """The logarithm of the restricted likelihood of all residuals, from their covariance as it is."""
    S = sigma2 * np.eye(len(r)) + sum(t**2 * (J @ B) @ (J @ B).T for t, B in zip(tau, patterns, strict=True))
    x = J @ np.ones((J.shape[1], 1))
    inverse = np.linalg.inv(S)
    P = inverse - inverse @ x @ np.linalg.inv(x.T @ inverse @ x) @ x.T @ inverse
    return -0.5 * (np.linalg.slogdet(S)[1] + np.linalg.slogdet(x.T @ inverse @ x)[1] + r @ P @ r)


def test_a_model_as_data_is_the_model():
    J, r, *_ = problem((0.3, 0.1, 0.2))
    seen = Seen.of(J.T @ J, J.T @ r, float(r @ r), len(r), 3.0)
    np.testing.assert_allclose(seen.L @ seen.L.T, J.T @ J, atol=1e-10 * np.abs(J.T @ J).max())  # rounding
    np.testing.assert_allclose(seen.L @ -seen.data, J.T @ r, atol=1e-9 * np.abs(J.T @ r).max())
    way = np.linalg.lstsq(J, -r, rcond=None)[0]
    np.testing.assert_allclose(seen.L.T @ way, seen.data, atol=1e-9 * np.abs(seen.data).max())
    assert seen.rest == pytest.approx(np.sum((r + J @ way) ** 2), rel=1e-8)


def test_what_the_data_hardly_show_is_left_out():
    J, r, *_ = problem((0.3, 0.1, 0.2))
    J[:, :10] *= 1e-6
    seen = Seen.of(J.T @ J, J.T @ r, float(r @ r), len(r), 3.0)
    assert seen.L.shape == (60, 50)
    assert Seen.of(np.zeros((4, 4)), np.zeros(4), 1.0, 8, 3.0) is None


@pytest.mark.parametrize("widths", [(0.3, 0.1, 0.2), (0.02, 0.4, 0.0), (0.2, 0.0, 0.0)])
def test_the_widths_are_the_most_likely_ones(widths):
    J, r, patterns, _ = problem(widths)
    seen = Seen.of(J.T @ J, J.T @ r, float(r @ r), len(r), 3.0)
    effects, free = [seen.L.T @ B for B in patterns], seen.L.T @ np.ones((60, 1))
    ends, doubts = (np.full(3, 1e-4), 3.0), np.zeros(3)
    tau, sigma2 = most_likely(seen, effects, free, len(r), np.full(3, 0.3), 0.01, ends, doubts, 500)
    best = likelihood(J, r, patterns, tau, sigma2)
    for i in range(3):
        for factor in (0.8, 1.25):  # far beyond the 2 % of a round that ends the search
            other = tau.copy()
            other[i] *= factor
            assert likelihood(J, r, patterns, other, sigma2) < best + 1e-3  # of a width that vanishes nothing depends
    assert sigma2 == pytest.approx(NOISE**2, rel=0.8)  # of some 30 residuals: sqrt(2 / 30) = 26 %; 3 sigma


def test_cloths_that_do_not_touch_are_learned_apart_as_together():
    """Two cloths with one noise, in any order of their values; a touch of rounding's size makes them one again."""
    (J, r, patterns, _), (K, s, others, _) = problem((0.3, 0.1, 0.2)), problem((0.2, 0.3, 0.05), seed=1, size=40)
    order = np.random.default_rng(2).permutation(100)
    H = np.block([[J.T @ J, zeros(60, 40)], [zeros(40, 60), K.T @ K]])[np.ix_(order, order)]
    g, cost = np.concatenate([J.T @ r, K.T @ s])[order], float(r @ r + s @ s)
    B = [np.vstack([each, zeros(40, each.shape[1])])[order] for each in patterns]
    B += [np.vstack([zeros(60, each.shape[1]), each])[order] for each in others]
    free = np.column_stack([np.arange(100) < 60, np.arange(100) >= 60])[order].astype(float)
    seen = Seen.of(H, g, cost, 180, 3.0)
    effects = [seen.L.T @ each for each in B]
    given = (180, np.full(6, 0.3), 0.01, (np.full(6, 1e-4), 3.0), np.zeros(6), 12)
    assert len(separate(seen.data, effects, seen.L.T @ free)) == 2
    apart = most_likely(seen, effects, seen.L.T @ free, *given)
    touching = [each + 1e-14 for each in effects]
    assert len(separate(seen.data, touching, seen.L.T @ free)) == 1
    together = most_likely(seen, touching, seen.L.T @ free, *given)
    np.testing.assert_allclose(apart[0], together[0], rtol=1e-7)  # rounding and the touch, in 12 rounds
    assert apart[1] == pytest.approx(together[1], rel=1e-7)


def zeros(*shape):
    """Nothing between two cloths."""
    return np.zeros(shape)
