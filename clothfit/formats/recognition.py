"""What a file is, by its first bytes and its name: so that one in the wrong place can be told its right one.

The answer is for messages and for `clothfit info`; whoever reads a file finds out for sure.
"""

from __future__ import annotations

import json
import zipfile
from contextlib import suppress

from clothfit.formats.beginnings import EITHER, FORCES, LOG, MAP, MESH, MOTION, SCENE, beginning, content_of
from clothfit.formats.registry import NATIVE, foreign, suffix_of

ALONE = (".obj", ".ply", ".stl")  # suffixes of meshes of one frame
TABLE = b"time,vertex,fx,fy,fz"  # how a table of forces begins
ANIMATED = (".glb", ".gltf", ".usd", ".usda", ".usdc", ".abc")  # suffixes of what may have one frame or many


def kind_of(path: str) -> str | None:
    """One of the kinds of `beginnings`; None for what is not known, and for what is no file, such as a pipe."""
    if "*" in path and suffix_of(path) == ".obj":
        return EITHER  # a sequence, or the mesh of its first frame
    first = beginning(path)
    if first is None:
        return None
    found = content_of(first)
    if found is not None and found.suffix == ".npz" and _has_forces(path):
        return FORCES
    if found is not None and found.kind is not None:
        return found.kind
    suffix = suffix_of(path)
    if first.startswith(b"{") and suffix != ".gltf":
        return LOG if _is_log(first) else SCENE
    if suffix == ".csv" and first.split(b"\n", 1)[0].strip() == TABLE:
        return FORCES
    if suffix == ".csv" and b"vertex" in first.split(b"\n", 1)[0].lower():
        return MAP
    return _by_name(path)


def _has_forces(path: str) -> bool:
    """Whether an archive of NumPy has forces, and no positions."""
    with suppress(OSError, ValueError, zipfile.BadZipFile, NotImplementedError), zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        return "forces.npy" in names and "positions.npy" not in names
    return False


def _by_name(path: str) -> str | None:
    suffix = suffix_of(path)
    if suffix in ALONE:
        return MESH
    if suffix in ANIMATED:
        return EITHER
    return MOTION if foreign(path) is not None or suffix in NATIVE else None


def _is_log(first: bytes) -> bool:
    with suppress(ValueError, RecursionError):
        line = json.loads(first.split(b"\n", 1)[0])
        return isinstance(line, dict) and ("evaluations" in line or set(line) == {"summary"})
    return False
