"""The trend of a fit: the time left of a cost that falls geometrically, and silence where it cannot be told."""

import numpy as np
import pytest

from clothfit.optimise.progress import ENOUGH, Progress, Rounds, Trend


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


def test_the_progress_of_several_fits_goes_on_and_its_best_never_gets_worse():
    seen = []
    rounds = Rounds(seen.append)
    for costs in ([4.0, 1.0], [9.0, 0.25, 0.25]):
        for k, cost in enumerate(costs):
            rounds(Progress(k + 1, 100, cost, np.sqrt(cost), 0.5 * (k + 1), k))
        rounds.next()
    assert [(each.evaluations, each.budget, each.seconds, each.iteration) for each in seen] == [
        (1, 100, 0.5, 0), (2, 100, 1.0, 1), (3, 102, 1.5, 1), (4, 102, 2.0, 2), (5, 102, 2.5, 3),
    ]  # fmt: skip
    assert [each.cost for each in seen] == [4.0, 1.0, 1.0, 0.25, 0.25]
    assert [each.rmse for each in seen] == [2.0, 1.0, 1.0, 0.5, 0.5]
