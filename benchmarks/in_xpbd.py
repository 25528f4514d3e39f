"""What fits in the model of XPBD leave: `python benchmarks/in_xpbd.py [NAME …] [--count N]`, minutes a cloth.

Of the examples and the N smallest generated cloths of `in_blender`, or those named, over 51 frames: the error of the
mapped values, of the few that are fitted, and, where there are at most 800, of those of every constraint and vertex, in
% of the way; and that of the first and the last in the 50 frames after those, which no fit has seen. Results go to
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
from clothfit.base.arrays import Array
from clothfit.simulators import xpbd
from clothfit.simulators.estimate import EACH, FEW, Options, estimate
from clothfit.simulators.values import MOST_ELEMENTS, rms
from in_blender import kept, scenes

FRAMES = 51
SETTINGS = xpbd.Settings(substeps=1, iterations=5)


def fitted(scene: clothfit.Scene, steps: int) -> dict[str, Any]:
    """The errors of one cloth, with so many steps of each fit."""
    began = time.process_time()
    model = EACH if len(xpbd.each_of(scene, 0, SETTINGS, 2).values) <= MOST_ELEMENTS else FEW
    (one,) = estimate(replace(scene, frames=FRAMES), None, Options("xpbd", SETTINGS, most=steps, model=model))
    few = one.few or one
    own = scene.cloths[0]
    return {
        "vertices": len(own.mass), "stiff": float(scene.delta**2 * own.stiffness.mean() / own.mass.mean()),
        "mapped": few.mapped_rmse / one.travel, "few": few.rmse / one.travel, "each": one.rmse / one.travel,
        "seconds": time.process_time() - began, **later(scene, model, one.found),
    }  # fmt: skip


def later(scene: clothfit.Scene, model: str, found: Array) -> dict[str, float]:
    """The errors of the mapped and of the found values after the frames of the fit; infinite where it runs away."""
    longer = replace(scene, frames=2 * FRAMES - 1)
    truth = clothfit.simulate(longer).positions
    own = longer, 0, SETTINGS, longer.frames
    tool = xpbd.each_of(*own).tool(longer.frames) if model == EACH else xpbd.tool_of(*own)

    def error(numbers: Array) -> float:
        made = tool.motion(numbers)
        return float("inf") if made is None else rms((made - truth)[FRAMES:]) / rms((truth - truth[0])[FRAMES:])

    return {"mapped later": error(np.array([value.mapped for value in tool.values])), "each later": error(found)}


def main() -> None:
    """Print the table."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("names", nargs="*", help="cloths, such as corners or generated-3")
    asked.add_argument("--count", type=int, default=20, help="generated cloths")
    asked.add_argument("--steps", type=int, default=40, help="of each descent")
    given = asked.parse_args()
    print("| cloth | vertices | h² k/m | mapped | few | each | times less | later: mapped | each |")
    print("|---|---|---|---|---|---|---|---|---|")
    ratios = []
    for name, make in scenes(given.count):
        if given.names and name not in given.names:
            continue

        def compute(make: Callable[[], clothfit.Scene] = make) -> dict[str, Any]:
            return fitted(make(), given.steps)

        row = kept(f"xpbd-{name}", compute)
        ratios.append(row["mapped"] / row["each"])
        errors = " | ".join(f"{100 * row[kind]:.2f} %" for kind in ("mapped", "few", "each"))
        after = " | ".join(f"{100 * row[kind]:.1f} %" for kind in ("mapped later", "each later"))
        cells = f"{row['vertices']} | {row['stiff']:.2g} | {errors} | {ratios[-1]:.1f} | {after}"
        print(f"| {name} | {cells} |", flush=True)
    print(f"times less: median {np.median(ratios):.1f}, {min(ratios):.1f} to {max(ratios):.1f}")


if __name__ == "__main__":
    main()
