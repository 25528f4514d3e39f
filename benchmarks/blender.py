"""Exported cloths and GLB files in Blender: `python benchmarks/blender.py PYTHON [CLOTH …]`.

PYTHON is the Python of an environment with Blender as a module: `pip install bpy==4.2.23 'numpy<2'` for Python 3.11.
Five cloths fall for 100 frames at 50 a second, here and in Blender after the exported script: how far they are apart,
in % of the distance travelled (root mean squares over the vertices). And their motions, written as GLB, are imported
there: the largest distance of a vertex in any frame.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import clothfit
from clothfit.base.arrays import Array
from clothfit.export.tools import exported
from clothfit.formats.axes import Axes, facing, from_scene
from clothfit.meshes.mesh import plane

PLAYER = Path(__file__).with_name("blender_jobs.py")
ROOT = Path(__file__).parents[1]

FPS, FRAMES = 50.0, 101
"""Frames per second, and frames with the first."""

AFTER = {"0.2 s": 10, "0.5 s": 25, "1 s": 50, "2 s": 100}
"""Frames to compare."""

BLENDERS = Axes("z", "right", 1.0)


def hanging(divisions: int, stiffness: float, density: float, side: bool = False) -> clothfit.Scene:
    """A square metre that hangs at two corners, or at a side; without drag, which Blender has not."""
    mesh = plane(divisions, 1.0)
    held = np.zeros(len(mesh.positions), bool)
    held[: divisions + 2] = True
    if not side:
        held[1 : divisions + 1] = False
    return clothfit.new_scene(
        mesh, held, density=density, stiffness=stiffness, drag=0.0, damping=0.1, frames=FRAMES, delta=1 / FPS
    )


CLOTHS: dict[str, Callable[[], clothfit.Scene]] = {
    "light": lambda: hanging(10, 20.0, 0.02),
    "soft": lambda: hanging(10, 5.0, 0.2),
    "fine": lambda: hanging(30, 50.0, 0.2),
    "heavy": lambda: hanging(10, 200.0, 2.0, side=True),
    "corners": lambda: clothfit.load(ROOT / "examples" / "corners.json").with_step(1 / FPS, FRAMES),
}


def played(python: str, jobs: list[dict[str, object]], folder: Path) -> list[Array]:
    """What Blender makes of jobs (see its player), in its axes. Raises RuntimeError with its last words."""
    for number, job in enumerate(jobs):
        job["out"] = str(folder / f"{number}.npy")
    (folder / "jobs.json").write_text(json.dumps(jobs))
    done = subprocess.run([python, str(PLAYER), str(folder / "jobs.json")], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr[-2000:])
    return [np.load(str(job["out"])) for job in jobs]


def has_blender(python: str) -> bool:
    """Whether a Python has Blender."""
    try:
        return subprocess.run([python, "-c", "import bpy"], capture_output=True).returncode == 0
    except OSError:
        return False


def jobs_of(scene: clothfit.Scene, motion: clothfit.Motion, folder: Path, name: str) -> list[dict[str, object]]:
    """A cloth to simulate, and a file to play."""
    (cloth,) = scene.cloths
    place = folder / name
    place.mkdir()
    for file, data in exported(scene, "blender").items():
        (place / file).write_bytes(data)
    positions, triangles = from_scene(cloth.positions, BLENDERS), facing(cloth.triangles, BLENDERS)
    np.savez(place / "mesh.npz", positions=positions, triangles=triangles)
    clothfit.save_motion(motion, place / "motion.glb", scene)
    return [
        {"cloth": str(place / "mesh.npz"), "script": str(place / "blender.py"), "fps": FPS, "frames": FRAMES},
        {"glb": str(place / "motion.glb"), "fps": FPS, "times": motion.times.tolist()},
    ]


def rms(points: Array) -> float:
    """Root mean square of the lengths of (n, 3)."""
    return float(np.sqrt((points**2).sum(axis=1).mean()))


def main(python: str, names: list[str]) -> None:
    """Print the table."""
    if not has_blender(python):
        sys.exit(f"{python} cannot import bpy; install it there: pip install bpy==4.2.23 'numpy<2' (Python 3.11)")
    print(f"| cloth | {' | '.join(f'off after {time}' for time in AFTER)} | GLB, largest |")
    print("|---|" + "---|" * (len(AFTER) + 1))
    for name in names or CLOTHS:
        scene = CLOTHS[name]()
        motion = clothfit.simulate(scene)
        truth = from_scene(motion.positions, BLENDERS)
        with tempfile.TemporaryDirectory() as folder:
            cloth, file = played(python, jobs_of(scene, motion, Path(folder), name), Path(folder))
        cells = [
            f"{100 * rms(cloth[frame] - truth[frame]) / rms(truth[frame] - truth[0]):.1f} % of "
            f"{1e3 * rms(truth[frame] - truth[0]):.0f} mm"
            for frame in AFTER.values()
        ]
        largest = np.linalg.norm(file - truth, axis=2).max()
        finite = "" if np.isfinite(cloth).all() else " (not finite)"
        print(f"| {name}{finite} | {' | '.join(cells)} | {1e6 * largest:.1f} µm |", flush=True)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2:])
