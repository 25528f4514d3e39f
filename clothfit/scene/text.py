"""The text of a scene: reading it from a path, an open file or a dict, decoding it, parsing its JSON.

The text is kept as it came, with encoding and byte order mark, so that saving can put back all but the fitted
numbers. Files written on Windows often start with a byte order mark; UTF-16 and UTF-32 are recognised only by theirs.

Python's `json` is laxer than JSON: it accepts NaN and Infinity, keeps the last of repeated keys, turns 1e999 into
infinity, and raises errors of its own on deep nesting and on integers beyond 4300 digits. This module refuses repeated
keys, deep nesting and broken syntax. It accepts numbers that are not finite, so that the check of the values can name
their place in the scene; `parse` lists them.

A text may come from anybody: its size, its nesting and the memory for its values are checked before it is parsed.
"""

from __future__ import annotations

import codecs
import json
import os
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO, Any

from clothfit.base import memory
from clothfit.base.errors import InvalidScene
from clothfit.base.memory import human
from clothfit.base.messages import named, place, unreadable
from clothfit.base.reading import MOST_TEXT, unchanged, whole

Readable = str | os.PathLike[str] | IO[str] | IO[bytes] | dict[str, Any]

# The 32-bit marks first: the little-endian one starts with the 16-bit one.
BYTE_ORDER_MARKS = {
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF32_LE: "utf-32-le",
    codecs.BOM_UTF32_BE: "utf-32-be",
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
}
SAFE_DIGITS = 400  # an integer with more digits is beyond the range of doubles

MOST_DEPTH = 64
"""Levels of nested lists and objects; a scene has 5."""

VALUE_BYTES = {"{": 184, "[": 56, ",": 40}
"""The least memory, in bytes, of an object, of a list, and of a value with its place in one, …"""

TEXT_COPIES = 3
"""… and that of the text with what is cut out of it, as a multiple of its size."""

NO_MARKS = bytes(set(range(256)) - set(b'[]{}"'))

MOST_REPETITIONS = 20  # repeated keys in a message


@dataclass(frozen=True)
class Source:
    """The original text of a scene."""

    text: str  # without the byte order mark, line ends as they were
    encoding: str = "utf-8"  # codec name, one that writes no mark of its own
    mark: bytes = b""  # byte order mark, or nothing

    def encode(self, text: str) -> bytes:
        """Encode a text as this one was."""
        return self.mark + text.encode(self.encoding)


def name_of(origin: object) -> str:
    """Name a scene in messages: the base name of its file, "standard input", or "scene"."""
    name = origin if isinstance(origin, (str, os.PathLike)) else getattr(origin, "name", None)
    if name in (0, "<stdin>"):
        return "standard input"
    path = os.fspath(name) if isinstance(name, (str, os.PathLike)) else ""
    if not isinstance(path, str) or path.startswith("<"):
        return "scene"
    return os.path.basename(path) or path or "scene"


def read_text(origin: Readable) -> Source:
    """Read the text of a scene from a path, an open text or binary file, or a dict.

    Raises InvalidScene when it cannot be read, is not text, or is empty.
    """
    try:
        content = _content(origin)
        if isinstance(content, bytes):
            mark = next((mark for mark in BYTE_ORDER_MARKS if content.startswith(mark)), b"")
            encoding = BYTE_ORDER_MARKS.get(mark, "utf-8")
            source = Source(content[len(mark) :].decode(encoding), encoding, mark)
        else:
            content.encode()  # a lone surrogate could not be saved
            source = Source(content.removeprefix("\ufeff"), mark=codecs.BOM_UTF8 if content[:1] == "\ufeff" else b"")
    except UnicodeError as error:
        raise InvalidScene(_encoding_problem(error), name_of(origin)) from None
    except (OSError, TypeError, ValueError, RecursionError) as error:  # also no dict of JSON values, or a closed file
        raise InvalidScene(unreadable(error), name_of(origin)) from None
    if not source.text.strip():
        raise InvalidScene("the file is empty; a scene is a JSON object", name_of(origin))
    return source


