"""What Blender makes of files and exports: `python benchmarks/in_blender.py [formats|cloths|fits …] [--count N]`.

CLOTHFIT_BPY names a Python with Blender as a module (`make blender` makes one). Parts:

    formats   every motion format that Blender reads, all frames, vertex by vertex
    cloths    exports of the examples and of generated cloths, played for 250 frames: explosions, sag, first period (of
              flag and drape without their wind and sphere, which the export leaves out)
    fits      `estimate --simulator blender` on corners, side and the generated cloths, over 51 frames

Results go to build/blender, a file a cloth; what is there is not done again, so a run that was stopped goes on. The
exit code is 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import clothfit
from clothfit.base.arrays import Array
from clothfit.base.errors import ClothfitError
from clothfit.formats.axes import Axes, from_scene
from clothfit.meshes.mesh import plane
from clothfit.simulators import blender as tool
from clothfit.simulators.blender import VARIABLE, Blender, program
from clothfit.simulators.estimate import Options, estimate

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "build" / "blender"
EXAMPLES = ("corners", "side", "flag", "drape")
FRAMES, FITTED = 250, 51
HUNDRED = 100
BLENDERS = Axes("z", "right", 1.0)
FILES = Path(__file__).with_name("blender_files.py")
LARGEST = {"pc2": 0.0, "mdd": 0.0, "usd": 1e-6, "glb": 1e-5, "obj": 0.0}
"""Bars, m; of caches and OBJ in the mesh's own axes, in which the numbers are those of the file, as float32."""


def generated(seed: int) -> clothfit.Scene:
    """A cloth of 0.2 to 10 m, 25 to 10,000 vertices, 0.05 to 1 kg/m², soft to stiff, whose masses and springs vary."""
    rng = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    size, count = between(0.2, 10.0), round(between(25, 10_000) ** 0.5)  # in this order: see `vertices_of`
    density = between(0.05, 1.0)
    stiffness = between(3.0, 1000.0) * 9.81 * density * size  # it stretches by a third to a thousandth of its size
    mesh = plane(count - 2, size)
    held = np.zeros(len(mesh.positions), bool)
    held[[0, count - 1]] = True
    if rng.random() < 0.3:
        held[:count] = True
    scene = clothfit.new_scene(
        mesh, held, density=density, stiffness=stiffness, damping=between(0.02, 0.5), drag=0.0, delta=0.02,
        frames=FRAMES, integrator="implicit", title=f"generated {seed}",
    )  # fmt: skip
    (own,) = scene.cloths
    spread = rng.uniform(0.0, 0.3)
    mass, springs = (a * np.exp(spread * rng.normal(size=len(a))) for a in (own.mass, own.stiffness))
    return replace(scene, cloths=(replace(own, mass=mass, stiffness=springs),))


def vertices_of(seed: int) -> float:
    """Where a generated cloth stands in the order of sizes."""
    return float(np.random.default_rng(seed).uniform(size=2)[1])


def scenes(count: int) -> Iterator[tuple[str, Callable[[], clothfit.Scene]]]:
    """The examples and so many generated cloths, by name, the smallest of a hundred or more."""
    for name in EXAMPLES:
        yield name, lambda name=name: replace(clothfit.load(ROOT / "examples" / f"{name}.json"), frames=FRAMES)
    for seed in sorted(range(max(count, HUNDRED)), key=vertices_of)[:count]:
        yield f"generated-{seed}", lambda seed=seed: generated(seed)


def height(positions: Array) -> Array:
    """How far the mean vertex is below its start, m, in each frame."""
    found: Array = positions[0, :, 1].mean() - positions[:, :, 1].mean(axis=1)
    return found


def turn(drop: Array) -> int:
    """The frame in which a drop (frames,) is largest before it falls by a twentieth of its range; 0: it does not."""
    turned = np.flatnonzero(np.maximum.accumulate(drop) - drop > 0.05 * float(np.ptp(drop)))
    k = int(np.argmax(drop[: turned[0]])) if len(turned) else 0
    return k if k < len(drop) - 1 else 0


