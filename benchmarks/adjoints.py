"""Print what the exact adjoint is worth: `python benchmarks/adjoints.py [angles] [descents] [memory] [options]`.

Beside it stands the adjoint of textbooks (`approximate.py`). The task is that of `open_loop.py`: a
cloth of 12 × 12 vertices, by forces on all of them, to be a wave at half of the time and where it began at its end.

angles     the two gradients at the start, no forces: the angle between them, the ratio of their lengths, and the slope
           along the approximate one as central differences of the simulation measure it, and as either foretells it;
           `off` is how far the exact gradient is from differences along itself and along the approximate one; the
           second angle is that of an approximate one that has all of ∂f/∂x where x̂ is found, drag and damping with it
descents   three descents with either gradient, and what `clothfit control` makes of the same task in its closed loop
memory     a gradient by this program, which keeps states and assembles matrices again, beside one by a program that
           keeps the matrix of every step (SciPy's, with a factorisation of each); each in a process of its own

Seconds are those of the process, on one thread, compiled beforehand.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np

import clothfit
from clothfit.base import threads
from clothfit.base.arrays import Array
from clothfit.control import closed_loop
from clothfit.control.control import find_forces
from clothfit.control.keyframes import Key
from clothfit.scene.scene import Scene
from measure import machine
from open_loop import GAMMA, METHODS, SWEEPS, Descent, Task
from stored_matrices import memory, stored, swept

EXAMPLES = Path(__file__).parent.parent / "examples"
FROM_EDITOR = EXAMPLES.parent.parent / "shared" / "scenes" / "side.txt"
"""A scene that the editor wrote; left out where it is not there."""

TIGHT = 1e-13
PARTS = ("angles", "descents", "memory")


def scenes() -> dict[str, Scene]:
    """The scenes, and the flag in a tenth of its wind."""
    found = {name: clothfit.load(EXAMPLES / f"{name}.json") for name in ("flag", "side", "drape")}
    found["flag, 15 m/s"] = replace(found["flag"], wind=0.1 * found["flag"].wind)
    if FROM_EDITOR.exists():
        found["side.txt"] = clothfit.load(FROM_EDITOR)
    return found


def slope(task: Task, direction: Array, scale: float) -> float:
    """The derivative of the cost at no forces along a direction, by differences of fourth order: of steps from `scale`
    down by tens that whose value changes least to the next.
    """

    def cost(t: float) -> float:
        u = t * direction
        return task.cost(u, task.simulated(u, TIGHT))

    found = []
    for power in range(7):
        t = scale * 10.0**-power
        found.append((8 * (cost(t) - cost(-t)) - (cost(2 * t) - cost(-2 * t))) / (12 * t))
    changes = np.abs(np.diff(found))
    return float(found[int(np.nanargmin(np.where(np.isfinite(changes), changes, np.inf)))])


def between(a: Array, b: Array) -> tuple[float, float]:
    """The cosine of the angle between two arrays, and the angle in degrees."""
    cosine = float(np.vdot(a, b) / np.linalg.norm(a) / np.linalg.norm(b))
    return cosine, float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def angles(frames: list[int]) -> None:
    """Print how the approximate gradient lies beside the exact one."""
    print("| scene | frames | angle | with all of ∂f/∂x | length ratio | slope measured | exact | approximate | off |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, scene in scenes().items():
        for steps in frames:
            task = Task(scene, steps)
            nothing = np.zeros((steps, *task.system.x0.shape))
            motion = task.simulated(nothing, TIGHT)
            assert motion is not None
            found = {kind: task.gradient(sweep, nothing, motion, TIGHT) for kind, sweep in SWEEPS.items()}
            size = {kind: float(np.linalg.norm(each)) for kind, each in found.items()}
            cosine, angle = between(found["exact"], found["approximate"])
            weight = np.zeros_like(motion.x)
            weight[task.keys] = 2.0 * task.missed(motion)
            best = between(found["exact"], swept(task, motion, stored(task, motion), weight, whole=True))[1]
            scale = 1e-2 * max(float(np.sqrt(task.cost(nothing, motion))), 1e-3) / size["exact"]
            along, across = (slope(task, found[kind] / size[kind], scale) for kind in ("exact", "approximate"))
            off = max(abs(size["exact"] / along - 1.0), abs(cosine * size["exact"] - across) / size["exact"])
            ratio = size["approximate"] / size["exact"]
            print(
                f"| {name} | {steps} | {angle:.1f}° | {best:.1f}° | {ratio:.3g} | {across:.4g} | "
                f"{cosine * size['exact']:.4g} | {size['approximate']:.4g} | {off:.0e} |",
                flush=True,
            )


def descents(name: str, frames: list[int], seconds: float) -> None:
    """Print what the descents come to."""
    scene = scenes()[name]
    print(f"{name}; γ = {GAMMA:g} m²/(N² s), at most {seconds:g} s each\n")
    print("| frames | descent | gradient | iterations | simulations | sweeps | seconds | cost, m² | of the first |"
          " ended by |\n|---|---|---|---|---|---|---|---|---|---|")  # fmt: skip
    for steps in frames:
        task = Task(scene, steps)
        for method, descend in METHODS.items():
            for kind, sweep in SWEEPS.items():
                descent = Descent(task, sweep, seconds)
                first = descent.values[0]
                found = descend(descent)
                spent = time.process_time() - descent.began
                print(
                    f"| {steps} | {method} | {kind} | {found.iterations} | {task.simulations} | {task.products} | "
                    f"{spent:.1f} | {found.cost:.4g} | {found.cost / first:.1e} | {found.ended} |",
                    flush=True,
                )
        for kind in SWEEPS:
            controlled(scene, task, kind, seconds, first)


def controlled(scene: Scene, task: Task, kind: str, seconds: float, first: float) -> None:
    """Print the row of `clothfit control`, which holds the keys by springs: cost counts what it misses as well."""
    keys = [
        Key(step, 0, np.flatnonzero(task.free).astype(np.int32), wanted[task.free])
        for step, wanted in zip(task.keys, task.wanted, strict=True)
    ]
    began = time.process_time()
    with mock.patch.object(closed_loop, "adjoint", SWEEPS[kind]):
        found = find_forces(scene, keys, budget=seconds)
    spent = time.process_time() - began
    u = found.forces.values[:, scene.vertices(0)]
    cost = task.cost(u, task.simulated(u, scene.tolerance))
    print(
        f"| {task.steps} | `clothfit control` | {kind} | – | {found.evaluations} | {found.evaluations} | {spent:.1f} | "
        f"{cost:.4g} | {cost / first:.1e} | {found.status} |",
        flush=True,
    )


def main() -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(description="Print what the exact adjoint is worth.")
    parser.add_argument("parts", nargs="*", default=PARTS, metavar="PART", help=f"default: {', '.join(PARTS)}")
    parser.add_argument("--frames", type=int, nargs="+", default=[20, 50, 100, 200])
    parser.add_argument("--scene", default="flag", help="of the descents: flag, side, drape, …  (default: flag)")
    parser.add_argument("--steps", type=int, nargs="+", default=[20, 50, 100], help="of the descents")
    parser.add_argument("--seconds", type=float, default=60.0, help="for each descent (default: 60)")
    parser.add_argument("--vertices", type=int, nargs="+", default=[12, 64], help="along a side, for memory")
    given = parser.parse_args()
    with threads.single():
        print(f"{machine()}; one thread\n")
        if "angles" in given.parts:
            angles(given.frames)
        if "descents" in given.parts:
            descents(given.scene, given.steps, given.seconds)
        if "memory" in given.parts:
            memory(given.vertices, 100)


if __name__ == "__main__":
    main()
