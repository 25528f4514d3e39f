"""Print exact fits of large sheets: `python benchmarks/sheets.py [SIDE …]`, by default 40 50 60.

Sheets of SIDE² vertices over 2.1 × 2.1 m, held at one side, with BDF2 steps of 20 ms: one mass for each vertex and one
stiffness for each spring from 99 frames of their own motion, all stiffnesses begun at 20 N/m. Six of each size: of one
material, of two, and in wind, and the same with targets that are rounded to 0.1 µm. Seconds are of the processor;
kernels are compiled beforehand by a small sheet.
"""

from __future__ import annotations

import argparse
import io
import json
import resource
from dataclasses import replace
from typing import Any

import numpy as np

import clothfit
from clothfit.meshes.mesh import object_document, plane, springs

KINDS = {
    "": "one material", "two": "two", "wind": "in wind", "round": "rounded to 0.1 µm", "two round": "two, rounded",
    "wind round": "in wind, rounded",
}  # fmt: skip
SIZE, START, FRAMES, TOLERANCE = 2.1, 20.0, 99, 1e-10  # m; N/m; of the linear systems


def sheet(side: int, kind: str) -> Any:
    """A sheet of side × side vertices."""
    mesh = plane(side - 2, SIZE)
    made, z = springs(mesh, 1.0), mesh.positions[:, 2]
    stiffness = np.where(made.bends, 12.5, 50.0)
    if "two" in kind:
        across = mesh.positions[made.ends].mean(axis=1)[:, 0]
        stiffness = np.where(across > np.median(mesh.positions[:, 0]), 3.0, 1.0) * stiffness
    cloth = object_document(mesh, z == z.max(), density=0.1, stiffness=1.0, damping=0.1, drag=0.1, settings="nL")
    document = {
        "title": f"sheet {side}²",
        "integrationMethod": 3,
        "delta": 0.02,
        "tolerance": TOLERANCE,
        "optimizationIterations": FRAMES,
        "forwardSubSteps": 1,
        "printTimes": False,
        "windVel": {"x": 1.0, "y": 0.5, "z": 2.0} if "wind" in kind else {"x": 0.0, "y": 0.0, "z": 0.0},
        "objects": [cloth | {"springStiffness": stiffness.tolist()}],
        "colliders": [],
    }
    return clothfit.load(io.StringIO(json.dumps(document)))


def used() -> float:
    """Seconds of the processor so far."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def row(side: int, kind: str) -> str:
    """One line of the table."""
    scene = sheet(side, kind)
    target = clothfit.simulate(scene, tolerance=TOLERANCE)
    if "round" in kind:
        target = replace(target, positions=np.round(target.positions, 7))
    begun = used()
    fit = clothfit.estimate(scene, target, start=START)
    seconds = used() - begun
    true, found = (np.array(each.cloths[0].stiffness) for each in (scene, fit.scene))
    off = np.median(np.abs(found / true - 1.0))
    return f"| {side}² | {KINDS[kind]} | {seconds:.1f} | {fit.status} | {1e3 * fit.rmse:.2g} | {off:.1e} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Print exact fits of large sheets.")
    parser.add_argument("sides", nargs="*", type=int, default=[40, 50, 60], metavar="SIDE", help="vertices of a side")
    sides = parser.parse_args().sides
    row(12, ""), row(12, "wind")
    print("| sheet | | CPU s | status | RMSE, mm | median error of the stiffnesses |")
    print("|---|---|---|---|---|---|")
    for side in sides:
        for kind in KINDS:
            print(row(side, kind), flush=True)


if __name__ == "__main__":
    main()
