"""Whether a JSON document surely obeys a schema: a quick check before a validator is loaded.

Nearly every scene is valid, and loading the validator takes longer than reading a scene. The answer yes is certain; no
means only that the validator must decide. So the few keywords below are enough: any other keyword means no, and so does
a value that differs in type from the listed one (1.0 and 1, true and 1).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

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


def _reference(value: Any, rule: str, _: Schema, root: Schema) -> bool:
    kind, name = rule.rsplit("/", 1)
    return kind == "#/$defs" and conforms(value, root["$defs"][name], root)


def _properties(value: Any, rule: Schema, _: Schema, root: Schema) -> bool:
    if type(value) is not dict:  # which another keyword allows or refuses
        return True
    return all(conforms(value[name], rule[name], root) for name in rule if name in value)


def _closed(value: Any, rule: bool, schema: Schema, _: Schema) -> bool:
    return rule is True or (type(value) is dict and value.keys() <= schema["properties"].keys())


def _items(value: Any, rule: Schema, _: Schema, root: Schema) -> bool:
    return type(value) is list and all(conforms(item, rule, root) for item in value)


def _listed(value: Any, rule: list[Any], *_: Schema) -> bool:
    return any(type(value) is type(item) and value == item for item in rule)


RULES: dict[str, Callable[[Any, Any, Schema, Schema], bool]] = {
    "$ref": _reference,
    "additionalProperties": _closed,
    "enum": _listed,
    "exclusiveMaximum": lambda value, rule, *_: is_number(value) and value < rule,
    "exclusiveMinimum": lambda value, rule, *_: is_number(value) and value > rule,
    "items": _items,
    "maximum": lambda value, rule, *_: is_number(value) and value <= rule,
    "maxItems": lambda value, rule, *_: type(value) is list and len(value) <= rule,
    "maxLength": lambda value, rule, *_: type(value) is str and len(value) <= rule,
    "minItems": lambda value, rule, *_: type(value) is list and len(value) >= rule,
    "minimum": lambda value, rule, *_: is_number(value) and value >= rule,
    "pattern": lambda value, rule, *_: type(value) is str and re.search(rule, value) is not None,
    "properties": _properties,
    "required": lambda value, rule, *_: type(value) is dict and all(name in value for name in rule),
    "then": lambda value, rule, _, root: conforms(value, rule, root),
    "type": lambda value, rule, *_: any(TYPE_TESTS[name](value) for name in as_list(rule)),
}
