"""Default fits of shots of other programs: `python benchmarks/shots/table.py FOLDER [NAME …] [--half choose|report]
[--beside PYTHON|CHECKOUT] [--kept-out] [--shuffled] [--auto]`. Needs clothfit only.

FOLDER has the files that the generators beside this module write (`with_mujoco.py`, `with_newton.py`,
`with_pybullet.py`, `with_bpy.py` and `inextensible.py`, each of which says what it needs), or others of that form.
Each shot becomes a scene of the stock fabric that begins at its first frame; held vertices are fixed and, where they
move, pinned to their paths. Stiffnesses as a smooth map, damping, drag, wind and gravity are free; with
`--auto` the fit chooses by itself what to fit, where the package can.

Columns: travel and still are root mean squares, over all frames and vertices, of the target's distance from its first
and from its mean frame, the best still picture; the error is the fit's, and bold where a still picture is better. With
`--kept-out` a second fit is made without the last quarter of the frames, and its error there is given. With
`--shuffled` another fit sees the vertices in another order in each frame, as points of a scan, and the error of its
motion, vertex by vertex, and how many times the first one's that is, are given. Seconds are
those of the processor (all threads) that one fit takes, after a first one that compiles. `--beside` repeats the fit by
another Python, or by this one with the package of another checkout, in columns of its own.

Choices of the program are made on the half "choose" and reported on "report", so that no figure of the latter led to
them; `CHOOSE` lists the former.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from shot import measures

CHOOSE = {
    "blender-ball", "blender-flag", "blender-steady", "blender-side", "blender-wind", "bullet-ball", "bullet-corners",
    "mujoco-corners", "mujoco-flag", "mujoco-side", "mujoco-wind", "newton-flag", "newton-vbd", "newton-wind",
    "windy-1", "windy-3", "windy-5", "windy-7", "windy-9", "woven-flag", "woven-skirt-1", "woven-wind-1",
    "woven-wind-3",
}  # fmt: skip
"""Shots by which the program may be chosen: a half of each kind and program."""

MOVED, KEPT_OUT = 1e-4, 0.25
"""The way, m, from which a held vertex counts as moved; the share of frames that is kept out, the last."""

LETTERS, KINDS = "nM", {"damping": "G", "drag": "G", "wind": "G", "gravity": "G"}


def scene_of(path: Path, auto: bool, folder: Path) -> tuple[Any, Any]:
    """The scene and the motion of a shot; the fit is left to itself where that is asked for and can be. The folder
    takes the paths of held vertices that move, and is needed as long as the scene.
    """
    import clothfit
    from clothfit.formats.axes import Axes, to_scene
    from clothfit.meshes.mesh import Mesh
    from clothfit.motion.foreign import load

    with np.load(path) as arrays:
        triangles, held, fps, up = arrays["triangles"], arrays["held"], float(arrays["fps"]), str(arrays["up"])[:1]
        ball, x = arrays.get("ball"), arrays["positions"]
    reading, axes = clothfit.Reading(up=up, handedness="right", fps=fps), Axes(up, "right")
    motion = load(path, None, reading).motion
    spheres = [] if ball is None else [(*to_scene(ball[:3], axes).tolist(), float(ball[3]))]
    mesh, fixed = Mesh(motion.positions[0], triangles), np.isin(np.arange(x.shape[1]), held)
    others: dict[str, Any] = {"delta": 1 / fps, "frames": len(x), "spheres": spheres}
    try:
        scene = clothfit.new_scene(mesh, fixed, fit="auto" if auto else LETTERS, fits={} if auto else KINDS, **others)
    except clothfit.InvalidInput:  # of an earlier package, in which it cannot
        scene = clothfit.new_scene(mesh, fixed, fit=LETTERS, fits=KINDS, **others)
    document = _document(scene)
    moved = held[np.ptp(x[:, held], axis=0).max(axis=1) > MOVED] if len(held) else held
    if len(moved):
        ways = folder / "pins.npz"  # in the scene's axes, as pins take points of an npz for these
        np.savez(ways, positions=motion.positions[:, moved], times=motion.times)
        keys = {"file": str(ways), "points": list(range(len(moved)))}
        document["objects"][0]["pins"] = [{"vertices": moved.tolist(), "posKeys": keys}]
    scene = clothfit.load(document)
    return scene, load(path, scene, reading).motion


def _document(scene: Any) -> Any:
    """The fields of a scene's file."""
    import clothfit

    text = io.StringIO()
    clothfit.save(scene, text)
    return json.loads(text.getvalue())


def fitted(path: Path, auto: bool, kept_out: bool, as_scan: bool) -> dict[str, Any]:
    """What the fits of a shot come to."""
    with tempfile.TemporaryDirectory() as folder:
        scene, motion = scene_of(path, auto, Path(folder))
        found = fits(scene, motion, kept_out)
        return found | {"shuffled": shuffled(path, scene, motion, Path(folder))} if as_scan else found