def pace(own: Array, other: Array, h: float) -> float:
    """The first period of another drop over that of the own, (frames,) each; where one of both does not swing, the time
    that it takes to nine tenths of the own sag.
    """
    if turn(own) and turn(other):
        return first_period(other, h) / first_period(own, h)
    level = 0.9 * own[4 * len(own) // 5 :].mean()
    times = [float(np.argmax(drop >= level)) if (drop >= level).any() else np.inf for drop in (other, own)]
    return times[0] / times[1]


def first_period(drop: Array, h: float) -> float:
    """Twice the time of the first turn of a drop (frames,), s."""
    k = turn(drop)
    before, at, after = drop[k - 1 : k + 2]
    bend = before - 2.0 * at + after
    return 2.0 * h * (k + (0.5 * (before - after) / bend if bend else 0.0))


def compared(scene: clothfit.Scene, blender: Blender) -> dict[str, Any]:
    """How an export moves in Blender beside the scene here."""
    began = time.perf_counter()
    every = tool.stride(scene)
    frames = (scene.frames - 1) // every + 1
    made = tool.tool_of(scene, 0, frames, blender)
    here = clothfit.simulate(scene).positions[:: every][:frames]
    middle = time.perf_counter()
    there = made.motion(np.array([value.mapped for value in made.values]))
    found: dict[str, Any] = {
        "vertices": here.shape[1], "frames": frames, "seconds_here": middle - began,
        "seconds_there": time.perf_counter() - middle,
    }  # fmt: skip
    size = float(np.ptp(here[0], axis=0).max())
    if there is None or not np.isfinite(there).all() or np.abs(there - here).max() > 10 * (size + np.abs(here).max()):
        return found | {"exploded": True}
    h, (own, other) = every * scene.delta, (height(here), height(there))
    last = slice(4 * frames // 5, None)
    travel = np.sqrt(((here - here[0]) ** 2).sum(axis=2).mean())
    return found | {
        "exploded": False, "sag": float(other[last].mean() / own[last].mean()),
        "period": pace(own, other, h),
        "drops": [np.round(own, 6).tolist(), np.round(other, 6).tolist()],
        "apart": float(np.sqrt(((there - here) ** 2).sum(axis=2).mean()) / travel),
    }  # fmt: skip


def formats(command: list[str]) -> dict[str, float]:
    """The largest distance of a vertex in any frame, m, by format."""
    scene = replace(clothfit.load(ROOT / "examples" / "corners.json"), frames=FRAMES).with_step(0.02, FRAMES)
    motion = clothfit.simulate(scene)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        job: dict[str, Any] = {"fps": 50, "frames": FRAMES, "out": str(place / "out.npz")}
        for kind in ("pc2", "mdd", "usd", "glb"):
            job[kind] = str(place / f"motion.{kind}")
            clothfit.save_motion(motion, job[kind], scene)
        clothfit.save_motion(motion, place / "frame_*.obj", scene)
        job["objs"] = [str(path) for path in sorted(place.glob("frame_*.obj"))]
        job["obj"] = job["objs"][0]
        (place / "job.json").write_text(json.dumps(job))
        done = subprocess.run([command[0], str(FILES), str(place / "job.json")], capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(done.stderr[-2000:])
        with np.load(job["out"]) as read:
            return distances(motion.positions, dict(read))


def distances(positions: Array, found: dict[str, Array]) -> dict[str, float]:
    """The largest distances, and how far the placement in the world is off, of all formats."""
    truth, right = from_scene(positions, BLENDERS), from_scene(positions, Axes("y", "right", 1.0))
    own = right.astype(np.float32)
    made = {name: float(np.abs(found[f"{name}_own"] - own).max()) for name in ("pc2", "mdd", "obj")}
    made |= {name: float(np.linalg.norm(found[name] - truth, axis=2).max()) for name in ("usd", "glb")}
    made["world"] = max(float(np.abs(found[name] - truth).max()) for name in ("pc2", "mdd", "usd", "glb", "obj"))
    return made


def kept(name: str, compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What is in the file of this name, or what is computed, and then kept there."""
    path = KEPT / f"{name}.json"
    if path.exists():
        found: dict[str, Any] = json.loads(path.read_text())
        return found
    found = compute()
    KEPT.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(found) + "\n")
    return found


def cloths(blender: Blender, count: int) -> bool:
    """Print the table of the exports; whether the bars are met."""
    print("| cloth | vertices | sag there/here | first period | apart |\n|---|---|---|---|---|")
    rows = []
    for name, make in scenes(count):
        row = kept(name, lambda make=make: compared(make(), blender))
        rows.append((name, row))
        cells = ["exploded", "", ""] if row["exploded"] else [f"{row['sag']:.3f}", f"{row['period']:.3f}",
                                                              f"{100 * row['apart']:.1f} %"]
        print(f"| {name} | {row['vertices']} | {' | '.join(cells)} |", flush=True)
    return judged([row for name, row in rows if name not in EXAMPLES])


def judged(rows: list[dict[str, Any]]) -> bool:
    """Print how many are within the bars; whether all are."""
    burst = sum(row["exploded"] for row in rows)
    whole = [row for row in rows if not row["exploded"]]
    met = not burst
    print(f"{len(rows)} generated cloths: {burst} explosions")
    for name in ("sag", "period"):
        off = np.array([abs(row[name] - 1) for row in whole])
        if len(off):
            print(f"{name}: median off {100 * np.median(off):.1f} %, largest {100 * off.max():.1f} %, "
                  f"{(off < 0.15).sum()} of {len(off)} within 15 %")
            met = met and bool(np.median(off) < 0.05 and (off < 0.15).all())
    return met


def fits(command: list[str], count: int) -> None:
    """Print what fits in Blender's own model leave."""
    print("| cloth | vertices | mapped | fitted | times less | runs |\n|" + 6 * "---|")
    for name, make in scenes(count):
        if name in EXAMPLES[2:]:  # they live by what the export leaves out
            continue

        def compute(make: Callable[[], clothfit.Scene] = make) -> dict[str, Any]:
            scene = replace(make(), frames=FITTED)
            (one,) = estimate(scene, None, Options("blender", blender=command[0], most=20))
            return {"vertices": len(scene.cloths[0].mass), "mapped": one.mapped_rmse / one.travel,
                    "fitted": one.rmse / one.travel, "runs": one.simulations}

        row = kept(f"fit-G-{name}", compute)
        cells = [str(row["vertices"]), *(f"{100 * row[each]:.1f} %" for each in ("mapped", "fitted"))]
        cells += [f"{row['mapped'] / row['fitted']:.1f}", str(row["runs"])]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


def main() -> int:
    """Do the parts that are asked for."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("parts", nargs="*", default=["formats", "cloths"])
    asked.add_argument("--count", type=int, default=100, help="generated cloths, the smallest of a hundred")
    given = asked.parse_args()
    try:
        command = program(os.environ.get(VARIABLE))
        blender = Blender(command)
    except ClothfitError as error:
        print(f"skipped: {error}")
        return 0
    met = True
    with blender:
        print(f"Blender {blender.version}", flush=True)
        if "formats" in given.parts:
            found = kept("formats", lambda: formats(command))
            print("; ".join(f"{name} {1e6 * value:.3g} µm" for name, value in found.items()))
            met = met and all(found[name] <= LARGEST[name] for name in LARGEST) and found["world"] <= LARGEST["glb"]
        if "cloths" in given.parts:
            met = cloths(blender, given.count) and met
        if "fits" in given.parts:
            fits(command, given.count)
    print("all bars are met" if met else "a bar is missed")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
