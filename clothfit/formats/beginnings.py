"""How files begin: what each of them is, for messages and for `clothfit info`."""

from __future__ import annotations

import os
from typing import NamedTuple

from clothfit.base.reading import unchanged

SCENE, MOTION, MESH, EITHER = "scene", "motion", "mesh", "mesh or motion"
CHECKPOINT, LOG, PAGE, MAP, EXPORT = "checkpoint", "log", "page", "map", "export"
FORCES = "file of forces"
SUBSPACE, RECORDED = "subspace", "file of recorded motions"

FIRST = 1 << 16
"""Bytes that are looked at."""

NAME_LENGTH, NAME = slice(26, 28), 30
"""Where a zip archive has the length of the name of its first file, and where that begins."""


class Content(NamedTuple):
    """What a file is that begins so."""

    what: str  # for messages
    suffix: str = ""  # its own, where that is a format that is read
    remedy: str = ""  # what to do with any other
    kind: str | None = None  # one of the above, where the beginning says it


ANIMATION = "export it as .glb, .usd, .abc or .obj"
SURFACE = "export it as .ply, .stl or .obj"
PICTURE = Content("a picture", remedy="name another file")
WEB_PAGE = Content("a web page", remedy="download the file itself", kind=PAGE)
FOR_A_TOOL = Content("an export for another tool", remedy="name the scene that it was made of", kind=EXPORT)
NUMPY = Content("NumPy", ".npy", kind=MOTION)
ZIP = b"PK\x03\x04"
SUBSPACES = {
    b"subspace.npy": Content("a subspace", remedy="it goes with clothfit subspace play", kind=SUBSPACE),
    b"recorded.npy": Content("recorded motions", remedy="they go with clothfit subspace build", kind=RECORDED),
}

CONTENTS = {
    b"glTF": Content("glTF", ".glb"),
    b"Ogawa": Content("Alembic", ".abc"),
    b"PXR-USDC": Content("USD", ".usdc"),
    b"#usda": Content("USD", ".usda"),
    b"ply\n": Content("PLY", ".ply"),
    b"ply\r": Content("PLY", ".ply"),
    b"solid ": Content("STL", ".stl"),
    b"POINTCACHE2": Content("PC2", ".pc2"),
    b"PathFileType": Content("TRC", ".trc"),
    b"\x93NUMPY": NUMPY,
    b"clothfit checkpoint ": Content("a checkpoint", remedy="it goes with estimate --resume", kind=CHECKPOINT),
    b'{"format": "clothfit-': FOR_A_TOOL,
    b'"""Set the values that clothfit found': FOR_A_TOOL,
    b"object,vertices,springs,": FOR_A_TOOL,
    b"object,vertex,x,y,z,": FOR_A_TOOL,
    b"object,spring,a,b,": FOR_A_TOOL,
    b'["fileversion", ': Content("a Houdini geometry", remedy=ANIMATION),
    b"\x1f\x8b": Content("a gzip archive", remedy="unpack it"),
    ZIP: Content("a zip archive", remedy="unpack it"),
    b"; FBX": Content("an FBX file", remedy=ANIMATION),
    b"Kaydara FBX": Content("an FBX file", remedy=ANIMATION),
    b"BLENDER": Content("a Blender file", remedy=ANIMATION),
    b"<?xml": Content("an XML file, as COLLADA's and VTK's are", remedy=ANIMATION),
    b"# vtk DataFile": Content("a VTK file", remedy=SURFACE),
    b"OFF\n": Content("an OFF mesh", remedy=SURFACE),
    b"OFF\r": Content("an OFF mesh", remedy=SURFACE),
    b"$MeshFormat": Content("a Gmsh mesh", remedy=SURFACE),
    b"\x89HDF": Content("an HDF5 file", remedy="export it in another format"),
    b"version https://git-lfs": Content(
        "a pointer of Git LFS, not the file itself", remedy="fetch that with: git lfs pull"
    ),
    b"<!doctype html": WEB_PAGE,
    b"<html": WEB_PAGE,
    b"\xff\xd8\xff": PICTURE,
    b"\x89PNG": PICTURE,
    b"GIF8": PICTURE,
    b"%PDF": Content("a PDF document", remedy="name another file"),
}


def content_of(first: bytes) -> Content | None:
    """What a file is by its first bytes; None for what is not known."""
    if first.startswith(ZIP):
        return packed(first)
    low = first[:64].lower()
    return next((content for begin, content in CONTENTS.items() if low.startswith(begin.lower())), None)


def packed(first: bytes) -> Content:
    """What a zip archive is by the name of its first file."""
    name = first[NAME : NAME + int.from_bytes(first[NAME_LENGTH], "little")].lower()
    if name in SUBSPACES:
        return SUBSPACES[name]
    if name.endswith(b".npy"):
        return NUMPY._replace(suffix=".npz")
    if name.endswith((b".usd", b".usda", b".usdc")):
        return Content("a USDZ package", remedy="unpack it, as a zip archive, and name the USD file in it")
    return CONTENTS[ZIP]


def beginning(path: str | os.PathLike[str]) -> bytes | None:
    """The first bytes of a file after a byte order mark and white space; None where there is no such file."""
    try:
        if not os.path.isfile(path):
            return None
        with unchanged(path) as file:
            return file.read(FIRST).removeprefix(b"\xef\xbb\xbf").lstrip()
    except (OSError, ValueError):
        return None
