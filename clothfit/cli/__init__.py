"""The `clothfit` command. Commands only parse, call, write and exit; the libraries load when a command runs.

This file is what starts first, so it imports next to nothing: Ctrl-C while the rest is loading ends the program as
quietly as later on. The names of `program` are loaded when they are first used.
"""

from __future__ import annotations

import os
import signal
from importlib import import_module

TYPE_CHECKING = False  # what `typing` calls so is true for type checkers only, but takes 10 ms to import
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any, NoReturn

    from clothfit.cli.program import COMMANDS, group, run

__all__ = ["COMMANDS", "group", "main", "run"]


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit."""
    for kind in (signal.SIGINT, signal.SIGTERM):
        signal.signal(kind, _leave)
    from clothfit.cli import program

    program.main(arguments)


def _leave(number: int, frame: object) -> None:
    """End at once, while there is nothing yet to clean up."""
    try:
        os.write(2, b"error: interrupted\n")
    finally:
        os._exit(130)


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'clothfit.cli' has no attribute {name!r}")
    return getattr(import_module("clothfit.cli.program"), name)
