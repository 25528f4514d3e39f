"""The errors, as types: each carries one sentence for the user and the exit code of the commands.

Exit codes: 1 a fault of the program, 2 usage, 3 invalid input, 4 diverged, 5 not converged, 130 interrupted. A fit that
does not converge is a result with a status, not an exception.
"""

from __future__ import annotations

from typing import ClassVar


class ClothfitError(Exception):
    """Base of all errors that a user can act on. `exit_code` is the exit code of a command that ends with it."""

    exit_code = 1


class InvalidInput(ClothfitError, ValueError):
    """A scene, a motion, an argument or an output path that cannot be used; also a ValueError. Exit code 3."""

    exit_code = 3


class InvalidScene(InvalidInput):
    """A scene that breaks the format. Exit code 3.

    `problems` lists all problems, each as "place: what is wrong and what would be right". The message is the first of
    them, with the number of the others.
    """

    def __init__(self, problems: str | list[str], name: str = "") -> None:
        self.problems = [problems] if isinstance(problems, str) else list(problems)
        self.name = name
        more = len(self.problems) - 1
        tail = f" (and {more} more problem{'s' if more > 1 else ''})" if more else ""
        head = f"{name}: " if name else ""
        super().__init__(f"{head}{self.problems[0]}{tail}")


class InvalidMotion(InvalidInput):
    """A motion, as a file or an array, that does not fit its format or the scene. Exit code 3."""


class NotCompiled(Exception):
    """Raised by compiled code that calls code which cannot be compiled, or not now; `reasons` ends with why."""

    reasons: ClassVar[list[BaseException]] = []