def shuffled(path: Path, scene: Any, motion: Any, folder: Path) -> float:
    """The error, m, of a fit that does not know which vertex is which."""
    import clothfit
    from clothfit.motion.foreign import load
    from clothfit.motion.times import frame_places, interpolated

    chance = np.random.default_rng(0)
    with np.load(path) as arrays:
        points = np.stack([chance.permutation(each) for each in arrays["positions"]])
        reading = clothfit.Reading(up=str(arrays["up"])[:1], handedness="right", fps=float(arrays["fps"]))
    np.savez(folder / "shuffled.npz", positions=points, fps=reading.fps)
    scan = load(folder / "shuffled.npz", scene, reading).motion
    found = clothfit.estimate(scene, scan, options=clothfit.FitOptions(intervals=False)).scene
    step, fraction = frame_places(motion, found.delta)
    x = clothfit.simulate(found, int(np.ceil(step + fraction).max()) + 1).positions
    return float(np.sqrt(((interpolated(x, step, fraction) - motion.positions) ** 2).sum(axis=2).mean()))


def fits(scene: Any, motion: Any, kept_out: bool) -> dict[str, Any]:
    """The same of a scene."""
    import clothfit

    clothfit.estimate(scene, motion, options=clothfit.FitOptions(max_evaluations=2, intervals=False))  # compiled
    began = time.process_time()
    fit = clothfit.estimate(scene, motion)
    found: dict[str, Any] = {"seconds": time.process_time() - began, "error": fit.whole or fit.rmse}
    found |= {"status": str(fit.status), "verdict": fit.verdict.model if fit.verdict else ""}
    if kept_out:
        other = clothfit.estimate(scene, motion, options=clothfit.FitOptions(holdout=KEPT_OUT, intervals=False))
        found["kept out"] = other.holdout.rmse if other.holdout else None
    return found


def measured(path: Path, given: str, options: list[str]) -> dict[str, Any]:
    """The same by a process of its own, with a Python or a checkout; `trouble` where it fails."""
    environment = dict(os.environ)
    python = given if given and not Path(given).is_dir() else sys.executable
    if given and python != given:
        environment["PYTHONPATH"] = str(Path(given).resolve())
    command = [python, str(Path(__file__).resolve()), str(path), "--one", *options]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        return {"trouble": (done.stderr.strip().splitlines() or ["no word"])[-1]}
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return found


def cells(found: dict[str, Any], travel: float, still: float, kept_out: bool, as_scan: bool) -> str:
    """The columns of one fit."""
    if "trouble" in found:
        return f" {found['trouble'][:80]} |" + " |" * (3 + kept_out + as_scan)
    error = found["error"]
    text = f"{1e3 * error:.1f} mm" if error < still else f"**{1e3 * error:.1f} mm**"
    out = found.get("kept out")
    last = (f" {1e3 * out:.1f} mm |" if out is not None else " |") if kept_out else ""
    if as_scan:
        last += f" {1e3 * found['shuffled']:.1f} mm, {found['shuffled'] / error:.2f} × |"
    return f" {text} | {error / travel:.1%} |{last} {found['seconds']:.0f} | {found['verdict']}, {found['status']} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Default fits of shots of other programs.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--half", choices=("choose", "report"))
    parser.add_argument("--beside")
    parser.add_argument("--kept-out", action="store_true")
    parser.add_argument("--shuffled", action="store_true")
    parser.add_argument("--auto", action="store_true")
    parser.add_argument("--one", action="store_true", help="used by the program itself")
    given = parser.parse_args()
    if given.one:
        print(json.dumps(fitted(given.folder, given.auto, given.kept_out, given.shuffled)))
        return
    options = [f"--{name}" for name in ("kept-out", "shuffled", "auto") if getattr(given, name.replace("-", "_"))]
    both = ["", *([given.beside] if given.beside else [])]
    names = ["error", "of travel", *(["kept out"] if given.kept_out else []),
             *(["shuffled"] if given.shuffled else []), "CPU s", "verdict"]
    columns = ["shot", "half", "program", "travel", "still", *names]
    columns += [f"{name}, beside" for name in names] if given.beside else []
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
    for path in sorted(given.folder.glob("*.npz")):
        half = "choose" if path.stem in CHOOSE else "report"
        with np.load(path) as arrays:
            usable = "held" in arrays and "up" in arrays
            x = arrays["positions"].astype(float)
            program = str(arrays.get("note", path.stem)).partition(",")[0]
        wanted = path.stem in given.names if given.names else given.half in (None, half)
        if not usable or not wanted:
            continue
        travel, still = measures(x)
        row = f"| {path.stem} | {half} | {program} | {1e3 * travel:.0f} mm | {1e3 * still:.0f} mm |"
        for each in both:
            row += cells(measured(path, each, options), travel, still, given.kept_out, given.shuffled)
        print(row, flush=True)


if __name__ == "__main__":
    main()
