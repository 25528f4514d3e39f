"""The trend of a fit: the time left of a cost that falls geometrically, and silence where it cannot be told."""

import numpy as np
import pytest

from clothfit.optimise.progress import ENOUGH, Progress, Trend


def said(cost, seconds, stage="gauss-newton", window=100):
    trend, found = Trend(), None
    for t in np.arange(0.0, seconds, 0.25):
        found = trend.update(Progress(1, 1000, cost(t), 1.0, t, stage=stage, window=window, frames=100))
    return found


@pytest.mark.parametrize("rate", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("floor", [1.0, 30.0])
def test_the_time_left_of_a_geometric_fall_is_exact(rate, floor):
    now, height = 11.75, floor * 20.0
    span = now / 3.0

    def cost(t):
        return floor + height * np.exp(-rate * t)

    # the fall in the span that ends at t is ENOUGH of the cost
    fall = height * np.exp(-rate * now) * (np.exp(rate * span) - 1.0)
    expected = max(np.log(fall / (ENOUGH * cost(now))) / rate, 0.0)
    # interpolated between reports a quarter of a second apart
    assert said(cost, now + 0.25) == pytest.approx(expected, abs=0.1)


def test_nothing_is_said_of_what_does_not_slow_down():
    assert said(lambda t: 10.0 - 0.1 * t, 12.0) is None
    assert said(lambda t: 1.0, 12.0) is None


def test_nothing_is_said_before_all_frames_are_compared_or_soon_after():
    def cost(t):
        return 1.0 + np.exp(-0.3 * t)

    assert said(cost, 12.0, window=50) is None
    assert said(cost, 2.0) is None


def test_nothing_is_said_far_beyond_what_was_seen():
    assert said(lambda t: 1.0 + 1e9 * np.exp(-0.1 * t), 6.0) is None
