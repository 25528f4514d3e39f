"""The colours of all pictures: "#rrggbb" for what is drawn as it is, (red, green, blue) in 0 … 1 for what is shaded.

Lines have the colours of M. Okabe and K. Ito, which people with any kind of colour vision can tell apart.
"""

from __future__ import annotations

from typing import TypeAlias

Colour: TypeAlias = tuple[float, float, float]

BLUE, ORANGE, GREEN, PURPLE, RED, SKY = "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9"

INK, QUIET = "#222222", "#767676"
"""Text, and text of less weight."""

GROUND, FIXED_VERTEX = "#f3f5f8", "#c22f2f"

CLOTHS = ((0.36, 0.51, 0.74), (0.83, 0.55, 0.36), (0.58, 0.45, 0.70), (0.75, 0.65, 0.33), (0.44, 0.47, 0.52))
"""Colours of the objects, in turn."""

TARGET_COLOUR, SPHERE_COLOUR = (0.10, 0.68, 0.33), (0.72, 0.72, 0.76)

NOT_IDENTIFIABLE = "#c4c8cf"
"""Parameters in a map that the motion does not determine."""
