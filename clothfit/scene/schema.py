"""The structure of a scene document: which fields there are, of which type, the scalars within their bounds.

The rules and the defaults are those of `schemas/scene.schema.json`. A schema validator takes seconds on the long arrays
of a large cloth, so this module cuts their items out of document and schema, and checks only that they are lists;
`array_checks` checks the items.
Nearly every scene is valid, and loading the validator takes longer than reading a scene, so `conforms` looks first: its
yes is certain; its no means only that the validator must decide. So the few keywords of `RULES` are enough: any other
means no, and so does a value that differs in type from the listed one (1.0 and 1, true and 1).
Two types are stricter than in JSON Schema: a number is finite and within the range of doubles, and a whole number is
written without a decimal point.
"""

from __future__ import annotations

import copy
import json
import math
import re
from collections.abc import Callable, Collection
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

from clothfit.base.messages import named, place, shown

LONG_ARRAYS = (
    "vertPos", "vertIsFixed", "vertMass", "vertVel", "springs", "springStiffness", "springRestLength", "triangles",
)  # fmt: skip
LONG_PARTS = {"families": ("families", "springs"), "regions": ("region", "vertices")}
"""Fields of an object that have a long list in them, or in each of their items: its owner in the schema and name."""

MOST_PROBLEMS = 20
TYPE_NAMES = {
    "array": "a list",
    "boolean": "true or false",
    "integer": "a whole number (without a decimal point)",
    "null": "null",
    "number": "a number",
    "object": "an object",
    "string": "text in quotes",
}
BOUND_PROBLEMS = {
    "exclusiveMinimum": "too small; it must be above",
    "exclusiveMaximum": "too large; it must be below",
    "minimum": "too small; it must be at least",
    "maximum": "too large; it must be at most",
}


def problems_of(document: Any) -> list[str]:
    """List what is wrong with the structure as "place: what is wrong", at most one per place."""
    found: dict[str, str] = {}
    outline, schema = _outline(document), _schema_of_outlines()
    if conforms(outline, schema, schema):
        return []
    for error in islice(_validator().iter_errors(outline), MOST_PROBLEMS):
        for where, sentence in _problems(error):
            found.setdefault(where, f"{where}: {sentence}")
    return list(found.values())


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


@cache
def _validator() -> Any:
    import jsonschema  # type: ignore[import-untyped]  # here because importing it takes longer than reading a scene

    base = jsonschema.Draft202012Validator
    checker = base.TYPE_CHECKER.redefine("number", lambda _, value: TYPE_TESTS["number"](value))
    checker = checker.redefine("integer", lambda _, value: TYPE_TESTS["integer"](value))
    return jsonschema.validators.extend(base, type_checker=checker)(_schema_of_outlines())


@cache
def _schema_of_outlines() -> dict[str, Any]:
    schema: dict[str, Any] = copy.deepcopy(_schema())
    schema["$defs"]["object"]["properties"].update({name: {"type": "array"} for name in LONG_ARRAYS})
    for part, name in LONG_PARTS.values():
        schema["$defs"][part]["properties"][name] = {"type": "array"}
    return schema


def _outline(document: Any) -> Any:
    """Copy a document without the items of its long arrays."""
    if not isinstance(document, dict) or not isinstance(document.get("objects"), list):
        return document
    return {**document, "objects": [_short(item) for item in document["objects"]]}


def _short(item: Any) -> Any:
    if not isinstance(item, dict):
        return item
    made = _without(item, LONG_ARRAYS)
    for field, (_, name) in LONG_PARTS.items():
        if isinstance(owner := made.get(field), list):
            made[field] = [_without(each, (name,)) for each in owner]
        elif field in made:
            made[field] = _without(owner, (name,))
    return made


def _without(item: Any, names: Collection[str]) -> Any:
    """A copy of an object without the items of the lists of these names."""
    if not isinstance(item, dict):
        return item
    return {key: [] if key in names and isinstance(value, list) else value for key, value in item.items()}


def _problems(error: Any) -> list[tuple[str, str]]:
    """Turn an error of the validator into this program's sentences: pairs of place and sentence."""
    path = list(error.absolute_path)
    if error.validator == "required":  # the validator does not say which field, so name all of them
        missing = [name for name in error.validator_value if name not in error.instance]
        return [(place([*path, name]), "is missing, and it has no default") for name in missing]
    if error.validator == "additionalProperties":  # only a `fit` has a closed list of fields
        known = [name for name in error.schema["properties"] if name != "bounds"]
        strange = [name for name in error.instance if name not in error.schema["properties"]]
        return [(place([*path, named(name)]), f"cannot be fitted; {', '.join(known)} can") for name in strange]
    return [(place(path), _sentence(error.validator, error.validator_value, error.instance))]


