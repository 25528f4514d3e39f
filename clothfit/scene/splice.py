"""New numbers in an old text: everything but the changed numbers stays byte for byte as it was.

Writing the parsed document again would respell every number (`0.020` becomes `0.02`) and lose the layout. Instead this
module finds the values in the text and replaces the tokens whose value differs; a field that is needed and missing goes
behind the last field of its object, spaced as that one. The text has been parsed as a valid scene without repeated
keys, so strings and brackets alone show the end of a value, without recursion.

A value is a number, a text, a list of numbers or of flags, a vector {x, y, z}, a list of vectors, or some fields of an
object, or of those at some places of a list, by these places.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

STRING = r'"[^"\\]*(?:\\.[^"\\]*)*"'
# One set of first characters lets the search skip long runs of numbers quickly.
STRING_OR_BRACKET = re.compile(r'["\[\]{}](?:(?<=")[^"\\]*(?:\\.[^"\\]*)*")?', re.DOTALL)
ATOM = re.compile(rf"{STRING}|[^\s,:\]}}]+", re.DOTALL)
BETWEEN = re.compile(r"[ \t\r\n,:]*")  # a valid text needs no distinction of separators
NUMBER_TOKEN = re.compile(r"-?[0-9][0-9.eE+-]*")

Span = tuple[int, int]
Edit = tuple[int, int, str]  # from, to, new text


class Optional(NamedTuple):
    """The value of a field that a text may lack."""

    value: Any
    needed: bool  # whether to insert it where it is missing


class Appended(NamedTuple):
    """Items that go behind those of a list, which a text may lack."""

    items: list[Any]


def splice(text: str, objects: Sequence[Mapping[str, Any]], scene: Mapping[str, Any] | None = None) -> str:
    """Put values into the fields of a scene and its objects: `objects[i]["vertMass"]` into `objects[i].vertMass`.

    Each list keeps its length. A token stays if it has the new value, else it becomes the `repr` of that. Fields that
    may be missing have their value as an `Optional`.
    """
    start = _after(text, 0)
    top = dict(_members(text, start))
    edits = list(_edits(text, start, top, scene or {}))
    for (at, _), values in zip(_items(text, top["objects"][0]), objects, strict=True):
        edits += _edits(text, at, dict(_members(text, at)), values)
    pieces, done = [], 0
    for first, last, new in sorted(edits):
        pieces += [text[done:first], new]
        done = last
    return "".join([*pieces, text[done:]])


def _edits(text: str, start: int, spans: Mapping[str, Span], values: Mapping[str, Any]) -> Iterator[Edit]:
    """What to change in the object at `start`, with fields at `spans`, for new values of some of its fields."""
    missing = {}
    for name, given in values.items():
        value, needed = given if isinstance(given, Optional) else (given, True)
        if isinstance(value, Appended) and name in spans:
            yield _appended(text, spans[name], value.items)
        elif isinstance(value, Appended):
            missing[name] = value.items
        elif name in spans:
            yield from _changes(text, spans[name], value)
        elif needed:
            missing[name] = value
    if missing:
        yield _insertion(text, start, missing)


def _changes(text: str, span: Span, value: Any) -> Iterator[Edit]:
    """What to change in the value at `span` to make it the new one."""
    if isinstance(value, Mapping) and text[span[0]] == "[":
        items = list(_items(text, span[0]))
        for place, part in value.items():
            yield from _changes(text, items[place], part)
    elif isinstance(value, Mapping):
        yield from _edits(text, span[0], dict(_members(text, span[0])), value)
    elif isinstance(value, Sequence) and value and isinstance(value[0], Mapping):
        for item, part in zip(_items(text, span[0]), value, strict=True):
            yield from _changes(text, item, part)
    elif isinstance(value, str) or (isinstance(value, Sequence) and value and isinstance(value[0], bool)):
        if json.loads(text[slice(*span)]) != value:
            yield *span, json.dumps(value)
    else:
        old = text[slice(*span)]
        new = _renumbered(old, value if isinstance(value, Sequence) else [value])
        if new != old:
            yield *span, new


def _insertion(text: str, start: int, missing: Mapping[str, Any]) -> Edit:
    """Text for new fields behind the last field of the object at `start`, in the spacing of that field."""
    *before, key, value = [(start, start + 1), *_items(text, start)]
    gap = text[before[-1][1] : key[0]].replace(",", "")
    colon = text[key[1] : value[0]]
    separators = (", ", ": ") if colon.endswith(" ") else (",", ":")
    fields = [f'{gap}"{name}"{colon}{json.dumps(new, separators=separators)}' for name, new in missing.items()]
    return value[1], value[1], "".join(f",{field}" for field in fields)


def _appended(text: str, span: Span, items: Sequence[Any]) -> Edit:
    """Text for new items of the list at `span`."""
    ends = [end for _, end in _items(text, span[0])]
    place = ends[-1] if ends else span[0] + 1
    return place, place, (", " if ends else "") + ", ".join(map(json.dumps, items))


def _renumbered(numbers: str, values: Sequence[float]) -> str:
    """The text of numbers with other values; one that is an `int` is written without a decimal point."""
    tokens = NUMBER_TOKEN.findall(numbers)
    made = [repr(value if isinstance(value, int) else float(value)) for value in values]
    new = iter([t if float(t) == value else n for t, value, n in zip(tokens, values, made, strict=True)])
    return NUMBER_TOKEN.sub(lambda _: next(new), numbers)


def _members(text: str, start: int) -> Iterator[tuple[str, Span]]:
    """Walk the fields of the object at `start`: key and span of the value."""
    spans = _items(text, start)
    for (key, end), value in zip(spans, spans, strict=True):
        yield json.loads(text[key:end]), value


def _items(text: str, start: int) -> Iterator[Span]:
    """Walk the values of the list (or the keys and values of the object) at `start`: their spans."""
    at = _after(text, start + 1)
    while text[at] not in "]}":
        end = _end(text, at)
        yield at, end
        at = _after(text, end)


def _after(text: str, at: int) -> int:
    return BETWEEN.match(text, at).end()  # type: ignore[union-attr]  # it matches nothing, too


def _end(text: str, start: int) -> int:
    """Find the end of the value at `start`."""
    if text[start] not in "[{":
        return ATOM.match(text, start).end()  # type: ignore[union-attr]  # a valid text has a value here
    depth = 0
    for mark in STRING_OR_BRACKET.finditer(text, start):
        first = text[mark.start()]
        depth += (first in "[{") - (first in "]}")
        if depth == 0:
            return mark.end()
    raise ValueError(f"the value at {start} has no end")
