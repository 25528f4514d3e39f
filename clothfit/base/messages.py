"""How messages name a place in a scene and show a value: short, on one line, whatever the value is."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence

LONGEST_VALUE = 40  # characters of a value in a message
ALIKE, FILE_ALIKE = 0.6, 0.85  # share of letters in order that two names have in common; those of files often do

ACTING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")
"""Characters that control a terminal or change the direction of writing; newlines and tabs are allowed."""


def spelt(value: object) -> str:
    """Show a JSON value as the file spells it; lists and objects by kind only, long values cut."""
    if isinstance(value, list):
        return "a list"
    if isinstance(value, dict):
        return "an object"
    text = json.dumps(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 3]}..."


LENGTHS = {"m": 1.0, "mm": 1e-3, "µm": 1e-6, "nm": 1e-9}
MASSES = {"t": 1e3, "kg": 1.0, "g": 1e-3, "mg": 1e-6, "µg": 1e-9}
"""Units, from the largest, in SI units."""


def harmless(text: str) -> str:
    """Write ? for each character that a terminal would act upon: names of files and titles may come from anybody."""
    return ACTING.sub("?", text)


def unreadable(error: BaseException) -> str:
    """Why a file cannot be read, after its name and a colon."""
    if isinstance(error, FileNotFoundError):
        return "there is no such file" + similar_file(error.filename)
    return f"cannot be read: {getattr(error, 'strerror', None) or error}"


def similar_file(path: object) -> str:
    """Ask about the file in the same folder whose name is much like that of one which is not there, if any."""
    folder, name = os.path.split(os.fsdecode(path) if isinstance(path, (str, bytes, os.PathLike)) else "")
    try:
        return meant(name, os.listdir(folder or "."), FILE_ALIKE) if name else ""
    except (OSError, ValueError):
        return ""


PLAIN = {
    "µ": "u", "→": "->", "…": "...", "×": "x", "±": "+-", "²": "^2", "³": "^3", "·": "*", "⁻": "^-", "≥": ">=",
    "≤": "<=", "°": "deg", "λ": "lambda", "τ": "tau", "σ": "sigma", "–": "-", "’": "'", "█": "#", "▇": "*", "▆": "+",
    "▅": "=", "▄": "-", "▃": ":", "▂": ".", "▁": "_",
}  # fmt: skip
"""How messages write their characters where only ASCII can be shown."""


def spelled(text: str, encoding: str | None) -> str:
    """A text as a stream of that encoding can hold it: `um` where it has no µ. Other characters stay."""

    def holds(character: str) -> bool:
        try:
            return bool(character.encode(encoding or "utf-8"))
        except (UnicodeEncodeError, LookupError):
            return False

    return "".join(each if holds(each) else PLAIN.get(each, each) for each in text)


def place(path: Iterable[str | int]) -> str:
    """Write a path of keys and indices as `objects[0].vertPos[5].y`; the empty path is "top level"."""
    steps = [f"[{step}]" if isinstance(step, int) else f".{step}" for step in path]
    return "".join(steps).removeprefix(".") or "top level"


def counted(count: int, one: str, many: str) -> str:
    """Write a count with its noun: `1 vertex`, `144 vertices`."""
    return f"{count} {one if count == 1 else many}"


def listed(names: Sequence[str]) -> str:
    """Write names with commas and an "and"."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def percent(fraction: float) -> str:
    """Write a fraction in percent with two digits."""
    return f"{100 * fraction:.2g} %" if fraction < 0.995 else f"{100 * fraction:.0f} %"


def spans(numbers: Iterable[int]) -> list[str]:
    """Write rising whole numbers with three or more successive ones as a span: `0`, `3-5`, `9`, `10`."""
    found: list[list[int]] = []
    for number in numbers:
        if found and number == found[-1][-1] + 1:
            found[-1].append(number)
        else:
            found.append([number])
    alone = [[f"{part[0]}-{part[-1]}"] if len(part) > 2 else [str(number) for number in part] for part in found]
    return [text for part in alone for text in part]


def owned(cloth: int | None, kind: str) -> str:
    """Write a kind of parameter with its owner: `objects[0] mass`, or `scene wind` for the scene as a whole."""
    return f"scene {kind}" if cloth is None else f"objects[{cloth}] {kind}"


def named(key: str) -> str:
    """Write a key as a step of a place: as it is when short and plain, else in quotes, escaped and cut."""
    return key if key.isidentifier() and key.isascii() and len(key) <= LONGEST_VALUE else spelt(key)


def metres(value: float) -> str:
    """Write a length in the unit that suits its size."""
    return _in_units(value, LENGTHS)


def kilograms(value: float) -> str:
    """Write a mass in the unit that suits its size."""
    return _in_units(value, MASSES)


def _in_units(value: float, units: Mapping[str, float]) -> str:
    """Write a number in the largest unit that it has one of, or in the smallest."""
    unit = next((unit for unit, size in units.items() if value >= size), [*units][-1])
    return f"{value / units[unit]:.3g} {unit}"


def meant(wrong: str, names: Iterable[str], alike: float = ALIKE) -> str:
    """Ask about the name that was probably meant, if any: `; did you mean estimate?`."""
    from difflib import get_close_matches  # loaded only after a slip, as every command should start quickly

    known = {name.lower().lstrip("-"): name for name in names}  # dashes would make all short options alike
    lower = wrong.lower().lstrip("-")
    begins = [name for name in known if len(lower) > 1 and name.startswith(lower)]
    swapped = [name for name in known if sorted(name) == sorted(lower)]  # --rsme is --rmse sooner than --resume
    best = [*begins, *swapped, *get_close_matches(lower, known, 1, alike)][:1]
    return f"; did you mean {known[best[0]]}?" if best else ""
