"""What the headers of this program's motion files say, before the scene is known."""

from __future__ import annotations

import io
import os
import zipfile
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base import npz
from clothfit.base.arrays import Indices
from clothfit.base.reading import unchanged
from clothfit.formats.registry import NATIVE, suffix_of

ARRAY_MAGIC = b"\x93NUMPY"
"""The beginning of an .npy file."""

DESCRIBED_ARRAYS = ("positions", "times", "vertex_counts", "triangles")


class Described(NamedTuple):
    """A motion file by its headers, and its small arrays."""

    counts: tuple[int, ...]  # points of each object
    timed: bool  # whether it has times
    triangles: Indices | None  # (T, 3), points of all objects; None: no faces


NOT_DESCRIBED = Described((0,), True, None)


def described(path_or_file: str | os.PathLike[str] | io.BytesIO) -> Described:
    """What a file says; NOT_DESCRIBED for a damaged one: reading it raises the error."""
    try:
        if isinstance(path_or_file, io.BytesIO):
            found = _described(path_or_file)
            path_or_file.seek(0)
            return found
        if not os.path.isfile(path_or_file):  # a pipe gives its content only once
            return NOT_DESCRIBED
        with unchanged(path_or_file) as file:
            return _described(file)
    except (*npz.FAULTS, KeyError, IndexError, TypeError):
        return NOT_DESCRIBED


def is_strange(path: str | os.PathLike[str]) -> bool:
    """Whether a file has another program's suffix and its content is neither an archive with positions nor an array: to
    name what is missing in it as an archive would blame the wrong thing.
    """
    suffix = suffix_of(path)
    if suffix in ("", *NATIVE) or not os.path.isfile(path):
        return False
    try:
        with unchanged(path) as file:
            if file.read(len(ARRAY_MAGIC)) == ARRAY_MAGIC:
                return False
            with zipfile.ZipFile(file) as archive:
                return "positions.npy" not in archive.namelist()
    except (OSError, ValueError, zipfile.BadZipFile):
        return True


def _described(file: IO[bytes]) -> Described:
    stored = npz.stored(file, DESCRIBED_ARRAYS, "positions")
    total = stored["positions"].shape[1]
    counts = _whole(stored.get("vertex_counts"), 1)
    fits = counts is not None and (counts >= 0).all() and counts.sum() == total
    triangles = _whole(stored.get("triangles"), 2)
    if triangles is not None and not (triangles.shape[1] == 3 and ((triangles >= 0) & (triangles < total)).all()):
        triangles = None
    own = tuple(counts.tolist()) if counts is not None and fits else (total,)
    return Described(own, "times" in stored, None if triangles is None else triangles.astype(np.int32))


def _whole(stored: npz.Stored | None, dimensions: int) -> NDArray[Any] | None:
    """An array of whole numbers; None for other types or another number of dimensions."""
    if stored is None or stored.dtype.kind not in "iu" or len(stored.shape) != dimensions:
        return None
    return stored.read()
