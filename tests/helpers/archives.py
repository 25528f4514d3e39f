"""Motion files that are not in order, by what is said of them; and what such files are made of."""

from __future__ import annotations

import io
import struct
import warnings
import zipfile
from typing import Any


def archive(*members: tuple[str, bytes], method: int = zipfile.ZIP_STORED, **lies: Any) -> bytes:
    """A zip archive; `lies` are what its table of contents says of the last member."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as made, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a name that is there twice
        for name, data in members:
            made.writestr(name, data)
        for name, value in lies.items():
            setattr(made.infolist()[-1], name, value)
    return file.getvalue()


def npy(text: str, data: bytes = b"", wide: bool = False) -> bytes:
    """A `.npy` file with a header of that text."""
    length = struct.pack("<I" if wide else "<H", len(text))
    return b"\x93NUMPY" + (b"\2\0" if wide else b"\1\0") + length + text.encode("latin-1") + data


def header(shape: str = "(2,)", descr: str = "<f8", order: str = "False") -> str:
    """The text of a header."""
    return f"{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}\n"


FRAMES, FRAME = "(5, 16, 3)", 16 * 3 * 8
STILL = npy(header(FRAMES), bytes(5 * FRAME))
ONE = ("positions.npy", STILL)
LONG = ("positions.npy", npy(header("(500, 16, 3)"), bytes(500 * FRAME)))
SHORT = ("positions.npy", STILL[:-FRAME])

DAMAGED = {
    "it is neither": b"hello",
    "it ends early": archive(SHORT, method=zipfile.ZIP_DEFLATED, file_size=len(STILL)),
    "it ends early: … bytes of numbers are promised, … are there": STILL[:-1],
    "it holds … more than once": archive(ONE, ONE),
    "it holds too many files to be a motion": archive(*((f"{i:050}", b"") for i in range(12_000))),
    "it is encrypted": archive(ONE, flag_bits=1),
    "it is packed in another way than NumPy's; write it with numpy.savez": archive(ONE, method=zipfile.ZIP_LZMA),
    "… bytes unpack to …; write it with numpy.savez, not compressed": archive(LONG, method=zipfile.ZIP_DEFLATED),
    "what it holds is not an array": archive(("positions.npy", b"hello")),
    "the header of the array is not one of NumPy's": npy(header() + " " * 10_000),
    "its header does not tell type and shape of plain numbers": npy("__import__('os').system('true')"),
    "it holds pickled objects": npy(header(descr="|O")),
    "there is no type … of plain numbers": npy(header(descr="f99")),
}
"""By the reason in `cannot be read as .npz or .npy (…)`: files for a scene of 16 vertices, where `npz.ROOM` is 1000."""
