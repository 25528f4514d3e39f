"""The `clothfit` command, also as `python -m clothfit`.

This file is what starts first, so it imports next to nothing: Ctrl-C while the rest is loading ends the program as
quietly as later on.
"""

from __future__ import annotations

import os
import signal

TYPE_CHECKING = False  # what `typing` calls so is true for type checkers only, but takes 10 ms to import
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import NoReturn


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


if __name__ == "__main__":
    main()
