"""Folders whose files may be run: nobody but the user, root and who was named as their owner can write there.

A path may lead to another folder a moment after it was checked. So a folder is opened once, without following links;
owner and mode are those of what was opened, and files are read and written through it. A folder that is absent holds
nothing.

Two levels are checked, the base (`~/.cache/clothfit`) and the folder in it:

- The base of the user and the folder in it belong to the user or to root, and nobody else can write to them. Where
  everybody can write to the folder around the base, that has the sticky bit, as /tmp has: others cannot rename in it.
- The base that the user names, and that of the package, are trusted with their owner and group. Everybody must not be
  able to write there, unless it has the sticky bit; the folder in it belongs to the user, to root or to the base's
  owner, and not everybody can write to it.
"""

from __future__ import annotations

import os
import secrets
import shutil
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

DESCRIPTORS = os.open in os.supports_dir_fd and hasattr(os, "getuid")
"""Whether the system opens files through folders; Windows does not, and its folders of the user are the user's own."""

FOLDER = getattr(os, "O_DIRECTORY", 0) | getattr(os, "O_CLOEXEC", 0)
NO_LINK = getattr(os, "O_NOFOLLOW", 0)


class Untrusted(PermissionError):
    """A folder that others can write to, or that belongs to somebody else."""


@dataclass(frozen=True)
class Folder:
    """An open folder."""

    path: Path
    number: int | None  # its descriptor; None where the system opens files by path only

    def read(self, name: str) -> bytes:
        """The content of a file. Raises OSError."""
        with open(self.place(name), "rb", opener=self._opener(os.O_RDONLY | NO_LINK)) as file:
            return file.read()

    def write(self, name: str, data: bytes) -> None:
        """Write a file whole. Raises OSError; then, and on an interrupt, no trace is left."""
        new = f".{secrets.token_hex(8)}.tmp"
        try:
            with open(self.place(new), "xb", opener=self._opener(None)) as file:
                file.write(data)
            os.replace(self.place(new), self.place(name), src_dir_fd=self.number, dst_dir_fd=self.number)
        except BaseException:
            with suppress(OSError):
                os.unlink(self.place(new), dir_fd=self.number)
            raise

    def names(self) -> list[str]:
        """The names of its files and folders. Raises OSError."""
        return os.listdir(self.path if self.number is None else self.number)

    def remove_old(self, prefix: str, seconds: float, but: str | None = None) -> None:
        """Remove folders and files whose names begin so, but not like `but`, and that have not changed for so long."""
        for name in self.names():
            if name.startswith(prefix) and not (but and name.startswith(but)):
                with suppress(OSError):  # another process may be faster
                    found = os.stat(self.place(name), dir_fd=self.number)
                    if time.time() - found.st_mtime > seconds:
                        self._remove(name, stat.S_ISDIR(found.st_mode))

    def _remove(self, name: str, is_folder: bool) -> None:
        if is_folder:
            shutil.rmtree(self.place(name), ignore_errors=True, dir_fd=self.number)
        else:
            os.unlink(self.place(name), dir_fd=self.number)

    def place(self, name: str) -> str:
        return str(self.path / name) if self.number is None else name

    def _opener(self, flags: int | None) -> Callable[[str, int], int] | None:
        def opened(name: str, usual: int) -> int:
            return os.open(name, usual if flags is None else flags, 0o666, dir_fd=self.number)

        return None if self.number is None else opened


@contextmanager
def opened(path: Path, named: bool) -> Iterator[Folder]:
    """Open a folder in its base for the time of the block.

    `named`: the base is the user's choice or the package's. Raises Untrusted, or another OSError, such as
    FileNotFoundError where it is not there.
    """
    with _base(path.parent, named) as (base, owners), _within(base, path, owners, named) as folder:
        yield folder


@contextmanager
def made(path: Path, named: bool, prefix: str, seconds: float | None) -> Iterator[Folder]:
    """The same, made where it is not there; those beside it that begin so and have not changed for so long then go."""
    path.parent.mkdir(mode=0o777 if named else 0o700, parents=True, exist_ok=True)
    with _base(path.parent, named) as (base, owners):
        with suppress(FileExistsError):
            os.mkdir(base.place(path.name), 0o775 if named else 0o700, dir_fd=base.number)
            if seconds is not None:
                base.remove_old(prefix, seconds)
        with _within(base, path, owners, named) as folder:
            yield folder


@contextmanager
def _base(path: Path, named: bool) -> Iterator[tuple[Folder, set[int]]]:
    """An open base, and who may own what is in it."""
    if not DESCRIPTORS:
        yield Folder(path, None), set()
        return
    with _open(path, None, 0 if named else NO_LINK) as (base, found):
        owners = {0, os.getuid()} | ({found.st_uid} if named else set())
        _check(path, found, owners, stat.S_IWOTH if named else stat.S_IWGRP | stat.S_IWOTH, sticky=named)
        if not named:
            with _open(path.parent, None, 0) as (_, around):
                _check(path.parent, around, {around.st_uid}, stat.S_IWOTH, sticky=True)
        yield base, owners


@contextmanager
def _within(base: Folder, path: Path, owners: set[int], named: bool) -> Iterator[Folder]:
    if base.number is None:
        yield Folder(path, None)
        return
    with _open(path, base.number, NO_LINK) as (folder, found):
        _check(path, found, owners, stat.S_IWOTH if named else stat.S_IWGRP | stat.S_IWOTH)
        yield folder


@contextmanager
def _open(path: Path, base: int | None, flags: int) -> Iterator[tuple[Folder, os.stat_result]]:
    number = os.open(path if base is None else path.name, os.O_RDONLY | FOLDER | flags, dir_fd=base)
    try:
        yield Folder(path, number), os.fstat(number)
    finally:
        os.close(number)


def _check(path: Path, found: os.stat_result, owners: set[int], forbidden: int, sticky: bool = False) -> None:
    """Raise Untrusted where a folder has another owner, or others can write to it; with `sticky` they may where each
    can rename and remove only what is his.
    """
    if found.st_uid not in owners:
        raise Untrusted(13, "belongs to another user", str(path))
    if found.st_mode & forbidden and not (sticky and found.st_mode & stat.S_ISVTX):
        raise Untrusted(13, "other users can write to it", str(path))
