"""What keeps Blender's cloth from a scene: `python benchmarks/blender_limits.py [NAME …]`, examples or generated seeds.

Each thing that Blender's cloth does not have is left out of the scene alone and the scene simulated here, without
Blender: how far the motion of 51 frames is off, root mean squares in % of the way. NAME is an example or a seed of
`in_blender.generated`.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np

import clothfit
from clothfit.base.arrays import Array, Indices
from clothfit.export.blender import painted
from clothfit.export.topology import edge_stiffness, roles
from clothfit.scene.cloth import Cloth
from in_blender import EXAMPLES, FITTED, ROOT, generated

NAMES = ("corners", "side", "72", "25", "56", "60", "80", "46", "79")


def by_weights(count: int, ends: Indices, values: Array) -> Array:
    """Stiffnesses as weights of so many vertices make them."""
    found = painted(count, ends, values)
    assert found is not None
    made: Array = found.low + (found.high - found.low) * found.weights[ends].mean(axis=1)
    return made


def lacks(own: Cloth) -> dict[str, dict[str, Any]]:
    """What of a cloth is other in Blender, one thing at a time."""
    role, count = roles(own), len(own.mass)
    edges = ~role.bending
    along = own.stiffness.copy()
    along[edges] = by_weights(count, own.springs[edges], along[edges])
    bare = {"springs": own.springs[edges], "rest": own.rest[edges], "stiffness": edge_stiffness(own, role)[edges]}
    return {
        "one mass": {"mass": np.full(count, own.mass.mean())},
        "weights for springs along edges": {"stiffness": along},
        "no springs across edges": bare,
        "the same weights for springs across edges": {"stiffness": by_weights(count, own.springs, own.stiffness)},
    }


def main(names: list[str]) -> None:
    """Print the table."""
    for number, name in enumerate(names or NAMES):
        scene = clothfit.load(ROOT / "examples" / f"{name}.json") if name in EXAMPLES else generated(int(name))
        scene = replace(scene, frames=FITTED)
        (own,) = scene.cloths
        here = clothfit.simulate(scene).positions
        travel, cells = np.linalg.norm(here - here[0]), []
        for change in lacks(own).values():
            there = clothfit.simulate(replace(scene, cloths=(replace(own, **change),))).positions
            cells.append(f"{100 * np.linalg.norm(there - here) / travel:.1f} %")
        if not number:
            print(f"| cloth | {' | '.join(lacks(own))} |\n|---|" + len(cells) * "---|")
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
