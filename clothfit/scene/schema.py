"""The structure of a scene document: which fields there are, of which type, the scalars within their bounds.

The rules and the defaults are those of `schemas/scene.schema.json`; this module knows the keywords of JSON Schema that
stand there, and what to say of a value that breaks one. The items of the long arrays of a large cloth are left to
`array_checks`, which looks at each list as a whole.
Two types are stricter than in JSON Schema: a number is finite and within the range of doubles, and a whole number is
written without a decimal point.
"""

from __future__ import annotations

import json
import math
import operator
import re
from collections.abc import Callable, Iterator
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

from clothfit.base.messages import named, place, spelt

LONG_ARRAYS = {
    f"objects.{name}"
    for name in (
        "vertPos", "vertIsFixed", "vertMass", "vertVel", "springs", "springStiffness", "springRestLength", "triangles",
        "families.springs", "regions.vertices",
    )
}  # fmt: skip
"""Fields with long lists, without the places in lists on the way to them."""

LONG_NAMES = {field.rpartition(".")[2] for field in LONG_ARRAYS}
LIST = {"type": "array"}

MOST_PROBLEMS = 20

SAY_NOTHING = frozenset({"$schema", "$id", "$defs", "title", "description", "default", "then"})
"""Keywords that refuse nothing by themselves."""

NOT_FINITE = "not a finite number within the range of doubles"

Schema = dict[str, Any]
Steps = tuple[str | int, ...]


def is_number(value: object) -> bool:
    """Whether a value is a finite number within the range of doubles; true and false are not."""
    try:
        return type(value) in (int, float) and math.isfinite(value)  # type: ignore[arg-type]
    except OverflowError:  # an integer beyond the range of doubles
        return False


TYPES: dict[str, tuple[Callable[[Any], bool], str]] = {
    "array": (lambda value: type(value) is list, "a list"),
    "boolean": (lambda value: type(value) is bool, "true or false"),
    "integer": (lambda value: type(value) is int and is_number(value), "a whole number (without a decimal point)"),
    "null": (lambda value: value is None, "null"),
    "number": (is_number, "a number"),
    "object": (lambda value: type(value) is dict, "an object"),
    "string": (lambda value: type(value) is str, "text in quotes"),
}
"""Of each type whether a value has it, and its name."""

BOUNDS: dict[str, tuple[Callable[[Any, Any], bool], str]] = {
    "exclusiveMinimum": (operator.gt, "too small; it must be above"),
    "exclusiveMaximum": (operator.lt, "too large; it must be below"),
    "minimum": (operator.ge, "too small; it must be at least"),
    "maximum": (operator.le, "too large; it must be at most"),
}
"""Of each bound how a value must lie to it, and what is wrong with one that does not."""


def problems_of(document: Any) -> list[str]:
    """List what is wrong with the structure as "place: what is wrong", at most one per place."""
    found: dict[str, str] = {}
    for steps, sentence in islice(_problems(document, _schema(), ()), MOST_PROBLEMS):
        where = place(steps)
        found.setdefault(where, f"{where}: {sentence}")
    return list(found.values())


def item_problems(values: list[Any], field: str, where: str) -> list[str]:
    """The same of the items of a list that an object has in such a field, which stands at `where`."""
    items = {"items": _schema()["$defs"]["object"]["properties"][field]["items"]}
    return [f"{where}{place(steps)}: {sentence}" for steps, sentence in _problems(values, items, ())]


def defaults(kind: str) -> dict[str, Any]:
    """Give the default of each optional field of the "scene", an "object", a "collider" or "selfCollision"."""
    schema = _schema() if kind == "scene" else _schema()["$defs"][kind]
    return {name: field["default"] for name, field in schema["properties"].items() if "default" in field}


def fields(kind: str) -> set[str]:
    """Names of the fields that the "scene", an "object", a "collider" or "selfCollision" may have."""
    schema = _schema() if kind == "scene" else _schema()["$defs"][kind]
    return set(schema["properties"])


def schema_path() -> Path:
    """Find the published schema: inside an installed package, beside the package in a checkout."""
    package = Path(__file__).resolve().parents[1]
    places = [folder / "schemas" / "scene.schema.json" for folder in (package, package.parent)]
    return next((path for path in places if path.is_file()), places[0])


@cache
def _schema() -> dict[str, Any]:
    schema: dict[str, Any] = json.loads(schema_path().read_text("utf-8"))
    return schema


def _problems(value: Any, schema: Schema, steps: Steps) -> Iterator[tuple[Steps, str]]:
    """What of a value, at a place in the document, breaks a schema: the places and sentences, in the schema's order."""
    kind = type(value)
    for rule, bound in schema.items():
        if rule in SAY_NOTHING:
            continue
        if rule == "$ref":
            yield from _problems(value, _schema()["$defs"][bound.removeprefix("#/$defs/")], steps)
        elif rule == "properties" and kind is dict:
            for name in (name for name in bound if name in value):
                where = (*steps, name)
                long = name in LONG_NAMES and ".".join(step for step in where if type(step) is str) in LONG_ARRAYS
                yield from _problems(value[name], LIST if long else bound[name], where)
        elif rule == "items" and kind is list:
            for i, item in enumerate(value):
                yield from _problems(item, bound, (*steps, i))
        elif rule == "if" and not any(_problems(value, bound, steps)):
            yield from _problems(value, schema["then"], steps)
        elif rule == "required" and kind is dict:
            yield from (((*steps, name), "is missing, and it has no default") for name in bound if name not in value)
        elif rule == "additionalProperties" and kind is dict and not bound:  # only a `fit` has a closed list of fields
            known, possible = schema["properties"], ", ".join(name for name in schema["properties"] if name != "bounds")
            strange = (name for name in value if name not in known)
            yield from (((*steps, named(name)), f"cannot be fitted; {possible} can") for name in strange)
        elif sentence := _sentence(rule, bound, value):
            yield steps, sentence


def _sentence(rule: str, bound: Any, value: Any) -> str | None:
    """What is wrong with a value by itself, None where it obeys a rule, or the rule is about other types."""
    match rule, value:
        case "type", _:
            types = [bound] if isinstance(bound, str) else bound
            if any(TYPES[one][0](value) for one in types):
                return None
            if {"number", "integer"}.intersection(types) and type(value) in (int, float) and not is_number(value):
                return f"{spelt(value)} is {NOT_FINITE}"
            said = f"{spelt(value)} is not {' or '.join(TYPES[one][1] for one in types)}"
            if types == ["object"] and isinstance(value, list) and len(value) == 3 and all(map(is_number, value)):
                return f"{said}; write {json.dumps(dict(zip('xyz', value, strict=True)))}"
            return said
        case "enum" | "const", _:
            items = bound if rule == "enum" else [bound]
            if not any(value == item and isinstance(value, bool) == isinstance(item, bool) for item in items):
                return f"{spelt(value)} is not one of {', '.join(map(spelt, items))}"
        case "minItems", list() if len(value) < bound:
            return f"has {len(value)} of {bound} items" if value else f"is empty; at least {bound} is needed"
        case "maxItems", list() if len(value) > bound:
            return f"has {len(value)} items; {bound} are needed"
        case "pattern" | "maxLength", str():
            if len(value) > bound if rule == "maxLength" else not re.search(bound, value):
                return f"{spelt(value)} is not two letters of n, F, R, M, G, L (masses, then stiffnesses)"
    if rule in BOUNDS and is_number(value) and not BOUNDS[rule][0](value, bound):
        return f"{spelt(value)} is {BOUNDS[rule][1]} {bound}"
    return None
