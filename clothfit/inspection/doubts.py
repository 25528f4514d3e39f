"""Doubts about units: cloths and motions that are too large, too small, too heavy or too light to be meant."""

from __future__ import annotations

from collections.abc import Sequence

from clothfit.base.messages import kilograms, metres

LENGTHS = (1e-3, 100.0)  # m, of the largest side: a doll's handkerchief, a circus tent
MASSES = (1e-6, 1e4)  # kg


def doubts(size: Sequence[float], mass: float | None = None) -> list[str]:
    """A sentence for each thing that is hard to believe: `size` the sides of the bounding box, m; mass, kg."""
    found = []
    longest = max(size, default=0.0)
    if longest > 0 and not LENGTHS[0] <= longest <= LENGTHS[1]:
        found.append(f"it is {metres(longest)} across; is the unit right (--scale)?")
    if mass is not None and mass > 0 and not MASSES[0] <= mass <= MASSES[1]:
        found.append(f"it weighs {kilograms(mass)}; are size and mass per area right?")
    return found


def extent(size: Sequence[float]) -> str:
    """The sides of a bounding box, m, for people."""
    return f"{' × '.join(f'{side:.4g}' for side in size)} m"
