"""What is said, how loudly, and on which stream."""

import io
import re
import sys

import numba
import pytest

from clothfit.base.messages import metres
from clothfit.cli.common.console import Console
from clothfit.cli.common.progress import progress
from clothfit.cli.program import run
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


def test_names_cannot_act_on_a_terminal(capsys):
    Console().say("shirt\x1b[2J\x9b\u202e: näch…\t1 µm\n→")
    assert capsys.readouterr().err == "shirt?[2J??: näch…\t1 µm\n→\n"


def test_names_in_errors_cannot_act_on_a_terminal(capsys):
    assert run(["info", "no\x1b]0;title\x07.json"]) == 3
    err = capsys.readouterr().err
    assert "no?]0;title?.json" in err
    assert "\x1b" not in err


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


def test_a_table_has_columns_and_no_trailing_blanks(capsys):
    Console().table([("name", "value", "unit"), ("a", "1", ""), ("longer name", "22", "m")])
    assert capsys.readouterr() == ("name         value  unit\na            1\nlonger name  22     m\n", "")


def test_a_result_goes_where_no_data_go(capsys):
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


@pytest.mark.parametrize(
    ("value", "text"),
    [(12.345, "12.3 m"), (1.0, "1 m"), (0.5, "500 mm"), (2.5e-6, "2.5 µm"), (4.19e-9, "4.19 nm"), (1e-12, "0.001 nm"),
     (0.0, "0 nm"), (float("inf"), "inf m")],
)
def test_lengths_have_a_unit_of_their_size(value, text):
    assert metres(value) == text


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


def test_an_interrupt_passes_through_the_bar_and_gives_the_cursor_back(monkeypatch):
    terminal = on_terminal(monkeypatch)
    bar = progress(Console())
    bar.__enter__()(step(1))
    assert not bar.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert "\x1b[?25h" in terminal.getvalue()


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
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
