"""What a degraded motion keeps, loses and gets."""

from functools import cache

import numpy as np
import pytest
from helpers.scenes import cloth, document, even

from clothfit import InvalidInput, Motion, load, simulate
from clothfit.motion.degrade import degrade, rounding


@cache
def recorded():
    return simulate(load(even("nn", 21, 6, 6)))


def test_without_wishes_nothing_changes_and_the_original_stays():
    same, before = degrade(recorded()), recorded().positions.copy()
    np.testing.assert_array_equal(same.positions, before)
    np.testing.assert_array_equal(same.times, recorded().times)
    assert same.observed is None
    degrade(recorded(), 0.1, 0.5, 2).times[:] = 0.0
    np.testing.assert_array_equal(recorded().positions, before)
    assert recorded().times[-1] > 0


def test_noise_has_its_spread_in_every_coordinate_and_no_bias():
    noise = degrade(recorded(), 0.01, seed=3).positions - recorded().positions
    count = noise[..., 0].size  # 756 of each coordinate
    # Four standard errors: sigma / sqrt(2 N) for the spread, sigma / sqrt(N) for the mean.
    np.testing.assert_allclose(noise.std(axis=(0, 1)), 0.01, rtol=4 / np.sqrt(2 * count))
    assert np.abs(noise.mean(axis=(0, 1))).max() < 4 * 0.01 / np.sqrt(count)


@pytest.mark.parametrize("every", [1, 2, 3, 7, 20, 100])
def test_every_kth_frame_is_kept_with_its_time(every):
    thinned = degrade(recorded(), every=every)
    np.testing.assert_array_equal(thinned.positions, recorded().positions[::every])
    np.testing.assert_array_equal(thinned.times, recorded().times[::every])


@pytest.mark.parametrize("fraction", [0.25, 0.5, 0.99, 1e-9])
def test_a_fraction_of_the_vertices_is_seen_the_same_in_all_frames(fraction):
    half = degrade(recorded(), observed=fraction)
    assert half.observed.shape == (21, 36)
    assert (half.observed == half.observed[0]).all()
    assert half.observed[0].sum() == max(1, round(fraction * 36))
    np.testing.assert_array_equal(np.isnan(half.positions).all(axis=2), ~half.observed)
    np.testing.assert_array_equal(half.positions[half.observed], recorded().positions[half.observed])


def test_of_every_object_at_least_one_vertex_is_seen():
    motion = simulate(load(document(cloth(4, 4), cloth(2, 2), cloth(2, 2), optimizationIterations=3)))
    seen = degrade(motion, observed=0.25)
    assert [int(seen.seen(i)[0].sum()) for i in range(3)] == [4, 1, 1]


def test_a_seed_gives_the_same_again_and_another_another():
    first, again, other = (degrade(recorded(), 1e-3, 0.5, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.positions, again.positions)
    np.testing.assert_array_equal(first.observed, again.observed)
    assert (first.observed != other.observed).any()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((-1e-3, 1.0, 1), "noise must be at least 0 and finite; -0.001 m was given"),
        ((np.nan, 1.0, 1), "noise must be at least 0 and finite; nan m"),
        ((0.0, 0.0, 1), "observed must be a fraction above 0 and at most 1; 0 was given"),
        ((0.0, 1.5, 1), "observed must be a fraction above 0 and at most 1; 1.5"),
        ((0.0, np.nan, 1), "observed must be a fraction above 0 and at most 1; nan"),
        ((0.0, 1.0, 0), "every must be at least 1; 0 was given"),
        ((0.0, 1.0, 1, 0.0), "fps must be above 0 and finite; 0 was given"),
        ((0.0, 1.0, 1, np.nan), "fps must be above 0 and finite; nan"),
        ((0.0, 1.0, 2, 30.0), "fps: does not go with every"),
        ((0.0, 1.0, 1, 1e14), "take"),  # more frames than memory
    ],
)
def test_values_out_of_range_are_refused(values, message):
    noise, seen, every, *fps = values
    with pytest.raises(InvalidInput, match=message):
        degrade(recorded(), noise, seen, every, fps=fps[0] if fps else None)


@pytest.mark.parametrize("fps", [10, 30, 50, 72.5, 240])
def test_a_frame_rate_gives_the_lines_between_the_frames(fps):
    found = degrade(recorded(), fps=fps)
    assert len(found.times) == int(0.4 * fps + 1e-9) + 1  # of 0.4 s
    np.testing.assert_allclose(np.diff(found.times), 1 / fps, rtol=1e-12)  # rounding of times
    lines = [np.interp(found.times, recorded().times, x) for x in recorded().positions.reshape(21, -1).T]
    np.testing.assert_allclose(found.positions.reshape(len(found.times), -1), np.transpose(lines), atol=1e-14)