def parse(source: Source, name: str) -> tuple[Any, list[str]]:
    """The JSON document of a text, and each NaN, Infinity and -Infinity in their order. Raises InvalidScene on broken
    syntax, repeated keys and deep nesting.
    """
    repeated: list[tuple[dict[str, Any], str]] = []
    constants: list[str] = []

    def fields(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        made = dict(pairs)
        if len(made) != len(pairs):
            counts = Counter(key for key, _ in pairs)
            repeated.extend((made, key) for key, count in counts.items() if count > 1)
        return made

    def constant(token: str) -> float:
        constants.append(token)
        return float(token)

    _check_nesting(source.text, name)
    hooks: dict[str, Any] = {"object_pairs_hook": fields, "parse_constant": constant}
    try:
        document = _loaded(source.text, hooks)
    except json.JSONDecodeError as error:
        raise InvalidScene(_syntax_problem(error), name) from None
    if repeated:
        del repeated[MOST_REPETITIONS:]
        wanted = {id(owner) for owner, _ in repeated}
        paths = {id(value): path for path, value in _containers(document) if id(value) in wanted}
        raise InvalidScene([_repetition(paths.get(id(owner)), key) for owner, key in repeated], name)
    return document, constants


def constant_problem(source: Source) -> str:
    """A sentence with the place of the first NaN or Infinity, for one in a field that no other check reads."""
    tokens = re.finditer(r'"[^"\\]*(?:\\.[^"\\]*)*"|NaN|-?Infinity', source.text)
    first = next(token for token in tokens if not token.group().startswith('"'))
    line = source.text.count("\n", 0, first.start()) + 1
    column = first.start() - source.text.rfind("\n", 0, first.start())
    return f"line {line}, column {column}: {first.group()} is not JSON; a finite number is needed"


def _content(origin: Readable) -> str | bytes:
    if isinstance(origin, dict):
        return json.dumps(origin)
    if isinstance(origin, (str, os.PathLike)):
        with unchanged(origin) as file:
            data: bytes = whole(file, MOST_TEXT)
            return data
    if not hasattr(origin, "read"):
        raise TypeError(f"a scene comes from a path, an open file or a dict, not from {type(origin).__name__}")
    content: str | bytes = whole(origin, MOST_TEXT)
    return content


def _check_nesting(text: str, name: str) -> None:
    """Raise InvalidScene on a text that is nested too deeply, or whose values would not fit into the free memory."""
    import numpy as np  # here, as messages about a missing file must not wait for NumPy

    marks = _marks(text)
    steps = 28 - (np.frombuffer(marks, np.uint8) & 31).astype(np.int32)  # 1 for [ and {, −1 for ] and }
    if steps.cumsum().max(initial=0) > MOST_DEPTH:
        raise InvalidScene(f"the JSON is nested too deeply to be a scene (more than {MOST_DEPTH} levels)", name)
    counts = {"{": marks.count(b"{"), "[": marks.count(b"["), ",": text.count(",")}
    needed = TEXT_COPIES * len(text) + sum(size * counts[mark] for mark, size in VALUE_BYTES.items())
    if needed > (free := memory.free()):
        raise InvalidScene(f"to read it takes about {human(needed)} of memory, {human(free)} are free", name)


def _marks(text: str) -> bytes:
    """The brackets of a text in their order, without those in strings."""
    plain = text.encode().replace(rb"\\", b"").replace(rb"\"", b"")
    return b"".join(plain.translate(None, NO_MARKS).replace(b'""', b"").split(b'"')[::2])


def _loaded(text: str, hooks: dict[str, Any]) -> Any:
    try:
        return json.loads(text, **hooks)
    except json.JSONDecodeError:
        raise
    except ValueError:  # an integer of thousands of digits; infinite as a double, and harmless in an unknown field
        return json.loads(text, **hooks, parse_int=lambda token: (float if len(token) > SAFE_DIGITS else int)(token))


def _encoding_problem(error: UnicodeError) -> str:
    if not isinstance(error, UnicodeDecodeError):
        return "the text holds half a surrogate pair; save it as UTF-8"
    byte = error.object[error.start]
    return f"byte {error.start + 1} (0x{byte:02x}) is not {error.encoding.upper()} text; save the file as UTF-8"


def _syntax_problem(error: json.JSONDecodeError) -> str:
    where = f"line {error.lineno}, column {error.colno}"
    if "\0" in error.doc[:4]:
        return f"{where}: not JSON text (UTF-16 without a byte order mark?); save the file as UTF-8"
    if error.pos >= len(error.doc.rstrip()) or error.msg.startswith("Unterminated string"):
        return f"{where}: the text ends inside a value; is the file complete?"
    if not error.pos:
        return f"{where}: not JSON; a scene is a JSON object, which clothfit new makes of a mesh"
    before = error.doc[: error.pos].rstrip()
    comma = "; remove the comma before it" if before.endswith(",") and error.doc[error.pos] in "}]" else ""
    return f"{where}: not JSON: {error.msg[0].lower()}{error.msg[1:]}{comma}"


def _repetition(path: tuple[str | int, ...] | None, key: str) -> str:
    if path is None:  # its owner was itself dropped with a repeated key
        return f"{named(key)}: the key appears more than once in an object; keep one"
    return f"{place((*path, named(key)))}: the key {named(key)} appears more than once; keep one"


def _containers(document: Any) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """All objects and lists of a document, with their paths."""
    stack: list[tuple[tuple[str | int, ...], Any]] = [((), document)]
    while stack:
        path, value = stack.pop()
        yield path, value
        members = value.items() if isinstance(value, dict) else enumerate(value)
        for step, item in members:
            if isinstance(item, (dict, list)):
                stack.append(((*path, named(step) if isinstance(step, str) else step), item))
