"""Modules made of text."""

import types
from pathlib import Path


def module_of(text: str, name: str) -> types.ModuleType:
    """A module of this name with this content; it is not among those that can be imported."""
    made = types.ModuleType(name)
    exec(compile(text, f"{name}.py", "exec"), made.__dict__)
    return made


def script(path: Path) -> types.ModuleType:
    """The module of a script outside of the package; it is not among those that can be imported."""
    made = types.ModuleType(path.stem)
    made.__file__ = str(path)
    exec(compile(path.read_text("utf-8"), str(path), "exec"), made.__dict__)
    return made
