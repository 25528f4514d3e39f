"""The `clothfit` command, also as `python -m clothfit`.

This file is what starts first, so it imports next to nothing: Ctrl-C while the rest is loading ends the program as
quietly as later on.
"""

from __future__ import annotations

# what `signal` wraps: while that makes its enumerations, Ctrl-C would end with a traceback
import _signal as signal  # type: ignore[import-not-found]
import atexit
import os

TYPE_CHECKING = False  # what `typing` calls so is true for type checkers only, but takes 10 ms to import
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import NoReturn

INTERRUPTED = 130  # the exit code


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit."""
    for kind in (signal.SIGINT, signal.SIGTERM):
        signal.signal(kind, _leave)
    interrupted: list[int] = []
    atexit.register(lambda: interrupted and os._exit(interrupted[0]))  # the first that is registered runs last
    from clothfit.cli import program

    try:
        program.main(arguments)
    except SystemExit as end:
        if end.code == INTERRUPTED:  # after Ctrl-C in a class that is made from text, Python would kill itself
            interrupted.append(INTERRUPTED)
        raise


def _leave(number: int, frame: object) -> None:
    """End at once, while there is nothing yet to clean up."""
    try:
        os.write(2, b"error: interrupted\n")
    finally:
        os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
