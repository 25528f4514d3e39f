"""Print how much memory a fit takes: `python benchmarks/memory.py [METHOD …]`, by default of 64² vertices, 1000 frames.

A level cloth of N × N vertices over 7 m, held at one side: one stiffness per spring, fitted to its own motion. Each row
is a process of its own, that of the command as users run it, with its peak of resident memory; the first two are a
gradient with everything in memory and with the budget, and whether they are the same to the last bit. Linear systems
are solved to 1e-5, as for playing, so that it takes minutes, not an hour.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import clothfit
from clothfit.meshes.mesh import Mesh, object_document, plane

TOLERANCE = 1e-5
NO_LIMIT = "1e18"  # bytes: everything is kept


def scene(vertices: int, frames: int) -> dict[str, object]:
    """The document of the cloth."""
    mesh: Mesh = plane(vertices - 2, 7.0)
    fixed = mesh.positions[:, 2] == mesh.positions[:, 2].max()
    cloth = object_document(mesh, fixed, density=0.1, stiffness=50.0, damping=0.1, drag=0.1, settings="nL")
    fields = {"integrationMethod": 2, "delta": 0.02, "tolerance": TOLERANCE, "optimizationIterations": frames}
    return {**fields, "objects": [cloth], "colliders": []}


def gradient(path: str, target: str, memory: str, out: str) -> None:
    """Write cost and gradient beside the scene's values, as a process of its own does; print what it took."""
    made = clothfit.load(path)
    guess = clothfit.with_parameters(made, 1.1 * clothfit.parameters(made))
    motion = clothfit.load_motion(target, made)
    aim = clothfit.Objective(guess, motion, TOLERANCE, memory=memory)
    cost, slope = aim.cost_and_gradient(clothfit.parameters(guess))
    np.save(out, np.append(slope, cost))
    print(json.dumps(aim.needs.summary()))


def child(arguments: list[str]) -> tuple[str, float]:
    """Run Python in a process of its own; its standard output, and its peak of resident memory, MB."""
    with tempfile.TemporaryFile() as out, subprocess.Popen([sys.executable, *arguments], stdout=out) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        return out.read().decode(), used.ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6


def row(name: str, arguments: list[str]) -> None:
    """Run one child and print its row."""
    text, peak = child(arguments)
    summary = json.loads(text.splitlines()[-1]) if text.strip() else {}
    needs = summary.get("memory") or summary
    sizes = [needs.get(key) for key in ("foreseen", "budget")]
    numbers = [f"{size / 1e6:.0f}" if size and size < float(NO_LIMIT) else "–" for size in sizes]
    kept = (needs["snapshots"] or "all states") if needs else "–"
    print(f"| {name} | {' | '.join(numbers)} | {kept} | {peak:.0f} |", flush=True)


def warm_up(folder: str) -> None:
    """Compile everything, on a small cloth: a process that compiles takes 100 MB more."""
    path, target, out = (str(Path(folder) / name) for name in ("small.json", "small.npz", "small.npy"))
    Path(path).write_text(json.dumps(scene(4, 8)), encoding="utf-8")
    child(["-m", "clothfit", "simulate", path, "-o", target, "-q"])
    child([__file__, "--gradient", path, target, NO_LIMIT, out])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Print how much memory a fit takes.")
    parser.add_argument("--vertices", type=int, default=64)
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--memory", default="200MB")
    parser.add_argument("--gradient", nargs=4, help=argparse.SUPPRESS)
    parser.add_argument("methods", nargs="*", default=["l-bfgs-b", "auto"])
    given = parser.parse_args()
    if given.gradient:
        gradient(*given.gradient)
        return
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    print(f"{given.vertices}² vertices, {given.frames} frames; this program with its libraries alone: {own:.0f} MB")
    print("| what | foreseen, MB | budget, MB | snapshots | peak, MB |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        warm_up(folder)
        path, target = (str(Path(folder) / name) for name in ("grid.json", "grid.npz"))
        Path(path).write_text(json.dumps(scene(given.vertices, given.frames)), encoding="utf-8")
        found = [str(Path(folder) / f"{name}.npy") for name in ("whole", "short")]
        row("`simulate`", ["-m", "clothfit", "simulate", path, "-o", target, "-q"])
        for out, size in zip(found, (NO_LIMIT, given.memory), strict=True):
            name = "no limit" if size == NO_LIMIT else f"`--memory {size}`"
            row(f"gradient, {name}", [__file__, "--gradient", path, target, size, out])
        same = np.array_equal(*(np.load(out) for out in found))
        command = ["estimate", path, "--target", target, "--start", "20", "--tolerance", str(TOLERANCE), "-q", "--json"]
        for method in given.methods:
            options = ["--method", method, "--max-evaluations", "2", "--memory", given.memory, "-o", f"{path}.out"]
            row(f"`estimate --method {method}`, 2 evaluations", ["-m", "clothfit", *command, *options])
    print(f"\ngradients bit-equal: {'yes' if same else 'NO'}")


if __name__ == "__main__":
    main()