def _sentence(rule: str, bound: Any, value: Any) -> str:
    match rule:
        case "type" if {"number", "integer"}.intersection(as_list(bound)) and is_beyond(value):
            return f"{shown(value)} is not a finite number within the range of doubles"
        case "type":
            return f"{shown(value)} is not {' or '.join(TYPE_NAMES[one] for one in as_list(bound))}"
        case "enum":
            return f"{shown(value)} is not one of {', '.join(map(shown, bound))}"
        case "exclusiveMinimum" | "exclusiveMaximum" | "minimum" | "maximum":
            return f"{shown(value)} is {BOUND_PROBLEMS[rule]} {bound}"
        case "minItems" if len(value):
            return f"has {len(value)} of {bound} items"
        case "minItems":
            return f"is empty; at least {bound} is needed"
        case "maxItems":
            return f"has {len(value)} items; {bound} are needed"
        case "pattern" | "maxLength":
            return f"{shown(value)} is not two letters of n, F, R, M, G, L (masses, then stiffnesses)"
    return f"{shown(value)} breaks the rule {rule} {shown(bound)}"


Schema = dict[str, Any]

SAY_NOTHING = frozenset({"$schema", "$id", "$defs", "title", "description", "default", "if"})  # `then`: always

TYPE_TESTS: dict[str, Callable[[Any], bool]] = {
    "array": lambda value: type(value) is list,
    "boolean": lambda value: type(value) is bool,
    "integer": lambda value: type(value) is int and is_number(value),
    "null": lambda value: value is None,
    "number": lambda value: is_number(value),
    "object": lambda value: type(value) is dict,
    "string": lambda value: type(value) is str,
}


def is_number(value: object) -> bool:
    """Whether a value is a finite number within the range of doubles; true and false are not."""
    try:
        return type(value) in (int, float) and math.isfinite(value)  # type: ignore[arg-type]
    except OverflowError:  # an integer beyond the range of doubles
        return False


def is_beyond(value: object) -> bool:
    """Whether a value is a number, but no finite one within the range of doubles."""
    return type(value) in (int, float) and not is_number(value)


def as_list(rule: str | list[str]) -> list[str]:
    """The types that a rule allows: one, or a list of them."""
    return [rule] if isinstance(rule, str) else rule


def conforms(value: Any, schema: Schema, root: Schema) -> bool:
    """Whether a value surely obeys a schema, part of the schema `root`."""
    for keyword, rule in schema.items():
        if keyword in SAY_NOTHING:
            continue
        check = RULES.get(keyword)
        if check is None or not check(value, rule, schema, root):
            return False
    return True


RULES: dict[str, Callable[[Any, Any, Schema, Schema], bool]] = {
    "$ref": lambda value, rule, _, root: conforms(value, root["$defs"][rule.removeprefix("#/$defs/")], root),
    "additionalProperties": lambda value, rule, schema, _: rule is True
    or (type(value) is dict and value.keys() <= schema["properties"].keys()),
    "enum": lambda value, rule, *_: any(type(value) is type(item) and value == item for item in rule),
    "exclusiveMaximum": lambda value, rule, *_: is_number(value) and value < rule,
    "exclusiveMinimum": lambda value, rule, *_: is_number(value) and value > rule,
    "items": lambda value, rule, _, root: type(value) is list and all(conforms(item, rule, root) for item in value),
    "maximum": lambda value, rule, *_: is_number(value) and value <= rule,
    "maxItems": lambda value, rule, *_: type(value) is list and len(value) <= rule,
    "maxLength": lambda value, rule, *_: type(value) is str and len(value) <= rule,
    "minItems": lambda value, rule, *_: type(value) is list and len(value) >= rule,
    "minimum": lambda value, rule, *_: is_number(value) and value >= rule,
    "pattern": lambda value, rule, *_: type(value) is str and re.search(rule, value) is not None,
    "properties": lambda value, rule, _, root: type(value) is not dict  # which another keyword allows or refuses
    or all(conforms(value[name], rule[name], root) for name in rule if name in value),
    "required": lambda value, rule, *_: type(value) is dict and all(name in value for name in rule),
    "then": lambda value, rule, _, root: conforms(value, rule, root),
    "type": lambda value, rule, *_: any(TYPE_TESTS[name](value) for name in as_list(rule)),
}
