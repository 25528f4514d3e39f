"""Arrays in `.npz` and `.npy` files, which may come from anybody: headers are checked before any data are read.

A `.npy` file is a short header with type and shape, and then the numbers; an `.npz` file is a zip archive of such
files, stored or deflated. The header is text that looks like Python. It is searched for its three fields, never
evaluated, and nothing is unpickled. A few kilobytes can unpack to gigabytes, and a header can promise any shape: so the
caller sees types and shapes first, and reads only the arrays it needs, into memory of just their size.
"""

from __future__ import annotations

import math
import re
import zipfile
import zlib
from collections.abc import Collection, Mapping
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.reading import MOST_TEXT, whole
from clothfit.base.writing import Data

NPY_MAGIC = b"\x93NUMPY"
ZIP_MAGIC = b"PK"

LONGEST_HEADER = 10_000
"""Bytes; NumPy's own limit."""

CHUNK_BYTES = 1 << 20
"""Bytes to read at a time. An archive's table of contents must fit into one chunk."""

UNPACKED_FREELY, LARGEST_RATIO = 64 << 20, 100
"""An array of more than `UNPACKED_FREELY` bytes may be packed at most `LARGEST_RATIO` times smaller: the numbers of a
motion hardly shrink.
"""

TYPE_FIELD = re.compile(r"""['"]descr['"]\s*:\s*['"]([^'"]{1,30})['"]\s*[,}]""")
ORDER_FIELD = re.compile(r"""['"]fortran_order['"]\s*:\s*(True|False)\s*[,}]""")
SHAPE_FIELD = re.compile(r"""['"]shape['"]\s*:\s*\(((?:\s*[0-9]{1,18}L?\s*,)*\s*(?:[0-9]{1,18}L?)?\s*)\)\s*[,}]""")

PLAIN_TYPE = re.compile(r"[<>=|]?[biufcSUVmM][0-9]{1,9}(?:\[[0-9A-Za-z]{1,9}\])?")
"""Types of plain bytes, as NumPy writes them; NumPy accepts other names, some of them for pointers."""

