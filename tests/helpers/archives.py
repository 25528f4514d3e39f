"""Motion files that are not in order: what such files are made of."""

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
