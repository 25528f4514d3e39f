"""What is said, how loudly, on which stream; what a terminal and a file show of a fit while it runs."""

import io
import math
import re
import sys
from dataclasses import replace

import numba
import pytest
from rich.console import Console as Rich

from clothfit.base.messages import metres
from clothfit.cli.common import progress as shows
from clothfit.cli.common.console import Console
from clothfit.cli.common.progress import BARS, CURVE_WIDTH, Pace, PanelState, pace, progress, sparkline
from clothfit.optimise.progress import Progress

pytestmark = pytest.mark.slow  # compiles a fit


class Terminal(io.StringIO):
    """A standard error that says it is a terminal."""

    def isatty(self):
        return True


def on_terminal(monkeypatch):
    """Have standard error played by a terminal that wants colour; called in the test, as pytest sets its own before."""
    made = Terminal()
    monkeypatch.setattr(sys, "stderr", made)
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    return made


def step(evaluations):
    return Progress(evaluations, 100, 1.5e-3 / evaluations, 2.5e-6, 0.5)


def test_names_cannot_act_on_a_terminal(capsys, said):
    Console().say("shirt\x1b[2J\x9b\u202e: näch…\t1 µm\n→")
    assert capsys.readouterr().err == "shirt?[2J??: näch…\t1 µm\n→\n"
    code, _, err = said("info", ["no\x1b]0;title\x07.json"])
    assert (code, "no?]0;title?.json" in err, "\x1b" in err) == (3, True, False)


@pytest.mark.parametrize(
    ("quiet", "verbose", "expected"),
    [(False, False, "a\nwarning: b\n"), (True, False, ""), (False, True, r"a\nwarning: b\n\[ +\d+\.\d\d s\] c\n")],
)
def test_all_messages_go_to_standard_error(capsys, quiet, verbose, expected):
    speaker = Console(quiet, verbose)
    speaker.say("a"), speaker.warn("b"), speaker.detail("c")
    with progress(speaker) as show:
        assert (show is None) == quiet
    assert not speaker.animated
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(expected, err)


def test_a_table_has_columns_and_a_result_goes_where_no_data_go(capsys):
    Console().table([("name", "value", "unit"), ("a", "1", ""), ("longer name", "22", "m")])
    assert capsys.readouterr() == ("name         value  unit\na            1\nlonger name  22     m\n", "")
    Console().result("a"), Console(data=True).result("b"), Console(quiet=True).result("c")
    assert capsys.readouterr() == ("a\n", "b\n")


@pytest.mark.parametrize(
    ("encoding", "text"),
    [("utf-8", "±2 µm → näher …"), ("latin-1", "±2 µm -> näher ..."), ("ascii", "+-2 um -> n\\xe4her ...")],
)
def test_characters_that_a_terminal_does_not_know_are_spelled(monkeypatch, encoding, text):
    shown = io.TextIOWrapper(io.BytesIO(), encoding, errors="backslashreplace")
    monkeypatch.setattr(sys, "stderr", shown)
    Console().say("±2 µm → näher …")
    assert shown.buffer.getvalue().decode(encoding) == f"{text}\n"


def test_lengths_and_durations_are_in_units_that_suit():
    lengths = {12.345: "12.3 m", 1.0: "1 m", 0.5: "500 mm", 2.5e-6: "2.5 µm", 4.19e-9: "4.19 nm", 1e-12: "0.001 nm",
               0.0: "0 nm", math.inf: "inf m"}  # fmt: skip
    assert {value: metres(value) for value in lengths} == lengths
    times = {0.24: "0.2 s", 12.4: "12 s", 200: "3 min 20 s", 7500: "2 h 5 min", 59.9: "60 s"}
    assert {value: shows.duration(value) for value in times} == times


@pytest.mark.parametrize(("name", "value"), [("NO_COLOR", "1"), ("TERM", "dumb")])
def test_animation_is_for_terminals_that_want_it(monkeypatch, name, value):
    on_terminal(monkeypatch)
    assert Console().animated
    monkeypatch.setenv("NO_COLOR", "")  # empty counts as absent, says the convention
    assert Console().animated
    monkeypatch.setenv(name, value)
    assert not Console().animated


def test_a_terminal_has_a_bar_that_leaves_no_trace(monkeypatch, capsys):
    terminal = on_terminal(monkeypatch)
    with progress(Console()) as show:
        show(step(1)), show(step(40))
    shown = terminal.getvalue()
    assert "\x1b[" in shown
    assert "fitting" in shown
    assert "RMSE 2.5 µm  evaluation 40" in shown
    assert shown.endswith("\x1b[2K")  # the line of the bar is cleared
    assert capsys.readouterr().out == ""
    bar = progress(Console())
    bar.__enter__()(step(1))
    assert not bar.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert "\x1b[?25h" in terminal.getvalue().removeprefix(shown)  # the cursor is back after an interrupt


