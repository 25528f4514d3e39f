"""What a file is by its first bytes, for the message where it cannot be read as what its suffix says."""

from __future__ import annotations

import os

from clothfit.base.errors import InvalidMotion
from clothfit.formats.beginnings import beginning, content_of
from clothfit.formats.files import name_of

SCENES = ("", ".json", ".txt")
"""Suffixes that a scene may have."""


def explained(path: str | os.PathLike[str], suffix: str, error: InvalidMotion) -> InvalidMotion:
    """The error of a reader, or a better one where the content of the file is not that of its suffix."""
    found = mistaken(path, suffix)
    return error if found is None else InvalidMotion(f"{name_of(path)}: {found}")


def mistaken(path: str | os.PathLike[str], suffix: str) -> str | None:
    """What a file is and what to do, where it is empty or its content is known not to be that of its suffix."""
    first = beginning(path)
    if first is None:
        return None
    if not first:
        return "it is empty; export it again"
    found = content_of(first)
    if found is None or (suffix == ".abc" and first.startswith(b"\x89HDF")):  # which its reader explains
        return None
    if not found.suffix:
        return f"it is {found.what}; {found.remedy}"
    return None if found.suffix[:4] == suffix[:4] else f"its content is {found.what}; rename it to {found.suffix}"


def no_scene(path: str | os.PathLike[str], suffix: str) -> str | None:
    """What a file is that was read as a scene and is no JSON object; None where it may be meant as one."""
    first = beginning(path)
    if not first or (first.startswith(b"{") and content_of(first) is None):
        return None
    found = mistaken(path, suffix)
    if found is None and suffix not in SCENES:
        return f"it is no scene, which is a JSON object, and {suffix} is no format that is read; export it as another"
    return found
