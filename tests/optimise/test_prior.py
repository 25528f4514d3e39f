"""The belief about how values scatter: its penalty, the likeliest widths, the patterns of a fabric."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.strangers import sheet

from clothfit.optimise.evidence import Seen, inverse, most_likely, separate, variance
from clothfit.optimise.prior import FIRST_TAU, NARROWEST, WIDEST, first, none, patterns
from clothfit.scene.families import spring_groups


def linear(size, tau, noise, rows=None, seed=0):
    """A linear problem r = b − J y whose truth scatters by tau around a common value: H, g, cost at y, truth."""
    rng = np.random.default_rng(seed)
    rows = rows or 4 * size
    truth = 0.7 + tau * rng.normal(size=size)
    J = rng.normal(size=(rows, size))
    b = J @ truth + noise * rng.normal(size=rows)

    def model(y):
        r = J @ y - b
        return J.T @ J, J.T @ r, y, float(r @ r), rows

    return model, truth


def converged(prior, model, y):
    """Gauss–Newton with the prior of a linear problem, until nothing changes."""
    for _ in range(30):
        learned, sigma2 = prior.learned(*model(y))
        prior = prior.between(learned)
        H, g, *_ = model(y)
        A = prior.matrix(sigma2)
        y = y - np.linalg.solve(H + A, g + A @ (y - prior.centre))
    return prior, sigma2, y


@pytest.mark.parametrize("noise", [0.01, 1.0])
@pytest.mark.parametrize("tau", [0.02, 0.1, 0.5])
def test_the_width_is_learned_from_the_data(tau, noise):
    size = 150
    model, truth = linear(size, tau, noise)
    prior = first(np.zeros(size), [np.arange(size)], None)
    assert prior.tau == (FIRST_TAU,)
    prior, sigma2, y = converged(prior, model, np.zeros(size))
    # A scatter of 150 values is known to 1 / sqrt(300) = 6 %; where noise hides half of them, to twice that; 3 sigma.
    assert prior.tau[0] == pytest.approx(np.std(truth), rel=0.4)
    assert sigma2 == pytest.approx(noise**2, rel=0.25)  # of 600 − 150 residuals: sqrt(2 / 450) = 7 %; 3 sigma
    assert np.std(y - truth) < 1.1 * noise / np.sqrt(3 * size)  # what least squares alone leaves: noise / sqrt(rows)


def test_a_common_factor_is_free_where_the_width_is_learned():
    prior = first(np.zeros(5), [np.arange(1, 5)], None)
    assert prior.value(np.full(5, 3.0), 1.0) < 1e-28  # rounding
    np.testing.assert_allclose(prior.matrix(2.0) @ np.ones(5), 0.0, atol=1e-14)  # rounding


def test_a_given_width_is_kept_and_holds_the_mean_as_well():
    model, _ = linear(20, 0.5, 0.1)
    prior = first(np.zeros(20), [np.arange(20)], 0.25)
    learned, sigma2 = prior.learned(*model(np.zeros(20)))
    assert learned.tau == (0.25,)
    assert sigma2 > 0
    assert prior.value(np.full(20, 3.0), 1.0) == pytest.approx(20 * 9 / 0.25**2, rel=1e-14)
    np.testing.assert_allclose(prior.matrix(2.0), 2.0 / 0.25**2 * np.eye(20), rtol=1e-15)


@pytest.mark.parametrize("tau", [None, 0.2])
def test_the_penalty_is_that_of_its_matrix(tau):
    rng = np.random.default_rng(1)
    prior = first(rng.normal(size=9), [np.array([0, 4, 5]), np.array([2, 7])], tau)
    y = rng.normal(size=9)
    A = prior.matrix(1.7)
    np.testing.assert_array_equal(A, A.T)
    away = y - prior.centre
    assert prior.value(y, 1.7) == pytest.approx(away @ A @ away, rel=1e-13)  # rounding
    assert np.flatnonzero(A.any(axis=0)).tolist() == [0, 2, 4, 5, 7]


def test_no_belief_adds_nothing():
    model, truth = linear(6, 0.1, 0.01)
    for prior in (none(6), first(np.zeros(6), [], None), first(np.zeros(6), [np.arange(6)], np.inf)):
        H, g, y, cost, count = model(np.zeros(6))
        learned, sigma2 = prior.learned(H, g, y, cost, count)
        assert learned.tau == prior.tau
        assert not prior.matrix(1.0).any()
        assert prior.value(truth, 1.0) == 0.0
        least = cost - g @ np.linalg.solve(H, g)
        assert sigma2 == pytest.approx(least / (count - 6), rel=1e-9)  # the unbiased estimate


def test_a_single_value_has_no_scatter_to_learn():
    groups = [np.array([3]), np.array([0, 1])]
    assert [group.tolist() for group in first(np.zeros(4), groups, None).groups] == [[0, 1]]
    assert [group.tolist() for group in first(np.zeros(4), groups, 0.1).groups] == [[3], [0, 1]]


def test_widths_stay_within_their_limits():
    for tau, end in ((0.0, NARROWEST), (50.0, WIDEST)):
        model, _ = linear(60, tau, 1e-4)
        prior, *_ = converged(first(np.zeros(60), [np.arange(60)], None), model, np.zeros(60))
        assert prior.tau[0] == pytest.approx(end, rel=1e-4)  # 30 steps of half the way


def test_the_inverse_of_a_matrix_that_is_not_definite_is_finite():
    full = np.array([[4.0, 1.0], [1.0, 3.0]])
    np.testing.assert_allclose(inverse(full) @ full, np.eye(2), atol=1e-12)  # the ridge, 1e-14 of a condition of 2
    assert np.isfinite(inverse(np.diag([1.0, 0.0]))).all()
    np.testing.assert_allclose(inverse(np.diag([1.0, -1.0])), np.diag([1.0, -1.0]), atol=1e-12)


def test_the_variance_never_divides_by_nothing():
    assert variance(6.0, 5, 2.0) == 2.0
    assert variance(6.0, 2, 5.0) == 6.0
    assert variance(-1e-20, 5, 2.0) == 0.0  # rounding of a difference


@pytest.mark.parametrize("matrix", [np.zeros((0, 0)), np.full((3, 3), np.nan), np.diag([1.0, np.inf])], ids=str)
def test_nothing_is_printed_about_matrices_that_have_no_inverse(capfd, matrix):
    assert np.isnan(inverse(matrix)).all()
    size = len(matrix)
    prior = first(np.zeros(size), [np.arange(size)], None)
    learned, _ = prior.learned(matrix, np.zeros(size), np.zeros(size), 1.0, 10)
    assert learned.tau == prior.tau
    assert capfd.readouterr() == ("", "")


def patterned(learns):
    """A prior of two groups, of which one has patterns where they are learned, and a coordinate beside them."""
    rng = np.random.default_rng(4)
    groups = [np.array([0, 2, 4, 6, 8]), np.array([1, 3, 5])]
    shapes = [(rng.normal(size=(5, 2)), rng.normal(size=(5, 1))), ()]
    prior = first(rng.normal(size=10), groups, None if learns else 0.4, shapes)
    return replace(prior, tau=(0.5, 0.8, 0.3, 0.2)) if learns else prior


@pytest.mark.parametrize("learns", [True, False])
def test_products_with_its_matrix_need_no_matrix(learns):
    prior, z = patterned(learns), np.random.default_rng(5).normal(size=10)
    np.testing.assert_allclose(prior.times(z), prior.matrix(1.0) @ z, atol=1e-12)
    own = np.isin(np.arange(10), np.concatenate(prior.groups))
    assert ((prior.believed > 0) == own).all()


@pytest.mark.parametrize("learns", [True, False])
def test_draws_scatter_as_it_says(learns):
    prior, rng, count = patterned(learns), np.random.default_rng(6), 20_000
    draws = np.stack([prior.drawn(rng) for _ in range(count)], axis=1)
    A = prior.matrix(1.0)
    found = A @ (draws @ draws.T / count) @ A  # A Σ A = A where Σ is its inverse but for what is free
    # entries of a sample covariance are good to sqrt(2 / 20,000) = 1 % of their size; five of these
    np.testing.assert_allclose(found, A, atol=0.05 * np.abs(A).max())


def test_widths_follow_from_samples_as_from_the_whole_posterior():
    prior, rng, sigma2 = patterned(True), np.random.default_rng(7), 0.01
    J = rng.normal(size=(12, 10))
    H, y = J.T @ J, prior.centre + rng.normal(size=10)
    covariance = sigma2 * np.linalg.inv(H + prior.matrix(sigma2))
    scatter = rng.multivariate_normal(np.zeros(10), covariance, size=20_000)
    found = prior.rescaled(y - prior.centre, list(scatter), 1e-9, 1e9).tau
    # all effects at once: y − y₀ = E u + what is free, with their own precision
    effects, expected = [], []
    for group, widths, shapes in zip(prior.groups, prior.widths, [*prior.patterns], strict=True):
        for tau, B in zip(widths, (np.eye(len(group)), *shapes), strict=True):
            wide = np.zeros((10, B.shape[1]))
            wide[group] = B
            effects.append((wide, tau))
    free = np.zeros((10, 4))
    for i, group in enumerate(prior.groups):
        free[group, i] = 1.0
    free[7, 2], free[9, 3] = 1.0, 1.0
    E = np.concatenate([*(wide for wide, _ in effects), free], axis=1)
    precision = np.concatenate([*(np.full(wide.shape[1], tau**-2.0) for wide, tau in effects), np.zeros(4)])
    C = np.linalg.pinv(E.T @ H @ E / sigma2 + np.diag(precision))
    A = prior.matrix(1.0)
    start = 0
    for wide, tau in effects:
        own, size = np.diag(C)[start : start + wide.shape[1]], tau**2 * wide.T @ A @ (y - prior.centre)
        expected.append(np.linalg.norm(size) / np.sqrt(max(wide.shape[1] - own.sum() / tau**2, 1.0)))
        start += wide.shape[1]
    # |u|² of samples is good to sqrt(2 / 20,000) = 1 % of n at most, and γ, 1 or more, is n less it, n up to 5
    assert len(found) == len(expected) == 5 - 1
    for mine, theirs in zip(found, expected, strict=True):
        assert mine == pytest.approx(theirs, rel=0.05)


# --- the patterns of a fabric: families, smooth maps, their size


NOISE = 1e-3


def of_sheet(chosen=None):
    """The patterns of the springs of a sheet, some of them."""
    scene = sheet(letters="nL")
    (block,) = scene.blocks
    own = np.arange(block.count) if chosen is None else chosen
    return scene.cloths[0], patterns(scene.cloths[0], block, own)


def test_patterns_are_of_one_size():
    cloth, found = of_sheet()
    assert len(found) >= 5  # families, and bands of maps of all and of each
    for B in found:
        assert len(B) == len(cloth.springs)
        assert (B**2).sum() == pytest.approx(len(B), rel=1e-12)


def test_families_are_a_pattern():
    cloth, (member, *_) = of_sheet()
    groups = spring_groups(cloth)
    assert member.shape[1] == len(groups.names)
    assert all(np.unique(member[groups.of == i], axis=0).shape[0] == 1 for i in range(len(groups.names)))


def test_some_springs_have_the_patterns_of_all():
    own = np.arange(0, 40, 2)
    cloth, found = of_sheet(own)
    assert all(len(B) == len(own) for B in found)
    assert np.linalg.matrix_rank(found[0]) == len(np.unique(spring_groups(cloth).of[own]))


def learned(truth, found, seed=0):
    """The prior and the error of the values that it finds, and those without patterns, from noisy data that show a
    quarter of all directions well and half of them not at all.
    """
    rng, size = np.random.default_rng(seed), len(truth)
    turn = np.linalg.qr(rng.normal(size=(size, size)))[0]
    rows = 5 * size
    J = rng.normal(size=(rows, size)) / np.sqrt(rows) @ (turn * np.geomspace(1.0, 1e-4, size)) @ turn.T
    r = -J @ truth - NOISE * rng.normal(size=rows)
    results = []
    for own in (found, ()):
        prior, y = first(np.zeros(size), [np.arange(size)], None, [own] if own else ()), np.zeros(size)
        for _ in range(3):
            now = r + J @ y
            prior, sigma2 = prior.learned_fully(J.T @ J, J.T @ now, y, float(now @ now), rows)
            A = prior.matrix(sigma2)
            y = y - np.linalg.solve(J.T @ J + A, J.T @ now + A @ y)
        results.append((prior, float(np.sqrt(np.mean((y - truth) ** 2)))))
    return results


def test_values_of_families_are_found_from_fewer_data_than_there_are_values():
    cloth, found = of_sheet()
    level = np.array([1.0, -0.5, 0.2, -1.2, 0.6, 0.1, -0.3, 0.8, 0.0])[spring_groups(cloth).of]
    (prior, with_patterns), (_, without) = learned(level, found)
    # the few levels are known as well as the noise allows; most of the single values are not shown at all
    assert with_patterns < 3 * NOISE < 0.2 < without
    assert prior.widths[0][0] < 0.01 < 0.3 < prior.widths[0][1]


# --- the widths that make data most likely, against the likelihood itself; and the factorisation that finds the data


DEVIATION = 0.05


def problem(widths, seed=0, size=60, rows=90):
    """Data of values that scatter along two patterns and each by itself: J, their residuals at 0, patterns, truth."""
    rng = np.random.default_rng(seed)
    patterns = [np.eye(size), rng.normal(size=(size, 20)), rng.normal(size=(size, 15))]
    truth = 0.4 + sum(t * B @ rng.normal(size=B.shape[1]) for t, B in zip(widths, patterns, strict=True))
    J = rng.normal(size=(rows, size))
    return J, -J @ truth - DEVIATION * rng.normal(size=rows), patterns, truth


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
    assert sigma2 == pytest.approx(DEVIATION**2, rel=0.8)  # of some 30 residuals: sqrt(2 / 30) = 26 %; 3 sigma


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
