"""Fits of motions that other programs computed: `python benchmarks/strangers.py FOLDER [TABLE …]`.

FOLDER has `blender-side.npz` and `mujoco-corners.npz`: `positions`, `triangles`, `fps`, and `held`, the vertices that
do not move. Tables: `clocks` (their clock and place, as they are, and changed by what is to be found again),
`coverage` (whether intervals contain the values that other frames give; takes ten minutes or more), `ladder` (the
models from coarse to fine, with the time step that is chosen, and the last quarter of the frames kept out).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import clothfit
from clothfit.base.messages import metres
from clothfit.formats.convention import Reading
from clothfit.meshes.mesh import Mesh
from clothfit.motion.foreign import load
from clothfit.motion.motion import Motion
from clothfit.registration.record import rotation

STRANGERS = {
    "blender-side": (Reading(up="y", handedness="right", fps=24.0), 1.32),
    "mujoco-corners": (Reading(up="z", handedness="right", fps=50.0), 1.0),
}
"""How their files are meant, and the rate of their clock."""

RATE, OFFSET, TURN, MOVE = 1.1, 0.03, rotation(np.array([0.1, 0.3, -0.2])), np.array([0.3, -0.2, 0.1])
"""What a target is changed by: its clock, s, and its place, m."""


def stranger(folder: Path, name: str, substeps: int = 1, **fits: str) -> tuple[clothfit.Scene, Motion]:
    """A scene of the default fabric for a stranger's motion, with so many steps for each of its frames; `fits` flags
    kinds beside one stiffness.
    """
    path, (reading, _) = folder / f"{name}.npz", STRANGERS[name]
    with np.load(path) as arrays:
        triangles, held = arrays["triangles"], arrays["held"]
    motion = load(path, None, reading).motion
    count = len(motion.positions[0])
    scene = clothfit.new_scene(
        Mesh(motion.positions[0], triangles), np.isin(np.arange(count), held), fit="nG", fits=fits,
        integrator="implicit", delta=1.0 / float(reading.fps or 1.0) / substeps,
        frames=(len(motion.times) - 1) * substeps + 1,
    )  # fmt: skip
    return scene, load(path, scene, reading).motion


def clocks(folder: Path) -> None:
    """One stiffness and damping, with and without the clock, and with the clock and the place of a changed target."""
    print("| target | steps per frame | asked | error | rate (true) | offset | place off | seconds |")
    print("|---|---|---|---|---|---|---|---|")
    for name, (_, rate) in STRANGERS.items():
        for substeps in (1, 4):
            scene, motion = stranger(folder, name, substeps, damping="G")
            moved = replace(motion, times=RATE * motion.times + OFFSET, positions=(motion.positions - MOVE) @ TURN)
            both = {"fit_time": True, "fit_placement": True}
            cases: list[tuple[str, Motion, dict[str, Any], float]] = [
                ("", motion, {}, rate),
                ("`--fit-time`", motion, {"fit_time": True}, rate),
                ("changed, `--fit-time --fit-placement`", moved, both, RATE * rate),
            ]
            for asked, target, options, true in cases:
                began = time.perf_counter()
                fit = clothfit.estimate(scene, target, intervals=False, **options)
                seconds = time.perf_counter() - began
                found = fit.registration[0] if fit.registration else None
                clock = f"{found.rate:.3f} ({true:.3f}) | {1e3 * found.offset:.0f} ms" if found else " | "
                off = metres(float(np.abs(found.translation - MOVE).max())) if found and target is moved else ""
                print(
                    f"| {name} | {substeps} | {asked} | {metres(fit.rmse)} | {clock} | {off} | {seconds:.1f} |",
                    flush=True,
                )


def only(motion: Motion, frames: np.typing.NDArray[np.bool_]) -> Motion:
    """A motion of which only some frames (F,) are observed, beside the first."""
    seen = np.zeros(motion.positions.shape[:2], bool)
    seen[frames] = seen[0] = True
    return replace(motion, observed=seen)


def parts(count: int) -> dict[str, list[np.typing.NDArray[np.bool_]]]:
    """Ways to divide so many frames into two."""
    place = np.arange(count) / count
    return {
        "first and second half": [place < 0.5, place >= 0.5],
        "alternate quarters": [(place * 4).astype(int) % 2 == k for k in (0, 1)],
        "alternate eighths": [(place * 8).astype(int) % 2 == k for k in (0, 1)],
    }


def values(fit: clothfit.Fit) -> list[tuple[float, tuple[float, float] | None]]:
    """The values of a fit, each with its interval; without those at a bound, which have no other value."""
    found, p = [], clothfit.parameters(fit.scene)
    for block in fit.parameters:
        for i in range(block.count):
            own = float(p[len(found)])
            found.append((np.nan if i in block.at_bound else own, block.interval[i]))
    return found


def coverage(folder: Path) -> None:
    """How often the interval of a value contains the value that is fitted to the target's other frames."""
    print("| target | steps per frame | frames | fits | without verdict | intervals | contain the other value |")
    print("|---|---|---|---|---|---|---|")
    total = np.zeros(4, int)
    for name in STRANGERS:
        for substeps in (1, 4):
            sums = {way: np.zeros(4, int) for way in parts(8)}
            for kinds in ({}, {"damping": "G"}, {"damping": "G", "gravity": "G"}, {"drag": "G", "gravity": "G"}):
                scene, motion = stranger(folder, name, substeps, **kinds)
                for way, halves in parts(len(motion.times)).items():
                    both = [clothfit.estimate(scene, only(motion, frames)) for frames in halves]
                    for fit, other in (both, both[::-1]):
                        pairs = zip(values(fit), values(other), strict=True)
                        known = [(i, v) for (_, i), (v, _) in pairs if i is not None and not np.isnan(v)]
                        inside = sum(low <= v <= high for (low, high), v in known)
                        bare = bool(known) and fit.verdict is None
                        sums[way] += (1, bare, len(known), inside)
            for way, row in sums.items():
                fits, bare, count, inside = row
                share = f"{inside / max(count, 1):.0%}"
                print(f"| {name} | {substeps} | {way} | {fits} | {bare} | {count} | {share} |", flush=True)
                total += row
    fits, bare, count, inside = total
    print(f"| all | | | {fits} | {bare} | {count} | {inside / max(count, 1):.0%} |")


