"""Foreign files: their bytes, and every failure as one sentence that names the file."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager

from clothfit.base import memory
from clothfit.base.errors import InvalidMotion
from clothfit.base.memory import human
from clothfit.base.messages import unreadable
from clothfit.base.reading import MOST_TEXT, unchanged, whole


def name_of(path: str | os.PathLike[str]) -> str:
    """The name of a file in messages."""
    return os.path.basename(os.fspath(path)) or os.fspath(path)


def sequence_in(path: str | os.PathLike[str]) -> str:
    """What to name in the place of a folder: the files of a sequence in it, if there are any."""
    folder = os.fspath(path)
    for name in sorted(os.listdir(folder)):
        if found := re.fullmatch(r"(.*?)\d+(\.\w+)", name):
            return f"name the files in it: '{os.path.join(folder, f'{found[1]}*{found[2]}')}'"
    return "name a motion file (.npz, .usd, .abc, .pc2 …)"


@contextmanager
def refused(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn an error of the system within the block into an InvalidMotion."""
    try:
        yield
    except InvalidMotion:
        raise
    except IsADirectoryError:
        raise InvalidMotion(f"{name_of(path)}: is a folder; {sequence_in(path)}") from None
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        raise InvalidMotion(f"{name_of(path)}: {unreadable(error)}") from None


def content(path: str | os.PathLike[str], most: int | None = MOST_TEXT) -> bytes:
    """The bytes of a file of at most `most` bytes (None: what fits into memory). Raises InvalidMotion."""
    with refused(path), unchanged(path) as file:
        data: bytes = whole(file, most)
        return data


def check_room(needed: int, path: str | os.PathLike[str]) -> None:
    """Raise InvalidMotion where the content of a file needs more bytes of memory than are free."""
    if (free := memory.missing(needed)) is not None:
        name = name_of(path)
        raise InvalidMotion(f"{name}: takes {human(needed)} of memory, {human(free)} are free; keep fewer frames")
