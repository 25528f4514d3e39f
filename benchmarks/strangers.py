"""Fits of motions that other programs computed: `python benchmarks/strangers.py FOLDER [TABLE …]`.

FOLDER has `blender-side.npz` and `mujoco-corners.npz`: `positions`, `triangles`, `fps`, and `held`, the vertices that
do not move; or, for `coverage`, any such files that also have `up`, the axis that points up. Tables: `clocks` (their
clock and place, as they are, and changed by what is to be found again), `coverage` (whether intervals contain the
values that other frames give; takes an hour), `ladder` (the models from coarse to fine, with the time step that is
chosen, and the last quarter of the frames kept out), `garment` (a T-shirt of 1,426 vertices in wind, `tshirt.npz`).
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
from clothfit.formats.axes import Reading
from clothfit.meshes.mesh import Mesh
from clothfit.motion.foreign import load
from clothfit.motion.motion import Motion
from clothfit.registration.record import rotation

STRANGERS = {
    "blender-side": (Reading(up="y", handedness="right", fps=24.0), 1.32),
    "mujoco-corners": (Reading(up="z", handedness="right", fps=50.0), 1.0),
}
"""How their files are meant, and the rate of their clock."""

GARMENT, STILL = Reading(up="y", handedness="right", fps=90.0), 0.01
"""How the T-shirt's file is meant, and the way, relative to its size, up to which a vertex counts as held."""

RATE, OFFSET, TURN, MOVE = 1.1, 0.03, rotation(np.array([0.1, 0.3, -0.2])), np.array([0.3, -0.2, 0.1])
"""What a target is changed by: its clock, s, and its place, m."""