def ladder(folder: Path) -> None:
    """All models of each motion, with damping and gravity free; as they are, and with the last quarter kept out."""
    print("| target | kept out | integrator | steps per frame | model | values | error | error kept out | seconds |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name in STRANGERS:
        scene, motion = stranger(folder, name, damping="G", gravity="G")
        cloths = tuple(replace(cloth, settings="nL") for cloth in scene.cloths)
        for method in ("bdf2", "implicit"):
            asked = replace(scene, cloths=cloths).with_step(scene.delta, method=method)
            for share in (None, 0.25):
                fit = clothfit.estimate(asked, motion, holdout=share, intervals=False)
                for rung in fit.ladder:
                    out = "" if rung.holdout_rmse is None else metres(rung.holdout_rmse)
                    print(
                        f"| {name} | {share or ''} | {method} | {fit.substeps or 1} | {rung.model} | {rung.values} "
                        f"| {metres(rung.rmse)} | {out} | {rung.seconds:.1f} |",
                    )
                last = f"| {metres(fit.rmse)} | | {fit.seconds:.1f} |"
                print(f"| {name} | {share or ''} | {method} | | all | | {last}", flush=True)


TABLES: dict[str, Callable[[Path], None]] = {"clocks": clocks, "coverage": coverage, "ladder": ladder}

if __name__ == "__main__":
    where = Path(sys.argv[1])
    clothfit.estimate(*stranger(where, "mujoco-corners", 1, damping="G"), max_evaluations=2, fit_time=True)  # compiled
    for table in sys.argv[2:] or TABLES:
        TABLES[table](where)
        print()
