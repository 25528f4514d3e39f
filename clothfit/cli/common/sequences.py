"""Names of OBJ sequences that the shell has spelt out: `--target frames/a_*.obj` without quotes.

The shell puts the names of all files in the place of one with a `*`, so that a command is given a hundred arguments.
Where some in a row are exactly the files of one sequence, they become its name again.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from itertools import groupby

from clothfit.base.errors import InvalidInput

OBJ_SUFFIX = ".obj"
FEWEST = 3
"""Files in a row; two may be meant as two."""


def gathered(arguments: Sequence[str]) -> list[str]:
    """Arguments, with one name for each sequence."""
    made: list[str] = []
    for alike, group in groupby(arguments, lambda each: each.lower().endswith(OBJ_SUFFIX)):
        names = list(group)
        pattern = _pattern(names) if alike and len(names) >= FEWEST else None
        made += names if pattern is None else [pattern]
    return made


def _pattern(names: list[str]) -> str | None:
    """The name of the sequence that has just these files; None where there is none."""
    from clothfit.formats.obj import ANY, frames_of

    folder, name = os.path.split(names[0])
    for number in re.finditer("[0-9]+", name):
        pattern = os.path.join(folder, f"{name[: number.start()]}{ANY}{name[number.end() :]}")
        with suppress(InvalidInput):
            if sorted(frames_of(pattern)) == sorted(names):
                return pattern
    return None
