"""The end of a window where contacts switch: points around it lead on."""

from types import SimpleNamespace

import numpy as np
import pytest

from clothfit.optimise.gauss_newton import Model
from clothfit.strategy import first_windows

SLOPES, STEP = np.array([1.0, 10.0]), 0.5
"""Of the residuals, and the edge of a step of the cost."""


class Barred:
    """The cost |S (y - 1)|², 1 higher up to an edge of the first coordinate: at (0.4, 1) no small step pays."""

    own_widths, search = np.full(2, 100.0), SimpleNamespace(is_late=False)
    bounds = np.full(2, -5.0), np.full(2, 5.0)

    def __init__(self, still=100.0):
        self.objective, self.asked = SimpleNamespace(still=still), []

    def cost(self, y):
        self.asked.append(y)
        return float(((SLOPES * (y - 1.0)) ** 2).sum() + (y[0] < STEP))

    def model(self, y):
        return Model(y, self.cost(y), np.diag(SLOPES**2), SLOPES**2 * (y - 1.0))


@pytest.fixture
def barred(monkeypatch):
    """Steps that end at the minimum beyond the edge, but not before it."""
    monkeypatch.setattr(first_windows, "some_steps", lambda part, y, most: np.ones(2) if y[0] >= STEP else y)
    return Barred


def test_a_point_around_leads_beyond_the_step(barred):
    part = barred()
    np.testing.assert_array_equal(first_windows.beyond_switches(part, np.array([0.4, 1.0]), 4), np.ones(2))


def test_the_points_are_where_a_smooth_cost_is_higher_by_the_same(barred):
    part, y = barred(), np.array([-2.0, 1.0])  # all points cost more, or lie as far from the edge
    part.own_widths = np.full(2, 1e9)
    model = part.model(y)
    first_windows.beyond_switches(part, y, 4)
    around = np.array([each - y for each in part.asked[3 : 3 + 12]])
    rises = (around @ model.H * around).sum(axis=1) / model.cost
    inside = (np.abs(y + around) < 5.0).all(axis=1)
    np.testing.assert_allclose(np.sqrt(rises[inside]), np.repeat(first_windows.RADII, 4)[inside], rtol=1e-12)
    assert inside.sum() >= 8


def test_near_the_target_nothing_is_polled(barred):
    part, y = barred(still=1e12), np.array([0.4, 1.0])
    assert first_windows.beyond_switches(part, y, 4) is y
    assert len(part.asked) == 1
