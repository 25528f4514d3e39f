"""What messages ask for, checked: numbers, flags, and what to fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from clothfit.base.errors import InvalidInput

T = TypeVar("T")

LETTERS = ("n", "F", "R", "M", "G", "L")
OF_OBJECTS = {"damping": "damping", "drag": "dragCoefficient"}
OF_SCENE = {"wind": "windVel", "gravity": "gravity"}


def whole(message: Mapping[str, Any], name: str, low: int, high: int, otherwise: T) -> int | T:
    """A whole number of a message. Raises InvalidInput."""
    value = message.get(name, otherwise)
    if value is otherwise:
        return otherwise
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise InvalidInput(f"{name}: a whole number from {low} to {high} is needed")
    return value


def number(message: Mapping[str, Any], name: str, low: float, high: float, otherwise: T) -> float | T:
    """A number of a message. Raises InvalidInput."""
    value = message.get(name, otherwise)
    if value is otherwise:
        return otherwise
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise InvalidInput(f"{name}: a number from {low:g} to {high:g} is needed")
    return float(value)


def flag(message: Mapping[str, Any], name: str) -> bool:
    """A flag of a message. Raises InvalidInput."""
    value = message.get(name)
    if not isinstance(value, bool):
        raise InvalidInput(f"{name}: true or false is needed")
    return value


def fitted_fields(document: dict[str, Any], fit: Any) -> dict[str, Any]:
    """The document of a scene that flags what is asked for, as in {"stiffness": "R", "mass": "n", "wind": true}; what
    is not named is not fitted. Without any the scene's own flags stay. Raises InvalidInput.
    """
    if fit is None:
        return document
    known = ("mass", "stiffness", *OF_OBJECTS, *OF_SCENE)
    if not isinstance(fit, dict) or not set(fit) <= set(known):
        raise InvalidInput(f"fit: an object with some of {', '.join(known)} is needed")
    letters = "".join(letter(fit.get(name, "n"), name) for name in ("mass", "stiffness"))
    flags = {name: flag(fit, name) for name in (*OF_OBJECTS, *OF_SCENE) if name in fit}
    if letters == "nn" and not any(flags.values()):
        raise InvalidInput("fit: nothing is chosen")
    for item in document["objects"]:
        item["optimizationSettings"] = letters
        kept = {name: value for name, value in item.get("fit", {}).items() if name == "bounds"}
        item["fit"] = kept | {field: True for name, field in OF_OBJECTS.items() if flags.get(name)}
    kept = {name: value for name, value in document.get("fit", {}).items() if name == "bounds"}
    document["fit"] = kept | {field: True for name, field in OF_SCENE.items() if flags.get(name)}
    return document


def letter(value: Any, name: str) -> str:
    """A mode of masses or stiffnesses."""
    if value not in LETTERS:
        raise InvalidInput(f"fit.{name}: one of {', '.join(LETTERS)} is needed")
    return str(value)