FAULTS = (
    OSError, ValueError, EOFError, RuntimeError, MemoryError, OverflowError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What this module and the libraries below it may raise on a damaged file."""


def content(file: IO[bytes]) -> bytes:
    """The content of an open file that may hold arrays, or a scene. What does not begin like arrays may be an endless
    device: no more of it is read than of a text. Raises OSError, with a sentence as its `strerror`.
    """
    first = b""
    while len(first) < len(NPY_MAGIC) and (piece := file.read(len(NPY_MAGIC) - len(first))):
        first += piece
    rest: bytes = whole(file, None if first.startswith((NPY_MAGIC, ZIP_MAGIC)) else MOST_TEXT)
    return first + rest


class Stored:
    """An array in a file, whose header has been read."""

    def __init__(self, stream: IO[bytes], size: int, packed: int) -> None:
        """`stream` is at the beginning of a `.npy` of `size` bytes, which take `packed` bytes in the file."""
        self._stream, self._packed = stream, packed
        text, start = _header(stream)
        self.dtype, self.shape, self._fortran = _described(text)
        if start + self.nbytes > size:
            raise ValueError(f"it ends early: {self.nbytes} bytes of numbers are promised, {size - start} are there")

    @property
    def nbytes(self) -> int:
        """Bytes of its numbers."""
        return math.prod(self.shape) * self.dtype.itemsize

    def read(self) -> NDArray[Any]:
        """Its numbers; may be called once."""
        if self.nbytes > UNPACKED_FREELY and self.nbytes > LARGEST_RATIO * self._packed:
            raise ValueError(f"{self._packed} bytes unpack to {self.nbytes}; write it with numpy.savez, not compressed")
        array: NDArray[Any] = np.empty(self.shape[::-1] if self._fortran else self.shape, self.dtype)
        room = array.reshape(-1).view(np.uint8) if self.nbytes else np.empty(0, np.uint8)
        done = 0
        while done < len(room):
            piece = self._stream.read(min(CHUNK_BYTES, len(room) - done))
            if not piece:
                raise EOFError("it ends early")
            room[done : done + len(piece)] = np.frombuffer(piece, np.uint8)
            done += len(piece)
        self._stream.read(1)  # at its end the checksum is compared
        return array.T if self._fortran else array


def archive(arrays: Mapping[str, NDArray[Any]]) -> Data:
    """What writes arrays, by name, to an `.npz` file without copying them."""
    write: Any = np.savez  # its type hints take `allow_pickle` for one of the arrays
    return lambda file: write(file, **arrays)  # none of them holds objects, so nothing is pickled


def stored(file: IO[bytes], names: Collection[str], only: str) -> dict[str, Stored]:
    """The arrays with these names in an open, seekable file; the array of a bare `.npy` gets the name `only`.

    Raises one of FAULTS, with a short reason, when the file is damaged.
    """
    first = file.read(len(NPY_MAGIC))
    size = file.seek(0, 2)
    file.seek(0)
    if first == NPY_MAGIC:
        return {only: Stored(file, size, size)}
    if not first.startswith(ZIP_MAGIC):
        raise ValueError("it is neither")
    archive = zipfile.ZipFile(_Rationed(file))
    entries = {name: _entry(archive, name) for name in names}
    return {
        name: Stored(archive.open(info), info.file_size, min(info.compress_size, size))
        for name, info in entries.items()
        if info is not None
    }


class _Rationed:
    """A file that gives no more than a chunk at a time, as a table of contents is read in one go."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def read(self, size: int = -1) -> bytes:
        data = self._file.read(min(size, CHUNK_BYTES + 1) if size >= 0 else CHUNK_BYTES + 1)
        if len(data) > CHUNK_BYTES:
            raise zipfile.BadZipFile("it holds too many files to be a motion")
        return data


def _entry(archive: zipfile.ZipFile, name: str) -> zipfile.ZipInfo | None:
    found = [info for info in archive.infolist() if info.filename in (name, f"{name}.npy")]
    if not found:
        return None
    if len(found) > 1:
        raise ValueError(f"it holds {name} more than once")
    if found[0].flag_bits & 1:
        raise ValueError("it is encrypted")
    if found[0].compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError("it is packed in another way than NumPy's; write it with numpy.savez")
    return found[0]


def _header(stream: IO[bytes]) -> tuple[str, int]:
    """The text of a header, and where the numbers begin."""
    start = stream.read(8)
    if not start.startswith(NPY_MAGIC) or len(start) < 8:
        raise ValueError("what it holds is not an array")
    wide = 2 if start[6] == 1 else 4  # bytes of the header's length
    length = int.from_bytes(stream.read(wide), "little")
    if start[6] not in (1, 2, 3) or length > LONGEST_HEADER:
        raise ValueError("the header of the array is not one of NumPy's")
    return stream.read(length).decode("utf-8" if start[6] == 3 else "latin-1"), 8 + wide + length


def _described(text: str) -> tuple[np.dtype[Any], tuple[int, ...], bool]:
    """Type, shape, and whether the first index varies fastest, from the text of a header."""
    descr, order, shape = (pattern.findall(text) for pattern in (TYPE_FIELD, ORDER_FIELD, SHAPE_FIELD))
    if descr and "O" in descr[0]:
        raise ValueError("it holds pickled objects")
    if not len(descr) == len(order) == len(shape) == 1:
        raise ValueError("its header does not give the type and shape of plain numbers")
    try:
        if not PLAIN_TYPE.fullmatch(descr[0]):
            raise TypeError
        dtype = np.dtype(descr[0])
    except TypeError:
        raise ValueError(f"there is no type {descr[0]!r} of plain numbers") from None
    return dtype, tuple(int(size) for size in re.findall("[0-9]+", shape[0])), order[0] == "True"
