"""Warnings about a fit before it begins: what no target can determine, and starts outside the bounds."""

from __future__ import annotations

from clothfit.base.arrays import Array
from clothfit.base.messages import owned
from clothfit.objective.identifiability import identifiable
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import bounds
from clothfit.scene.scene import Scene


def start_warnings(objective: Objective, p: Array) -> list[str]:
    """The warnings of a fit that starts at p (P,)."""
    return [*undetermined(objective.scene), *outside_bounds(objective, p)]


def undetermined(scene: Scene) -> list[str]:
    """Warnings of cloths whose fitted masses and stiffnesses the motion shows only up to a common factor.

    Weight, inertia, node damping and springs all scale with them, and so does air drag where it is fitted, too; only
    air drag that is known, and spheres, do not.
    """
    found = []
    for i, cloth in enumerate(() if scene.spheres else scene.cloths):
        if "n" in cloth.settings:
            continue
        if not cloth.feels_air:
            what = "feels neither air nor spheres, so its motion shows masses and stiffnesses"
        elif cloth.mode("drag") != "n":
            what = "feels no spheres, so its motion shows masses, stiffnesses and drag"
        else:
            continue
        found.append(f"objects[{i}] {what} only up to one common factor")
    return found


def outside_bounds(objective: Objective, p: Array) -> list[str]:
    """Warnings of starting values (P,) that the bounds will move."""
    lower, upper = bounds(objective.scene)
    outside = identifiable(objective.scene) & ((p < lower) | (p > upper))
    counts = [(block, int(outside[block.part].sum())) for block in objective.blocks]
    return [
        f"{owned(block.cloth, block.name)}: {count} of {block.count} starting values lie outside the bounds "
        f"{block.kind.lower:g} … {block.kind.upper:g} and start at the bound; the truth may lie outside as well"
        for block, count in counts
        if count
    ]
