"""`--end-with-input`: a command that ends when its standard input does.

A program that starts this one has one way to end it that is the same on all systems: it keeps the input open and closes
it. Windows has no Ctrl-C for a process without a window; and where the other program itself ends, so does this one.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from typing import Any

import click

from clothfit.base import interrupts
from clothfit.cli.common.output import STREAM

OPTION = "--end-with-input"
INPUT = 0
"""The descriptor of standard input."""

SOME = 4096
"""Bytes that are read, and ignored, at a time."""


def option(function: Callable[..., int | None]) -> Callable[..., int | None]:
    """Add --end-with-input to a command that keeps its best result when it is interrupted."""

    @wraps(function)
    def run(end_with_input: bool, **arguments: Any) -> int | None:
        if end_with_input:
            if STREAM in arguments["scene_paths"]:
                raise click.UsageError(f"{OPTION} watches standard input, which cannot be the scene as well")
            threading.Thread(target=wait, name=OPTION, daemon=True).start()
        return function(**arguments)

    text = "End as with Ctrl-C when standard input is closed: for programs that start this one."
    return click.option(OPTION, is_flag=True, help=text)(run)


def wait() -> None:
    """Read standard input to its end, then ask the main thread to end."""
    with suppress(OSError):
        while os.read(INPUT, SOME):
            pass
    interrupts.ask()
