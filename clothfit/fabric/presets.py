"""Real fabrics: what is known of them, each number with its source; and how a cloth compares with them.

`presets.json` holds the fabrics in SI units. A number that no trustworthy source gives is None.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from math import exp, log
from typing import Any

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import meant
from clothfit.fabric.fabric import Fabric

Values = tuple[float | None, float | None, float | None]

LIKE = 1.5
"""Factor within which two stiffnesses are alike."""

WOVEN = "woven"


@dataclass(frozen=True)
class Preset:
    """A real fabric. Directions are warp, weft and bias."""

    name: str
    description: str
    kind: str  # woven, knit, nonwoven, laminate; empty: not told
    density: float | None  # kg/m²
    stretch: Values  # N/m
    bending: Values  # N m
    ranges: dict[str, list[float]]  # "density", "stretch", "bending": least and most of what was measured
    source: dict[str, str]  # of "density", "stretch" and "bending", where they are known

    def full(self, name: str) -> tuple[float, float, float] | None:
        """Stretch or bending in three directions, None where nothing is known of it. A bias that is not known is that
        of a cloth that is alike in all directions: the mean of the others.
        """
        values: Values = getattr(self, name)
        warp, weft, bias = values
        if warp is None or weft is None:
            return None
        return warp, weft, (warp + weft) / 2 if bias is None else bias


@lru_cache(maxsize=1)
def _file() -> dict[str, Any]:
    found: dict[str, Any] = json.loads((files("clothfit.fabric") / "presets.json").read_text("utf-8"))
    return found


def presets() -> tuple[Preset, ...]:
    """All fabrics, in the order of the file."""
    parts = _file()["sources"]
    return tuple(
        Preset(**{**each, "stretch": tuple(each["stretch"]), "bending": tuple(each["bending"]),
                  "source": {what: parts[key] for what, key in each["source"].items()}})
        for each in _file()["fabrics"]
    )  # fmt: skip


def preset(name: str) -> Preset:
    """The fabric of this name. Raises InvalidInput."""
    found = {each.name: each for each in presets()}
    if name not in found:
        raise InvalidInput(f"fabric: there is no {name!r}; `clothfit fabrics` lists them{meant(name, list(found))}")
    return found[name]


def mean(values: Values) -> float | None:
    """The geometric mean of the stiffnesses along warp and weft; None where one is unknown, or nothing resists."""
    warp, weft, _ = values
    return exp((log(warp) + log(weft)) / 2) if warp and weft and min(warp, weft) > 0 else None


def standing(own: Fabric, bends: bool = True, stretches: bool = True, sure: float | None = None) -> list[str]:
    """Where a cloth stands among real fabrics: parts of a sentence, of those properties that are to be told. Of a
    stretch whose stiffness is only known to be more than the share `sure` of what it is, only that it is so little.
    """
    usual, parts = _file()["usual"], []
    low, high = usual["density"]
    if not low <= own.density <= high:
        parts.append(f"{'lighter' if own.density < low else 'heavier'} than 95 % of real fabrics")
    bending, stretch = mean(own.bending), mean(own.stretch)
    if bends and own.bends and bending is not None:
        low, high = usual["bending"]
        if low <= bending <= high:
            parts.append(f"bends like {_nearest('bending', bending).name}")
        else:
            parts.append(f"{'limper' if bending < low else 'stiffer'} in bending than 95 % of real fabrics")
    if stretches and stretch is not None:
        known = [(each.kind, mean(each.stretch)) for each in presets()]
        woven = [value for kind, value in known if kind == WOVEN and value]
        every = [value for _, value in known if value]
        near = _nearest("stretch", stretch)
        if sure is not None:
            parts += ["stretches at most as woven cloth does"] * (sure * stretch >= min(woven) / LIKE)
        elif stretch < min(every) / LIKE:
            parts.append("stretches more than any fabric that is listed")
        elif stretch > max(every) * LIKE:
            parts.append("stretches less than any fabric that is listed")
        elif stretch < min(woven) / LIKE:
            parts.append(f"stretches more than any woven cloth that is listed, like {near.name}")
        else:
            parts.append(f"stretches like {near.name}")
    return parts


def _nearest(name: str, value: float) -> Preset:
    """The fabric whose mean stiffness is nearest, as a ratio."""
    known = [(each, mean(getattr(each, name))) for each in presets()]
    return min(((each, own) for each, own in known if own), key=lambda pair: abs(log(pair[1] / value)))[0]


def sentence(own: Fabric, bends: bool = True, stretches: bool = True, sure: float | None = None) -> str | None:
    """The same as a sentence; None where there is nothing to tell."""
    parts = standing(own, bends, stretches, sure)
    return f"as a fabric it {_joined(parts)}" if parts else None


def _joined(parts: list[str]) -> str:
    terms = [f"is {each}" if each.split()[0] in ("lighter", "heavier", "limper", "stiffer") else each for each in parts]
    return terms[0] if len(terms) == 1 else f"{', '.join(terms[:-1])} and {terms[-1]}"