def test_between_frames_is_seen_what_was_seen_before_and_after():
    seen, weights = np.ones((21, 36), bool), np.full((21, 36), 2.0)
    seen[4, 7], weights[6, 9], weights[8, 3] = False, 0.0, 4.0
    whole = Motion(recorded().positions, recorded().times, recorded().vertex_counts, seen, weights=weights)
    found = degrade(whole, fps=100.0)  # two frames a step
    assert np.flatnonzero(~found.observed[:, 7]).tolist() == [7, 8, 9]
    assert np.flatnonzero(found.weights[:, 9] == 0).tolist() == [11, 12, 13]
    np.testing.assert_allclose(found.weights[14:19, 3], [2, 3, 4, 3, 2], rtol=1e-12)  # rounding of times
    np.testing.assert_array_equal(degrade(whole, every=2).weights, weights[::2])


# The rounding of a file's numbers is seen in the numbers, and only there.


FRAMES, VERTICES = 12, 30


def moving(size=1.0, seed=0):
    """Positions (12, 30, 3) of vertices that swing, but for the first, which is fixed."""
    generator = np.random.default_rng(seed)
    x = size * generator.uniform(-1.0, 1.0, (1, VERTICES, 3)) * np.ones((FRAMES, 1, 1))
    x[:, 1:] += 0.1 * size * generator.normal(size=(FRAMES, VERTICES - 1, 3))
    return x


def motion(x, observed=None, unit=1.0):
    """A motion of these positions."""
    return Motion(x, np.arange(float(len(x))), (x.shape[1],), observed, unit=unit)


def half(unit):
    """The root mean square distance of positions that are off by half a unit in each coordinate."""
    return 0.5 * np.sqrt(3.0) * unit


def of_text(x, form):
    """The numbers that a file holds which has them in this form."""
    return np.array([float(format(a, form)) for a in x.ravel()]).reshape(x.shape)


@pytest.mark.parametrize("decimals", range(1, 10))
def test_decimals_of_text(decimals):
    x = of_text(moving(), f".{decimals}f")
    assert rounding(motion(x)) == pytest.approx(half(10.0**-decimals), rel=1e-12)  # rounding of the formula itself


@pytest.mark.parametrize("digits", range(3, 10))
def test_significant_digits_of_text(digits):
    x = of_text(moving(0.099), f".{digits}g")
    places = np.array([f"{a:.{digits - 1}e}".split("e")[1] for a in x.ravel()], float)
    units = 10.0 ** (places + 1 - digits)
    assert rounding(motion(x)) == pytest.approx(half(np.sqrt((units**2).mean())), rel=1e-12)


@pytest.mark.parametrize("number", [np.float16, np.float32])
def test_floats_of_fewer_bits(number):
    x = moving().astype(number)
    units = np.spacing(np.abs(x)).astype(float)
    found = rounding(motion(x.astype(float)))
    assert found == pytest.approx(half(np.sqrt((units**2).mean())), rel=1e-12)
    error = np.sqrt(((x - moving()) ** 2).sum(axis=2).mean())
    assert 0.4 * found < error < found  # uniform between the halves: 1/√3 of it, about


@pytest.mark.parametrize("unit", [0.01, 0.0254, 100.0])
def test_the_unit_of_the_file_counts(unit):
    single = moving(1 / unit).astype(np.float32).astype(float)
    assert rounding(motion(single * unit, unit=unit)) == pytest.approx(unit * rounding(motion(single)), rel=1e-12)
    text = np.round(moving(1 / unit), 3)
    assert rounding(motion(text * unit, unit=unit)) == pytest.approx(half(1e-3 * unit), rel=1e-12)


def test_float64_and_what_does_not_move_or_is_not_observed_say_nothing():
    x, observed = moving(), np.ones((FRAMES, VERTICES), bool)
    x[:, 0] = 0.5  # round in every sense
    assert [rounding(motion(each)) for each in (moving(), x, np.zeros_like(x), x[:1])] == [0.0] * 4
    x[:, 1:] = np.round(x[:, 1:], 4)
    x[:, 0] = 1 / 3
    assert rounding(motion(x)) == pytest.approx(half(1e-4), rel=1e-12)
    observed[3:5, 2], observed[:, 7] = False, False
    x[~observed] = np.nan
    assert rounding(motion(x, observed)) == pytest.approx(half(1e-4), rel=1e-12)


def test_free_fall_by_round_steps_is_not_text():
    """Sums of round numbers are near multiples of a power of ten, but do not keep to them."""
    v = np.cumsum(np.tile(0.02 * np.array([0.1, -9.81, 0.3]), (40, 1)), axis=0)
    x = np.cumsum(0.02 * v, axis=0)
    assert rounding(motion(np.concatenate([np.zeros((1, 3)), x])[:, None])) == 0.0
