"""Shots of PyBullet's deformable sheets: `python benchmarks/shots/with_pybullet.py FOLDER [NAME …]`. Needs `pybullet`.

Made with PyBullet 3.2.7: mass-spring sheets in steps of 1/1920 s. Held vertices are anchored to a small body, which is
moved. Wind is not among them: PyBullet has none.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pybullet as p
from shot import Array, generate, quads, save, sheet

STEP = 1 / 1920


def simulate(
    x: Array, triangles: Array, held: Array, path: Callable[[float], Array] | None = None, *, frames: int = 80,
    fps: int = 40, mass: float = 0.3, stiffness: float = 600.0, bend: float = 1.0, damping: float = 0.05,
    ball: tuple[float, ...] = (), box: tuple[float, ...] = (),
) -> Array:  # fmt: skip
    """Motion (frames, n, 3); `path` says by how much the held vertices are moved; a box has its centre and half
    sides.
    """
    p.connect(p.DIRECT)
    p.resetSimulation(p.RESET_USE_DEFORMABLE_WORLD)
    p.setGravity(0, 0, -9.81)
    p.setTimeStep(STEP)
    with tempfile.TemporaryDirectory() as folder:
        name = Path(folder) / "sheet.obj"
        name.write_text(
            "".join(f"v {a} {b} {c}\n" for a, b, c in x) + "".join(f"f {a} {b} {c}\n" for a, b, c in triangles + 1)
        )
        cloth = p.loadSoftBody(
            str(name), mass=mass, useNeoHookean=0, useBendingSprings=1, useMassSpring=1,
            springElasticStiffness=stiffness, springDampingStiffness=damping, springBendingStiffness=bend,
            useSelfCollision=0, frictionCoeff=0.5,
            useFaceContact=1 if ball or box else 0, collisionMargin=0.006,
        )  # fmt: skip
    if ball:
        p.createMultiBody(0, p.createCollisionShape(p.GEOM_SPHERE, radius=ball[3]), basePosition=ball[:3])
    if box:
        p.createMultiBody(0, p.createCollisionShape(p.GEOM_BOX, halfExtents=box[3:]), basePosition=box[:3])
    where = np.array(p.getMeshData(cloth, -1, flags=p.MESH_DATA_SIMULATION_MESH)[1])
    order = np.linalg.norm(x[:, None] - where, axis=2).argmin(axis=1)
    pole = None
    if len(held):
        shape = p.createCollisionShape(p.GEOM_SPHERE, radius=0.001)
        centre = x[held].mean(axis=0) + [0, 0, 5]
        pole = p.createMultiBody(0, shape, basePosition=centre)
        for i in held:
            p.createSoftBodyAnchor(cloth, int(order[i]), pole, -1)
    found = [x.copy()]
    for frame in range(1, frames):
        for sub in range(round(1 / fps / STEP)):
            t = (frame - 1) / fps + (sub + 1) * STEP
            if pole is not None and path:
                p.resetBasePositionAndOrientation(pole, centre + path(t), (0, 0, 0, 1))
                p.resetBaseVelocity(pole, (path(t) - path(t - STEP)) / STEP)
            p.stepSimulation()
        found.append(np.array(p.getMeshData(cloth, -1, flags=p.MESH_DATA_SIMULATION_MESH)[1])[order])
    p.disconnect()
    return np.array(found)


def corners(folder: Path, name: str) -> None:
    """A level sheet falls from two corners."""
    x, triangles, held = sheet(15, 15, 0.9, 0.9), quads(15, 15), np.array([0, 14])
    motion = simulate(x, triangles, held, frames=90, stiffness=1500.0)
    save(folder, name, motion, triangles, 40, held, "PyBullet, 0.9 m, level, two corners held")


def flag(folder: Path, name: str) -> None:
    """A sheet whose upper side is waved."""
    x, triangles, held = sheet(14, 14, 0.8, 0.8, upright=True), quads(14, 14), np.arange(14)

    def path(t: float) -> Array:
        s = min(2 * t, 1.0)
        return 0.18 * s * s * (3 - 2 * s) * np.array([0.3 * np.sin(3 * t), np.sin(4.5 * t), 0.1 * np.sin(6 * t)])

    motion = simulate(x, triangles, held, path, frames=100)
    save(folder, name, motion, triangles, 40, held, "PyBullet, 0.8 m, upper side waved")


def over_ball(folder: Path, name: str) -> None:
    """A sheet drops on a ball."""
    x, triangles, ball = sheet(15, 15, 0.9, 0.9, z=0.95), quads(15, 15), (0.03, 0.4, 0.6, 0.28)
    motion = simulate(x, triangles, np.zeros(0, int), frames=60, ball=ball)
    save(folder, name, motion, triangles, 40, np.zeros(0, int), "PyBullet, 0.9 m, drops on a ball", ball=np.array(ball))


def over_box(folder: Path, name: str) -> None:
    """A sheet, held at two corners, falls over a box."""
    x, triangles, held = sheet(15, 15, 0.9, 0.9, z=0.95), quads(15, 15), np.array([0, 14])
    motion = simulate(x, triangles, held, frames=60, box=(0.0, 0.55, 0.6, 0.2, 0.15, 0.15))
    save(folder, name, motion, triangles, 40, held, "PyBullet, 0.9 m, two corners held, falls on a box")


SHOTS = {"bullet-corners": corners, "bullet-flag": flag, "bullet-ball": over_ball, "bullet-box": over_box}

if __name__ == "__main__":
    generate(SHOTS)
