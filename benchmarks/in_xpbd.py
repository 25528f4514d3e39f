"""What fits in the model of XPBD leave: `python benchmarks/in_xpbd.py [NAME …] [--count N]`, about a minute a cloth.

Of the examples and the N smallest generated cloths of `in_blender`, or those named, over 51 frames: the error of the
mapped values, of the few that are fitted, and of those of every constraint and vertex, in % of the way. Results go to
build/blender, a file a cloth; what is there is not done again.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import clothfit
from clothfit.simulators import xpbd
from clothfit.simulators.estimate import EACH, Options, estimate
from in_blender import kept, scenes

FRAMES = 51
SETTINGS = xpbd.Settings(substeps=1, iterations=5)


def fitted(scene: clothfit.Scene, steps: int) -> dict[str, Any]:
    """The errors of one cloth, with so many steps of each fit."""
    began = time.process_time()
    (one,) = estimate(replace(scene, frames=FRAMES), None, Options("xpbd", SETTINGS, most=steps, model=EACH))
    assert one.few is not None
    own = scene.cloths[0]
    return {
        "vertices": len(own.mass), "stiff": float(scene.delta**2 * own.stiffness.mean() / own.mass.mean()),
        "mapped": one.few.mapped_rmse / one.travel, "few": one.few.rmse / one.travel, "each": one.rmse / one.travel,
        "seconds": time.process_time() - began,
    }  # fmt: skip


def main() -> None:
    """Print the table."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("names", nargs="*", help="cloths, such as corners or generated-3")
    asked.add_argument("--count", type=int, default=20, help="generated cloths")
    asked.add_argument("--steps", type=int, default=40, help="of each descent")
    given = asked.parse_args()
    print("| cloth | vertices | h² k/m | mapped | few | each | times less |\n|---|---|---|---|---|---|---|")
    ratios = []
    for name, make in scenes(given.count):
        if given.names and name not in given.names:
            continue

        def compute(make: Callable[[], clothfit.Scene] = make) -> dict[str, Any]:
            return fitted(make(), given.steps)

        row = kept(f"xpbd-{name}", compute)
        ratios.append(row["mapped"] / row["each"])
        errors = " | ".join(f"{100 * row[kind]:.2f} %" for kind in ("mapped", "few", "each"))
        print(f"| {name} | {row['vertices']} | {row['stiff']:.0f} | {errors} | {ratios[-1]:.1f} |", flush=True)
    print(f"times less: median {np.median(ratios):.1f}, {min(ratios):.1f} to {max(ratios):.1f}")


if __name__ == "__main__":
    main()
