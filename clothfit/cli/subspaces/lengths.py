"""Lengths with their units, as options have them."""

from __future__ import annotations

from clothfit.base.errors import InvalidInput


def length(text: str | None, option: str) -> float | None:
    """A length in m from a text such as 5mm, 0.5cm, 0.005 or 0.005m. Raises InvalidInput."""
    if text is None:
        return None
    for unit, size in (("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("", 1.0)):
        if text.strip().endswith(unit):
            try:
                return float(text.strip().removesuffix(unit)) * size
            except ValueError:
                break
    raise InvalidInput(f"{option}: {text!r} is no length; write it as 5mm, 0.5cm or 0.005")
