"""What a file is by its first bytes, for the message where it cannot be read as what its suffix says."""

from __future__ import annotations

import os

from clothfit.base.errors import InvalidMotion
from clothfit.base.reading import unchanged
from clothfit.formats.files import name_of

LONGEST = 512
"""Bytes to look at."""

SCENES = ("", ".json", ".txt")
"""Suffixes that a scene may have."""

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
    b"; FBX": ("an FBX file", "export it as .glb, .usd, .abc or .obj"),
    b"# vtk DataFile": ("a VTK file", "export it as .ply, .stl or .obj"),
    b"OFF\n": ("an OFF mesh", "export it as .ply, .stl or .obj"),
    b"OFF\r": ("an OFF mesh", "export it as .ply, .stl or .obj"),
    b"$MeshFormat": ("a Gmsh mesh", "export it as .ply, .stl or .obj"),
    b"<?xml": ("an XML file, as COLLADA's and VTK's are", "export it as .glb, .usd, .abc or .obj"),
    b"\xff\xd8\xff": ("a picture", "name another file"),
    b"Kaydara FBX": ("an FBX file", "export it as .glb, .usd, .abc or .obj"),
    b"BLENDER": ("a Blender file", "export it as .glb, .usd, .abc or .obj"),
    b"\x89HDF": ("an HDF5 file", "export it in another format"),
    b"version https://git-lfs": ("a pointer of Git LFS, not the file itself", "fetch that with: git lfs pull"),
    b"<!doctype html": ("a web page", "download the file itself"),
    b"<html": ("a web page", "download the file itself"),
    b"\x89PNG": ("a picture", "name another file"),
    b"GIF8": ("a picture", "name another file"),
    b"%PDF": ("a PDF document", "name another file"),
}
"""How other files begin: what they are, and what to do."""


def explained(path: str | os.PathLike[str], suffix: str, error: InvalidMotion) -> InvalidMotion:
    """The error of a reader, or a better one where the content of the file is not that of its suffix."""
    found = mistaken(path, suffix)
    return error if found is None else InvalidMotion(f"{name_of(path)}: {found}")


def mistaken(path: str | os.PathLike[str], suffix: str) -> str | None:
    """What a file is and what to do, where it is empty or its content is known not to be that of its suffix."""
    head = beginning(path)
    if head is None:
        return None
    if not head:
        return "it is empty; export it again"
    for begin, (what, own) in FORMATS.items():
        if head.startswith(begin.lower()) and own[:4] != suffix[:4]:
            return f"its content is {what}; rename it to {own}"
    for begin, (what, remedy) in OTHERS.items():
        if head.startswith(begin.lower()) and (begin, suffix) != (b"\x89HDF", ".abc"):
            return f"it is {what}; {remedy}"
    return None


def no_scene(path: str | os.PathLike[str], suffix: str) -> str | None:
    """What a file is that was read as a scene and is no JSON object; None where it may be meant as one."""
    head = beginning(path)
    if not head or head.startswith(b"{"):
        return None
    found = mistaken(path, suffix)
    if found is None and suffix not in SCENES:
        return f"it is no scene, which is a JSON object, and {suffix} is no format that is read; export it as another"
    return found


def beginning(path: str | os.PathLike[str]) -> bytes | None:
    """The first bytes of a file after white space, in lower case; None where there is no such file."""
    try:
        if not os.path.isfile(path):
            return None
        with unchanged(path) as file:
            return file.read(LONGEST).lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    except (OSError, ValueError):
        return None