def test_the_first_compilation_is_announced_and_no_other():
    heard = []

    class Heard(Console):
        def say(self, message):
            heard.append(message)

    Heard().announce_compilation()
    for number in (1, 2):
        numba.njit(lambda x, number=number: x + number)(1)
    assert len(heard) == 1
    assert heard[0].startswith("compiling for this machine")


def far(evaluations, **fields):
    told = {"iteration": 7, "step": 0.032, "stage": "gauss-newton", "window": 20, "frames": 100, "window_rmse": 1.2e-3}
    return Progress(evaluations, 1000, 0.5 / evaluations, 2.5e-3 / evaluations, 0.25 * evaluations, **(told | fields))


def screen(shown, width=100):
    """What a panel looks like on a terminal."""
    console = Rich(file=io.StringIO(), record=True, force_terminal=True, width=width, color_system=None)
    console.print(shown.panel())
    return console.export_text()


def test_the_panel_tells_all_there_is_to_know():
    shown = PanelState()
    assert "looking at target and start" in screen(shown)
    for evaluations in range(1, 41):
        shown.update(far(evaluations))
    text = screen(shown)
    for fact in ("fitting", "cost 1.250e-02", "RMSE 62.5 µm", "evaluation 40 of at most 1000", "gauss-newton",
                 "20 of 100 frames", "RMSE there 1.2 mm", "step 3.2 %", "4 evaluations/s",
                 "2.5 mm → 62.5 µm"):  # fmt: skip
        assert fact in text
    assert any(bar in text for bar in BARS)


@pytest.mark.parametrize("width", [20, 76, 200])
def test_the_panel_has_lines_of_one_length_that_fit(width):
    shown = PanelState(min(width, 76))
    shown.update(far(1)), shown.update(far(2))
    lengths = {len(line) for line in screen(shown, width).splitlines()}
    assert lengths == {min(width, 76)}


def test_a_plain_line_tells_the_same(monkeypatch):
    clock = iter([0.0, 0.0, 1.0, 9.0, 10.5])
    said = []
    with monkeypatch.context() as patch:
        patch.setattr("time.perf_counter", lambda: next(clock))
        show = shows.plain(said.append)
        show(far(10)), show(far(40)), show(far(50))
    assert said == [
        "  10.0 s  cost 1.250e-02  RMSE 62.5 µm  evaluation 40  gauss-newton  20 of 100 frames  RMSE there 1.2 mm  "
        "step 3.2 %  4 evaluations/s"
    ]


def test_an_error_has_the_unit_of_what_is_compared_and_nothing_is_told_that_is_not_known():
    for unit, text in (("m", "RMSE 12 mm "), ("m/s", "RMSE 12 mm/s "), ("", "RMSE 0.012 ")):
        assert text in shows.state(Progress(3, 100, 1e-4, 0.012, 1.0, unit=unit))
    early = Progress(1, 10, 1.0, 1.0, 0.0)
    assert (shows.stage(early), pace(early, 0.0, None), pace(early, 2.0, None)) == ([], [], ["2 evaluations/s"])


def test_the_pace_is_that_of_the_last_seconds_and_no_time_is_left_after_the_budget():
    known = Pace()
    assert known.update(far(1, )) == 4.0  # as far as is known
    for second in range(1, 100):
        rate = known.update(Progress(100 * second, 5000, 1.0, 1.0, float(second)))
    assert rate == pytest.approx(100.0)
    for second in range(100, 120):
        rate = known.update(Progress(9900 + second, 5000, 1.0, 1.0, float(second)))
    assert rate == pytest.approx(1.0)
    assert pace(Progress(4997, 5000, 1.0, 1.0, 1.0), rate, 50.0)[1] == "roughly 5.0 s left"  # until the limit


def test_the_panel_shows_roughly_what_the_trend_leaves():
    shown = PanelState()
    for k in range(1, 41):  # to 1 by a factor e in 2 s, for 10 s
        shown.update(replace(far(k, window=100), cost=1.0 + 1e3 * math.exp(-0.125 * k)))
    # the cost is 7.7; in the last third it fell by 27.5, 3600 times its thousandth: 2 s · ln 3600 = 16 s are left
    assert "roughly 20 s left" in screen(shown)


def test_a_sparkline_falls_with_the_logarithm():
    assert sparkline([10.0**-k for k in range(8)]) == BARS[::-1]
    assert sparkline([1.0]) == BARS[0]
    assert len(sparkline([1.0 / k for k in range(1, 500)])) == CURVE_WIDTH
    assert sparkline([math.inf, 1.0, 0.0]) == BARS[-1] + BARS[0]
