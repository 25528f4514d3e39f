"""Print what a step of second order gains: `python benchmarks/second_order.py [SCENE …] [--frames 100] [--json]`.

Each scene (default: examples/side.json and examples/corners.json) is moved without wind, in steps of its delta and in
halves, quarters and eighths of it, by implicit Euler and by BDF2, and compared at its frames with the motion of h → 0
(`evaluation.reference`): error, root mean square over vertices and frames, m; order, from two steps that follow each
other. Times are those of bare steps on one thread, compiled, the two integrators in turn, medians; the last lines
compare the exact gradient along a direction with a central difference.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import clothfit
from clothfit.base import threads
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.evaluation.reference import converged

if TYPE_CHECKING:
    from clothfit.base.arrays import Array
    from clothfit.scene.scene import Scene

EXAMPLES = Path(__file__).parent.parent / "examples"
INTEGRATORS = ("implicit", "bdf2")
HALVES = (1, 2, 4, 8)
TIGHT = 1e-10
ROUNDS = 15


@dataclass(frozen=True)
class Row:
    """An integrator with so many steps per frame."""

    integrator: str
    steps: int  # per frame
    rmse: float  # m
    order: float | None  # against twice as long steps
    microseconds: float  # of a step
    euler: int  # steps of a BDF2 motion that are implicit steps


def still(path: Path) -> Scene:
    """A scene without wind."""
    return replace(clothfit.load(path), wind=np.zeros(3))


def compared(scene: Scene, frames: int) -> list[Row]:
    """The rows of a scene."""
    exact, found = converged(scene, frames, error=1e-6).positions, []
    for integrator in INTEGRATORS:
        before: float | None = None
        for k in HALVES:
            finer = scene.with_step(scene.delta / k, (frames - 1) * k + 1, integrator)
            gap = clothfit.simulate(finer, tolerance=TIGHT).positions[::k] - exact
            rmse = float(np.sqrt((gap**2).sum(axis=2).mean()))
            order = None if before is None else float(np.log2(before / rmse))
            memory, _ = rollout(build(finer, 0), (frames - 1) * k, TIGHT)
            found.append(Row(integrator, k, rmse, order, 0.0, int(memory.euler.sum())))
            before = rmse
    times = timed(scene, frames)
    return [replace(row, microseconds=times[row.steps][row.integrator]) for row in found]


def timed(scene: Scene, frames: int) -> dict[int, dict[str, float]]:
    """µs of a step of each integrator at each number of steps per frame, with the scene's tolerance."""
    found: dict[int, dict[str, float]] = {}
    for k in HALVES:
        count = (frames - 1) * k
        systems = {name: build(scene.with_step(scene.delta / k, count + 1, name), 0) for name in INTEGRATORS}
        seconds: dict[str, list[float]] = {name: [] for name in INTEGRATORS}
        for _ in range(ROUNDS):
            for name, system in systems.items():
                began = time.process_time()
                rollout(system, count, scene.tolerance)
                seconds[name].append(time.process_time() - began)
        found[k] = {name: float(np.median(each)) / count * 1e6 for name, each in seconds.items()}
    return found


def gradient_error(scene: Scene, frames: int) -> float:
    """Difference of the exact derivative along a direction from the central difference, relative."""
    bdf2 = scene.with_step(scene.delta, frames, "bdf2")
    p = clothfit.parameters(bdf2)
    rng = np.random.default_rng(0)
    target = clothfit.simulate(clothfit.with_parameters(bdf2, p * rng.uniform(0.8, 1.2, len(p))), tolerance=1e-13)
    d: Array = p * rng.normal(size=len(p)) / np.sqrt(len(p))

    def cost(t: float) -> float:
        return float(clothfit.cost_and_gradient(clothfit.with_parameters(bdf2, p + t * d), target, 1e-13)[0])

    t = 1e-5
    measured = (8 * (cost(t) - cost(-t)) - (cost(2 * t) - cost(-2 * t))) / (12 * t)  # of fourth order
    gradient = clothfit.cost_and_gradient(bdf2, target, 1e-13)[1]
    return abs(float(gradient @ d) / measured - 1)


def main() -> None:
    """Print a table for each scene."""
    parser = argparse.ArgumentParser(description="Print what a step of second order gains.")
    parser.add_argument("scenes", nargs="*", type=Path, default=[EXAMPLES / "side.json", EXAMPLES / "corners.json"])
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found: dict[str, Any] = {}
    with threads.single():
        for path in options.scenes:
            scene = still(path)
            rows, error = compared(scene, options.frames), gradient_error(scene, options.frames)
            found[path.stem] = {"rows": [vars(row) for row in rows], "gradient_error": error}
            if not options.json:
                show(path.stem, rows, error)
    if options.json:
        print(json.dumps(found))


def show(name: str, rows: list[Row], error: float) -> None:
    """Print the table of a scene."""
    print("| scene | integrator | steps per frame | RMSE | order | µs per step |\n|---|---|---|---|---|---|")
    for row in rows:
        order = "" if row.order is None else f"{row.order:.2f}"
        cells = (name, row.integrator, str(row.steps), f"{1e3 * row.rmse:.3g} mm", order, f"{row.microseconds:.1f}")
        print(f"| {' | '.join(cells)} |")
    pairs = zip(rows[: len(HALVES)], rows[len(HALVES) :], strict=True)
    print("time of a step, BDF2 to implicit:", ", ".join(f"{b.microseconds / a.microseconds:.2f}" for a, b in pairs))
    print(f"gradient of BDF2 against central differences: {error:.1e}")


if __name__ == "__main__":
    main()
