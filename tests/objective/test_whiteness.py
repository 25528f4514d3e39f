"""Tests of residuals: noise of every kind passes, what a wrong model leaves does not, whatever is missing."""

import numpy as np
import pytest

from clothfit.objective.whiteness import RARE, Bias, Series, biased, combined

PAIRS = np.array([(i, i + 1) for i in range(19)], np.int32)


def judged(gaps, seen=None, motion=None):
    """The test of residuals (F, n, 3) that are seen (F, n), of a motion that is smooth unless it is given."""
    seen = np.ones(gaps.shape[:2], bool) if seen is None else seen
    motion = np.ones(gaps.shape) if motion is None else motion
    series, changes = Series(gaps.shape[1], PAIRS), Series(gaps.shape[1], PAIRS[:0])
    for e, flags, change in zip(gaps, seen, motion, strict=True):
        series.add(np.where(flags[:, None], e, 0.0), flags)
        changes.add(change, np.ones(len(flags), bool))
    return combined([(series, changes)])


def drift(frames, n=20):
    """What a wrong model leaves: smooth in time and space."""
    t, s = np.linspace(0.0, 3.0, frames)[:, None, None], np.linspace(0.0, 2.0, n)[None, :, None]
    return np.sin(t + s + np.arange(3))


def noise(frames, seed, n=20):
    return np.random.default_rng(seed).standard_normal((frames, n, 3))


@pytest.mark.parametrize("frames", [6, 20, 50])
def test_white_noise_is_noise(frames):
    found = [judged(noise(frames, seed)) for seed in range(100)]
    # One in 2000 is not, by time and by space each.
    assert sum(not each.is_noise for each in found) <= 1
    assert np.std([each.z_time for each in found]) == pytest.approx(1.0, abs=0.25)  # of 100: three standard errors


def test_noise_that_all_vertices_share_or_that_grows_is_noise():
    shared = [np.repeat(noise(30, seed, n=1), 20, axis=1) for seed in range(60)]
    growing = [noise(30, seed) * np.linspace(0.0, 5.0, 30)[:, None, None] ** 2 for seed in range(60)]
    for each in (shared, growing):
        assert sum(not judged(gaps).is_noise for gaps in each) <= 1  # one in 2000 by chance


@pytest.mark.parametrize("frames", [4, 8, 20, 200])
def test_what_a_wrong_model_leaves_is_no_noise(frames):
    found = judged(drift(frames))
    assert not found.is_noise
    assert found.structured > 0.5


def test_structure_is_found_below_the_noise_and_its_share_is_right():
    found = [judged(0.5 * drift(200) + noise(200, seed)) for seed in range(10)]
    assert not any(each.is_noise for each in found)
    share = 0.25 * (drift(200) ** 2).mean() / (0.25 * (drift(200) ** 2).mean() + 1.0)
    # lag one of sin(t) loses 1e-4; of 12,000 numbers the share is good to 1 / sqrt(12,000) each
    assert np.mean([each.structured for each in found]) == pytest.approx(share, abs=0.01)


def test_what_is_not_seen_does_not_count():
    seen = np.random.default_rng(0).random((60, 20)) < 0.2
    hole = np.where(seen[..., None], drift(60), 1e6)
    assert not judged(hole, seen).is_noise
    alternating = np.arange(60)[:, None] % 2 == np.arange(20) % 2
    assert not judged(drift(60), alternating).is_noise
    assert judged(noise(60, 1), alternating).is_noise


def test_space_decides_where_frames_are_too_far_apart():
    jumps = noise(40, 3, n=1)
    apart = np.repeat(jumps, 20, axis=1)
    assert judged(apart).is_noise
    assert not judged(apart, motion=noise(40, 4)).is_noise  # frames that the motion forgets: space must do


def test_nothing_is_noise():
    assert judged(np.zeros((30, 20, 3))).is_noise
    assert judged(drift(30), np.zeros((30, 20), bool)).is_noise


def summed(gaps):
    """The share of a bias in residuals (F, n, 3), and its probability in noise."""
    bias = Bias(gaps.shape[1], len(gaps))
    for frame, values in enumerate(gaps):
        bias.add(frame, values)
    return biased([bias])


@pytest.mark.parametrize("alone", [True, False])
@pytest.mark.parametrize("frames", [12, 50, 200])
def test_noise_has_a_bias_as_rarely_as_is_said(frames, alone):
    # Two tests of RARE each: 4 of 400 expected, fewer than 12 but once in 1000 (Poisson); the same whether vertices
    # share their noise. The distribution is that of normal noise only nearly, so 16 are allowed.
    found = [summed(noise(frames, seed, 20) if alone else np.repeat(noise(frames, seed, 1), 20, axis=1))[1]
             for seed in range(400)]  # fmt: skip
    assert sum(chance < RARE for chance in found) <= 16


def test_a_constant_bias_of_a_fifth_of_the_noise_is_found_and_its_share_is_right():
    for seed in range(20):
        share, chance = summed(noise(100, seed, 100) + 0.2 * np.where(np.arange(100) % 2, 1, -1)[:, None])
        assert chance < 1e-6
        assert share == pytest.approx(0.04 / 1.04, abs=0.01)  # of 30,000 numbers, and 5 waves of 300 each


def test_a_slow_bias_is_found_where_the_frames_before_show_nothing():
    slow = 0.15 * np.cos(2 * np.pi * np.arange(200) / 200)[:, None, None]
    found = [(judged(noise(200, seed) + slow), summed(noise(200, seed) + slow)[1]) for seed in range(20)]
    assert sum(test.is_noise for test, _ in found) > 15
    assert sum(chance < RARE for _, chance in found) > 15
