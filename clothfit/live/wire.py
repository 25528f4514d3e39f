"""What goes over the WebSocket: the layout of frames, and messages that are read with suspicion.

A binary message has a header of 24 bytes and float32 numbers, all little-endian:

    0   4 bytes   "CFF1": a frame; "CFT1": the target
    4   uint32    generation: grows with each scene that is loaded; the number of vertices is that of this scene
    8   uint64    number of the frame, steps since the start; of a target the number of its frames
    16  float64   time of the frame, s; of a target the time between two of its frames
    24  float32   x, y, z of each vertex, m, frame after frame; NaN where the target was not observed

Text messages are JSON objects with a `type`.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput

HEADER = struct.Struct("<4sIQd")
FRAME, TARGET = b"CFF1", b"CFT1"

LARGEST = 8 << 20
"""Bytes of a message: one that loads a scene, of some 20,000 vertices. What is larger is not even received."""

ORDINARY = 256 << 10
"""Bytes of any other message. A process of its own parses what is larger."""

ENDS = 400
"""Characters at the beginning and the end of a long message, within which its type must stand."""

TOO_LARGE = f"the message is too large: {ORDINARY} characters at most, and {LARGEST} bytes of one that loads a scene"


class Packet(NamedTuple):
    """A binary message."""

    kind: bytes
    generation: int
    number: int
    time: float
    positions: Array  # (frames, n, 3), m


def packed(kind: bytes, generation: int, number: int, time: float, positions: Array) -> bytes:
    """A binary message of positions (…, 3), m."""
    with np.errstate(over="ignore"):
        numbers = np.ascontiguousarray(positions, "<f4")
    return HEADER.pack(kind, generation & 0xFFFFFFFF, number, time) + numbers.tobytes()


def unpacked(data: bytes) -> Packet:
    """The positions of a binary message, one frame or those of a target. Raises InvalidInput for another."""
    if len(data) < HEADER.size or data[:4] not in (FRAME, TARGET) or (len(data) - HEADER.size) % 12:
        raise InvalidInput("that is no message of positions")
    kind, generation, number, time = HEADER.unpack_from(data)
    frames = number if kind == TARGET else 1
    numbers = np.frombuffer(data, "<f4", offset=HEADER.size).astype(float)
    if frames < 1 or len(numbers) % (3 * frames):
        raise InvalidInput("that is no message of positions")
    return Packet(kind, generation, number, time, numbers.reshape(frames, -1, 3))


def parsed(text: str | bytes, most: int = ORDINARY) -> dict[str, Any]:
    """A message of so many characters at most. Raises InvalidInput, with the reason, for what is none."""
    if isinstance(text, bytes):
        raise InvalidInput("messages to the server are text; this one is binary")
    if len(text) > most:
        raise InvalidInput(TOO_LARGE)
    try:
        message = json.loads(text, parse_constant=no_constant)
    except RecursionError:
        raise InvalidInput("the message is nested too deeply") from None
    except ValueError as error:  # also of a number with too many digits
        raise InvalidInput(f"the message is no JSON: {str(error)[:120]}") from None
    if not isinstance(message, dict):
        raise InvalidInput("a message is a JSON object")
    if not isinstance(message.get("type"), str):
        raise InvalidInput('the message has no "type"')
    if not isinstance(message.get("id"), (int, str, type(None))) or len(str(message.get("id"))) > 100:
        raise InvalidInput('"id" is a whole number or a short text')
    return message


def loads(text: str | bytes) -> bool:
    """Whether a long message seems to load a scene: whether its beginning or its end says so."""
    return isinstance(text, str) and '"load"' in text[:ENDS] + text[-ENDS:]


def guessed_id(text: str | bytes) -> dict[str, Any]:
    """The id of a message that is too long to be parsed, as far as its beginning or its end shows it."""
    ends = text[:ENDS] + " " + text[-ENDS:] if isinstance(text, str) else ""
    found = re.search(r'"id"\s*:\s*(-?\d{1,15}|"[^"\\]{0,100}")', ends)
    return {"id": json.loads(found[1])} if found else {}


def check_fields(message: Mapping[str, Any], known: Sequence[str]) -> None:
    """Raise InvalidInput where a message has a field that is not known."""
    unknown = sorted(set(message) - {"type", "id"} - set(known))
    if unknown:
        fields = ", ".join(known) or "none"
        raise InvalidInput(f"{message['type']}: there is no field {unknown[0][:40]!r}; there are: {fields}")


def no_constant(name: str) -> None:
    """Refuse NaN and infinities, which are no JSON."""
    raise ValueError(f"{name} is not a number of JSON")


def text_of(message: dict[str, Any]) -> str:
    """A message as text."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False)


# ---- What messages ask for, checked: numbers, flags, and what to fit.

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
    own = document.get("fit", {})  # or "auto"
    kept = {"bounds": own["bounds"]} if "bounds" in own else {}
    document["fit"] = kept | {field: True for name, field in OF_SCENE.items() if flags.get(name)}
    return document


def letter(value: Any, name: str) -> str:
    """A mode of masses or stiffnesses."""
    if value not in LETTERS:
        raise InvalidInput(f"fit.{name}: one of {', '.join(LETTERS)} is needed")
    return str(value)