def stranger(
    folder: Path, name: str, substeps: int = 1, integrator: str = "implicit", **fits: str
) -> tuple[clothfit.Scene, Motion]:
    """A scene of the default fabric for a stranger's motion, with so many steps for each of its frames; `fits` flags
    kinds beside one stiffness.
    """
    path = folder / f"{name}.npz"
    with np.load(path) as arrays:
        triangles, held = arrays["triangles"], arrays["held"]
        if name in STRANGERS:
            reading, _ = STRANGERS[name]
        else:
            reading = Reading(up=str(arrays["up"]), handedness="right", fps=float(arrays["fps"]))
    motion = load(path, None, reading).motion
    count = len(motion.positions[0])
    scene = clothfit.new_scene(
        Mesh(motion.positions[0], triangles), np.isin(np.arange(count), held), fit="nG", fits=fits,
        integrator=integrator, delta=1.0 / float(reading.fps or 1.0) / substeps,
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
                fit = clothfit.estimate(scene, target, options=clothfit.FitOptions(intervals=False, **options))
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


FREE: tuple[dict[str, str], ...] = (
    {}, {"damping": "G"}, {"damping": "G", "gravity": "G"}, {"drag": "G", "gravity": "G"},
)  # fmt: skip
"""What is fitted beside one stiffness, for `coverage`."""

STEPS = (("implicit", 1), ("implicit", 4), ("bdf2", 1))
"""Integrators and steps per frame, for `coverage`."""


def coverage(folder: Path) -> None:
    """How often the interval of a value contains the value that is fitted to the target's other frames."""
    columns = "fits | without verdict | intervals | withheld | contain the other value | median half width"
    print(f"| target | step | frames | {columns} |\n{'|---' * 9}|")
    every = [Sums() for _ in parts(8)]
    for name in sorted(path.stem for path in folder.glob("*.npz") if is_stranger(path)):
        for step, substeps in STEPS:
            for (way, _), total in zip(parts(8).items(), every, strict=True):
                own = Sums()
                for kinds in FREE:
                    scene, motion = stranger(folder, name, substeps, step, **kinds)
                    both = [clothfit.estimate(scene, only(motion, each)) for each in parts(len(motion.times))[way]]
                    for fit, other in (both, both[::-1]):
                        own.add(fit, other)
                total += own
                print(f"| {name} | {step}, {substeps} per frame | {way} | {own} |", flush=True)
    for way, total in zip(parts(8), every, strict=True):
        print(f"| all | | {way} | {total} |")
    print(f"| all | | | {sum(every, Sums())} |")


def is_stranger(path: Path) -> bool:
    """Whether `coverage` can use a file."""
    with np.load(path) as arrays:
        return path.stem in STRANGERS or "up" in arrays


class Sums:
    """What was counted of some fits and their intervals."""

    def __init__(self) -> None:
        self.counts = np.zeros(5, int)  # fits, those with intervals and no verdict, intervals, withheld, right ones
        self.widths: list[float] = []  # half, in units of the value for masses and the like, else as they are

    def __add__(self, other: Sums) -> Sums:
        found = Sums()
        found.counts, found.widths = self.counts + other.counts, self.widths + other.widths
        return found

    def __iadd__(self, other: Sums) -> Sums:
        self.counts, self.widths = self.counts + other.counts, self.widths + other.widths
        return self

    def add(self, fit: clothfit.Fit, other: clothfit.Fit) -> None:
        """Count the intervals of a fit, with the values of another one."""
        pairs = [(i, v) for (_, i), (v, _) in zip(values(fit), values(other), strict=True) if not np.isnan(v)]
        known = [(i, v) for i, v in pairs if i is not None]
        inside = sum(low <= v <= high for (low, high), v in known)
        bare = bool(known) and fit.verdict is None
        self.counts += (1, bare, len(known), len(pairs) - len(known), inside)
        self.widths += [np.log(high / low) / 2 for ((low, high), _) in known if low > 0]

    def __str__(self) -> str:
        fits, bare, count, withheld, inside = self.counts
        wide = np.expm1(np.median(self.widths)) if self.widths else np.nan
        return f"{fits} | {bare} | {count} | {withheld} | {inside / max(count, 1):.0%} | {wide:.0%}"


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
                fit = clothfit.estimate(asked, motion, options=clothfit.FitOptions(holdout=share, intervals=False))
                for rung in fit.ladder:
                    out = "" if rung.holdout_rmse is None else metres(rung.holdout_rmse)
                    print(
                        f"| {name} | {share or ''} | {method} | {fit.substeps or 1} | {rung.model} | {rung.values} "
                        f"| {metres(rung.rmse)} | {out} | {rung.seconds:.1f} |",
                    )
                last = f"| {metres(fit.rmse)} | | {fit.seconds:.1f} |"
                print(f"| {name} | {share or ''} | {method} | | all | | {last}", flush=True)


def garment(folder: Path) -> None:
    """The T-shirt, with damping, drag, wind and gravity free, from the default fabric without wind."""
    path = folder / "tshirt.npz"
    with np.load(path) as arrays:
        triangles = arrays["triangles"]
    x = load(path, None, GARMENT).motion.positions
    held = np.linalg.norm(x - x[0], axis=2).max(axis=0) < STILL * float(np.ptp(x[0], axis=0).max())
    print("| integrator | fits | steps per frame | values | error | seconds | status |")
    print("|---|---|---|---|---|---|---|")
    for integrator in ("bdf2", "implicit"):
        for letters in ("nF", "nR"):
            scene = clothfit.new_scene(
                Mesh(x[0], triangles), held, fit=letters, integrator=integrator, delta=1.0 / 90.0, frames=len(x),
                fits={"damping": "G", "drag": "G", "wind": "G", "gravity": "G"},
            )  # fmt: skip
            fit = clothfit.estimate(
                scene, load(path, scene, GARMENT).motion, options=clothfit.FitOptions(intervals=False),
            )
            print(
                f"| {integrator} | {letters} | {fit.substeps or 1} | {len(clothfit.parameters(fit.scene))} "
                f"| {metres(fit.rmse)} | {fit.seconds:.1f} | {fit.status} |",
                flush=True,
            )


TABLES: dict[str, Callable[[Path], None]] = {
    "clocks": clocks, "coverage": coverage, "ladder": ladder,
    "garment": garment,
}

if __name__ == "__main__":
    where = Path(sys.argv[1])
    clothfit.estimate(
        *stranger(where, "mujoco-corners", 1, damping="G"),
        options=clothfit.FitOptions(max_evaluations=2, fit_time=True),
    )  # compiled
    for table in sys.argv[2:] or TABLES:
        TABLES[table](where)
        print()
