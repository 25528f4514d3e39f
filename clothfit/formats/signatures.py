"""What a file is by its first bytes, for the message where it cannot be read as what its suffix says."""

from __future__ import annotations

import os

from clothfit.base.errors import InvalidMotion
from clothfit.base.reading import unchanged
from clothfit.formats.files import name_of

LONGEST = 512
"""Bytes to look at."""

FORMATS = {
    b"glTF": ("glTF", ".glb"),
    b"Ogawa": ("Alembic", ".abc"),
    b"PXR-USDC": ("USD", ".usdc"),
    b"#usda": ("USD", ".usda"),
    b"ply\n": ("PLY", ".ply"),
    b"ply\r": ("PLY", ".ply"),
    b"solid ": ("STL", ".stl"),
    b"POINTCACHE2": ("PC2", ".pc2"),
    b"PathFileType": ("TRC", ".trc"),
    b"\x93NUMPY": ("NumPy", ".npy"),
}
"""How files of known formats begin: their names and suffixes."""

OTHERS = {
    b"\x1f\x8b": ("a gzip archive", "unpack it"),
    b"PK\x03\x04": ("a zip archive", "unpack it"),
    b"Kaydara FBX": ("an FBX file", "export it as .glb, .usd, .abc or .obj"),
    b"BLENDER": ("a Blender file", "export it as .glb, .usd, .abc or .obj"),
    b"\x89HDF": ("an HDF5 file", "export it in another format"),
    b"version https://git-lfs": ("a pointer of Git LFS, not the file itself", "fetch that with: git lfs pull"),
    b"<!doctype html": ("a web page", "download the file itself"),
    b"<html": ("a web page", "download the file itself"),
    b"\x89PNG": ("a picture", "name another file"),
    b"%PDF": ("a PDF document", "name another file"),
}
"""How other files begin: what they are, and what to do."""


def explained(path: str | os.PathLike[str], suffix: str, error: InvalidMotion) -> InvalidMotion:
    """The error of a reader, or a better one where the content of the file is not that of its suffix."""
    try:
        if not os.path.isfile(path):
            return error
        with unchanged(path) as file:
            head = file.read(LONGEST).lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    except (OSError, ValueError):
        return error
    if not head:
        return InvalidMotion(f"{name_of(path)}: it is empty; export it again")
    for begin, (what, own) in FORMATS.items():
        if head.startswith(begin.lower()) and own[:4] != suffix[:4]:
            return InvalidMotion(f"{name_of(path)}: its content is {what}; rename it to {own}")
    for begin, (what, remedy) in OTHERS.items():
        if head.startswith(begin.lower()) and (begin, suffix) != (b"\x89HDF", ".abc"):
            return InvalidMotion(f"{name_of(path)}: it is {what}; {remedy}")
    return error
