"""What a terminal and a file show of a fit while it runs."""

import io
import math
from dataclasses import replace

import pytest
from rich.console import Console

from clothfit.cli.common.progress import BARS, CURVE_WIDTH, Pace, Shown, duration, pace, plain, sparkline, stage, state
from clothfit.optimise.progress import Progress

pytestmark = pytest.mark.slow  # compiles a fit


def step(evaluations, **fields):
    told = {"iteration": 7, "step": 0.032, "stage": "gauss-newton", "window": 20, "frames": 100, "window_rmse": 1.2e-3}
    return Progress(evaluations, 1000, 0.5 / evaluations, 2.5e-3 / evaluations, 0.25 * evaluations, **(told | fields))


def screen(shown, width=100):
    """What a panel looks like on a terminal."""
    console = Console(file=io.StringIO(), record=True, force_terminal=True, width=width, color_system=None)
    console.print(shown.panel())
    return console.export_text()


def test_the_panel_tells_all_there_is_to_know():
    shown = Shown()
    for evaluations in range(1, 41):
        shown.update(step(evaluations))
    text = screen(shown)
    for fact in ("fitting", "cost 1.250e-02", "RMSE 62.5 µm", "evaluation 40 of at most 1000", "gauss-newton",
                 "20 of 100 frames", "RMSE there 1.2 mm", "step 3.2 %", "4 evaluations/s",
                 "2.5 mm → 62.5 µm"):  # fmt: skip
        assert fact in text
    assert any(bar in text for bar in BARS)


def test_before_the_first_evaluation_the_panel_says_so():
    assert "looking at target and start" in screen(Shown())


@pytest.mark.parametrize("width", [20, 76, 200])
def test_the_panel_has_lines_of_one_length_that_fit(width):
    shown = Shown(min(width, 76))
    shown.update(step(1)), shown.update(step(2))
    lengths = {len(line) for line in screen(shown, width).splitlines()}
    assert lengths == {min(width, 76)}


def test_a_plain_line_tells_the_same(monkeypatch):
    clock = iter([0.0, 1.0, 9.0, 10.5])
    said = []
    with monkeypatch.context() as patch:
        patch.setattr("time.perf_counter", lambda: next(clock))
        show = plain(said.append)
        show(step(10)), show(step(40)), show(step(50))
    assert said == [
        "  10.0 s  cost 1.250e-02  RMSE 62.5 µm  evaluation 40  gauss-newton  20 of 100 frames  RMSE there 1.2 mm  "
        "step 3.2 %  4 evaluations/s"
    ]


@pytest.mark.parametrize(("unit", "text"), [("m", "RMSE 12 mm "), ("m/s", "RMSE 12 mm/s "), ("", "RMSE 0.012 ")])
def test_an_error_has_the_unit_of_what_is_compared(unit, text):
    progress = Progress(3, 100, 1e-4, 0.012, 1.0, unit=unit)
    assert text in state(progress)


def test_nothing_is_told_that_is_not_known():
    assert stage(Progress(1, 10, 1.0, 1.0, 1.0)) == []
    assert pace(Progress(1, 10, 1.0, 1.0, 0.0), 0.0, None) == []
    assert pace(Progress(1, 10, 1.0, 1.0, 0.0), 2.0, None) == ["2 evaluations/s"]


def test_the_pace_is_that_of_the_last_seconds_and_no_time_is_left_after_the_budget():
    known = Pace()
    assert known.update(step(1, )) == 4.0  # as far as is known
    for second in range(1, 100):
        rate = known.update(Progress(100 * second, 5000, 1.0, 1.0, float(second)))
    assert rate == pytest.approx(100.0)
    for second in range(100, 120):
        rate = known.update(Progress(9900 + second, 5000, 1.0, 1.0, float(second)))
    assert rate == pytest.approx(1.0)
    assert pace(Progress(4997, 5000, 1.0, 1.0, 1.0), rate, 50.0)[1] == "roughly 5.0 s left"  # until the limit


def test_the_panel_shows_roughly_what_the_trend_leaves():
    shown = Shown()
    for k in range(1, 41):  # to 1 by a factor e in 2 s, for 10 s
        shown.update(replace(step(k, window=100), cost=1.0 + 1e3 * math.exp(-0.125 * k)))
    # the cost is 7.7; in the last third it fell by 27.5, 3600 times its thousandth: 2 s · ln 3600 = 16 s are left
    assert "roughly 20 s left" in screen(shown)


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.24, "0.2 s"), (12.4, "12 s"), (200, "3 min 20 s"), (7500, "2 h 5 min"), (59.9, "60 s")]
)
def test_durations_are_in_units_that_suit(seconds, text):
    assert duration(seconds) == text


def test_a_sparkline_falls_with_the_logarithm():
    assert sparkline([10.0**-k for k in range(8)]) == BARS[::-1]
    assert sparkline([1.0]) == BARS[0]
    assert len(sparkline([1.0 / k for k in range(1, 500)])) == CURVE_WIDTH
    assert sparkline([math.inf, 1.0, 0.0]) == BARS[-1] + BARS[0]
