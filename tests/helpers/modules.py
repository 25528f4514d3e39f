"""Modules made of text."""

from __future__ import annotations

import types


def module_of(text: str, name: str) -> types.ModuleType:
    """A module of this name with this content; it is not among those that can be imported."""
    made = types.ModuleType(name)
    exec(compile(text, f"{name}.py", "exec"), made.__dict__)
    return made
