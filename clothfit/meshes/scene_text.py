"""The text of a new scene: JSON with one field per line, each array of a cloth on its own."""

from __future__ import annotations

import json
from typing import Any


def text(document: dict[str, Any]) -> str:
    """Write a scene, its fields in their order."""
    made = {name: _objects(value) if name == "objects" else _compact(value) for name, value in document.items()}
    lines = [f'"{name}": {value}' for name, value in made.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _objects(cloths: list[dict[str, Any]]) -> str:
    return "[" + ", ".join("{\n" + ",\n".join(map(_field, cloth.items())) + "\n}" for cloth in cloths) + "]"


def _field(item: tuple[str, Any]) -> str:
    return f'  "{item[0]}": {_compact(item[1])}'


def _compact(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"))
