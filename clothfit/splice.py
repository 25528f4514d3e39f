"""New numbers into an old text: all but the numbers that changed stays byte for byte as it was.

Writing the parsed document again would respell every number (`0.020` becomes `0.02`) and lose the layout. Instead the
lists are found in the text, and in them the tokens whose value differs are replaced. The text is one that parsed as
a valid scene without repeated keys, so the end of a value is found from strings and brackets alone, without recursion.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence

STRING = r'"[^"\\]*(?:\\.[^"\\]*)*"'
# One set of first characters lets the search skip long runs of numbers quickly.
MARK = re.compile(r'["\[\]{}](?:(?<=")[^"\\]*(?:\\.[^"\\]*)*")?', re.DOTALL)
ATOM = re.compile(rf"{STRING}|[^\s,:\]}}]+", re.DOTALL)
BETWEEN = re.compile(r"[ \t\r\n,:]*")  # separators need no telling apart in a valid text
NUMBER = re.compile(r"-?[0-9][0-9.eE+-]*")


def splice(text: str, values: Sequence[Mapping[str, Sequence[float]]]) -> str:
    """Put numbers into the lists of a scene's objects: `values[i]["vertMass"]` into `objects[i].vertMass`.

    Each list keeps its length. A token stays when its value is the new one, else it becomes `repr` of the new one.
    """
    pieces, done = [], 0
    for spans, lists in zip(object_spans(text), values, strict=True):
        for name in sorted(lists, key=spans.__getitem__):
            start, end = spans[name]
            pieces += [text[done:start], _renumbered(text[start:end], lists[name])]
            done = end
    return "".join([*pieces, text[done:]])


def object_spans(text: str) -> list[dict[str, tuple[int, int]]]:
    """Find the fields of each object of a scene: name to (start, end) of the value in the text."""
    scene = dict(_members(text, BETWEEN.match(text).end()))  # type: ignore[union-attr]  # it matches nothing, too
    return [dict(_members(text, start)) for start, _ in _items(text, scene["objects"][0])]


def _renumbered(numbers: str, values: Sequence[float]) -> str:
    tokens = NUMBER.findall(numbers)
    new = iter([t if float(t) == value else repr(float(value)) for t, value in zip(tokens, values, strict=True)])
    return NUMBER.sub(lambda _: next(new), numbers)


def _members(text: str, start: int) -> Iterator[tuple[str, tuple[int, int]]]:
    """Walk the fields of the object at `start`: key and span of the value."""
    spans = _items(text, start)
    for (key, end), value in zip(spans, spans, strict=True):
        yield json.loads(text[key:end]), value


def _items(text: str, start: int) -> Iterator[tuple[int, int]]:
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
    for mark in MARK.finditer(text, start):
        first = text[mark.start()]
        depth += (first in "[{") - (first in "]}")
        if depth == 0:
            return mark.end()
    raise ValueError(f"the value at {start} has no end")
