"""What a degraded motion keeps, loses and gets."""

import numpy as np
import pytest
from helpers.scenes import cloth, document, even

from clothfit.base.errors import InvalidInput
from clothfit.base.limits import check_capture
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.scene.scene import load

MOTION = simulate(load(even("nn", 21, 6, 6)))


def test_without_wishes_nothing_changes():
    same = degrade(MOTION)
    np.testing.assert_array_equal(same.positions, MOTION.positions)
    np.testing.assert_array_equal(same.times, MOTION.times)
    assert same.observed is None


def test_the_original_stays():
    before = MOTION.positions.copy()
    changed = degrade(MOTION, 0.1, 0.5, 2)
    changed.times[:] = 0.0
    np.testing.assert_array_equal(MOTION.positions, before)
    assert MOTION.times[-1] > 0


def test_noise_has_its_spread_in_every_coordinate_and_no_bias():
    noise = degrade(MOTION, 0.01, seed=3).positions - MOTION.positions
    count = noise[..., 0].size  # 756 of each coordinate
    # Four standard errors: sigma / sqrt(2 N) for the spread, sigma / sqrt(N) for the mean.
    np.testing.assert_allclose(noise.std(axis=(0, 1)), 0.01, rtol=4 / np.sqrt(2 * count))
    assert np.abs(noise.mean(axis=(0, 1))).max() < 4 * 0.01 / np.sqrt(count)


@pytest.mark.parametrize("every", [1, 2, 3, 7, 20, 100])
def test_every_kth_frame_is_kept_with_its_time(every):
    thinned = degrade(MOTION, every=every)
    np.testing.assert_array_equal(thinned.positions, MOTION.positions[::every])
    np.testing.assert_array_equal(thinned.times, MOTION.times[::every])


@pytest.mark.parametrize("fraction", [0.25, 0.5, 0.99, 1e-9])
def test_a_fraction_of_the_vertices_is_seen_the_same_in_all_frames(fraction):
    half = degrade(MOTION, observed=fraction)
    assert half.observed.shape == (21, 36)
    assert (half.observed == half.observed[0]).all()
    assert half.observed[0].sum() == max(1, round(fraction * 36))
    np.testing.assert_array_equal(np.isnan(half.positions).all(axis=2), ~half.observed)
    np.testing.assert_array_equal(half.positions[half.observed], MOTION.positions[half.observed])


def test_of_every_object_at_least_one_vertex_is_seen():
    motion = simulate(load(document(cloth(4, 4), cloth(2, 2), cloth(2, 2), optimizationIterations=3)))
    seen = degrade(motion, observed=0.25)
    assert [int(seen.seen(i)[0].sum()) for i in range(3)] == [4, 1, 1]


def test_a_seed_gives_the_same_again_and_another_another():
    first, again, other = (degrade(MOTION, 1e-3, 0.5, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.positions, again.positions)
    np.testing.assert_array_equal(first.observed, again.observed)
    assert (first.observed != other.observed).any()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((-1e-3, 1.0, 1), "noise must be at least 0 and finite; -0.001 m was given"),
        ((np.nan, 1.0, 1), "noise must be at least 0 and finite; nan m"),
        ((np.inf, 1.0, 1), "noise must be at least 0 and finite; inf m"),
        ((0.0, 0.0, 1), "observed must be a fraction above 0 and at most 1; 0 was given"),
        ((0.0, 1.5, 1), "observed must be a fraction above 0 and at most 1; 1.5"),
        ((0.0, np.nan, 1), "observed must be a fraction above 0 and at most 1; nan"),
        ((0.0, 1.0, 0), "every must be at least 1; 0 was given"),
        ((0.0, 1.0, 1, 0.0), "fps must be above 0 and finite; 0 was given"),
        ((0.0, 1.0, 1, np.nan), "fps must be above 0 and finite; nan"),
        ((0.0, 1.0, 2, 30.0), "fps: does not go with every"),
    ],
)
def test_values_out_of_range_are_refused(values, message):
    for refuse in (check_capture, lambda noise, seen, every, fps=None: degrade(MOTION, noise, seen, every, fps=fps)):
        with pytest.raises(InvalidInput, match=message):
            refuse(*values)


@pytest.mark.parametrize("fps", [10, 30, 50, 72.5, 240])
def test_a_frame_rate_gives_the_lines_between_the_frames(fps):
    found = degrade(MOTION, fps=fps)
    assert len(found.times) == int(0.4 * fps + 1e-9) + 1  # of 0.4 s
    np.testing.assert_allclose(np.diff(found.times), 1 / fps, rtol=1e-12)  # rounding of times
    lines = [np.interp(found.times, MOTION.times, x) for x in MOTION.positions.reshape(21, -1).T]
    np.testing.assert_allclose(found.positions.reshape(len(found.times), -1), np.transpose(lines), atol=1e-14)


def test_between_frames_is_seen_what_was_seen_before_and_after():
    seen, weights = np.ones((21, 36), bool), np.full((21, 36), 2.0)
    seen[4, 7], weights[6, 9], weights[8, 3] = False, 0.0, 4.0
    whole = Motion(MOTION.positions, MOTION.times, MOTION.vertex_counts, seen, weights=weights)
    found = degrade(whole, fps=100.0)  # two frames a step
    assert np.flatnonzero(~found.observed[:, 7]).tolist() == [7, 8, 9]
    assert np.flatnonzero(found.weights[:, 9] == 0).tolist() == [11, 12, 13]
    np.testing.assert_allclose(found.weights[14:19, 3], [2, 3, 4, 3, 2], rtol=1e-12)  # rounding of times
    np.testing.assert_array_equal(degrade(whole, every=2).weights, weights[::2])


def test_more_frames_than_memory_are_refused():
    with pytest.raises(InvalidInput, match="take"):
        degrade(MOTION, fps=1e14)


def test_a_mask_loses_the_frames_that_are_skipped():
    twice = degrade(degrade(MOTION, observed=0.5), every=2)
    assert twice.observed.shape == (11, 36)


def test_what_was_not_seen_before_is_not_seen_after():
    twice = degrade(degrade(MOTION, observed=0.5), observed=0.5, seed=9)
    assert not np.isnan(twice.positions[twice.observed]).any()
