"""Shots of Newton's VBD on the processor: `python benchmarks/shots/with_newton.py FOLDER [NAME …]`. Needs `newton`.

Made with Newton 1.8 and Warp 1.19: neo-Hookean triangles, dihedral bending, 12 steps to a frame of 1/50 s, with ten
iterations each. Air is a force on each face. Held vertices have no mass and are put on their paths.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import newton
import numpy as np
import warp as wp
from shot import Array, generate, on_faces, quads, save, sheet, skirt, smooth, turned

FPS, SUBSTEPS, ITERATIONS = 50, 12, 10


def simulate(
    x: Array, triangles: Array, held: Array, path: Callable[[float], Array] | None = None, *, frames: int = 100,
    density: float = 0.2, stiffness: float = 1000.0, bend: float = 1e-3, wind: Callable[[float], Array] | None = None,
    normal: float = 1.2, along: float = 0.05,
) -> Array:  # fmt: skip
    """Motion (frames, n, 3) of a sheet of so many kg/m² and N/m."""
    builder = newton.ModelBuilder()
    builder.add_cloth_mesh(
        pos=wp.vec3(0, 0, 0), rot=wp.quat_identity(), scale=1.0, vel=wp.vec3(0, 0, 0),
        vertices=[wp.vec3(*p) for p in x], indices=triangles.ravel().tolist(), density=density,
        tri_ke=stiffness, tri_ka=stiffness, tri_kd=1e-3,
        edge_ke=bend, edge_kd=1e-4, particle_radius=0.005,
    )  # fmt: skip
    for i in held:
        builder.particle_mass[i] = 0.0
        builder.particle_flags[i] = builder.particle_flags[i] & ~int(newton.ParticleFlags.ACTIVE)
    builder.color()
    model = builder.finalize(device="cpu")
    solver = newton.solvers.SolverVBD(model, iterations=ITERATIONS, particle_enable_self_contact=False)
    state, other, control = model.state(), model.state(), model.control()
    step, found = 1 / FPS / SUBSTEPS, [x.copy()]
    for frame in range(1, frames):
        for sub in range(SUBSTEPS):
            t = ((frame - 1) * SUBSTEPS + sub + 1) * step
            q, v = state.particle_q.numpy(), state.particle_qd.numpy()
            force = on_faces(q, v, triangles, wind(t) if wind else np.zeros(3), normal, along)
            state.particle_f.assign(force.astype(np.float32))
            if path:
                q = q.copy()
                q[held] = path(t)
                state.particle_q.assign(q)
                other.particle_q.assign(q)
            solver.step(state, other, control, None, step)
            state, other = other, state
        found.append(state.particle_q.numpy().astype(float).copy())
    return np.array(found)


def side(folder: Path, name: str) -> None:
    """A level sheet falls from one side, in air."""
    x, triangles, held = sheet(15, 17, 0.8, 1.0), quads(15, 17), np.arange(15) * 17
    motion = simulate(x, triangles, held, density=0.25)
    save(folder, name, motion, triangles, FPS, held, "Newton VBD, 1 x 0.8 m, level, one side held, in air")


def flag(folder: Path, name: str) -> None:
    """A flag whose pole is waved."""
    x, triangles, held = sheet(12, 18, 0.6, 1.0, upright=True), quads(12, 18), np.arange(12) * 18

    def path(t: float) -> Array:
        size = 0.3 * smooth(t / 0.5)
        return x[held] + size * np.array([0.0, np.sin(6.5 * t), 0.3 * np.sin(3 * t)])

    motion = simulate(x, triangles, held, path, frames=100, stiffness=2500.0)
    save(folder, name, motion, triangles, FPS, held, "Newton VBD, 1 x 0.6 m, pole waved in still air")


def in_wind(folder: Path, name: str) -> None:
    """An upright sheet, held at its upper side, in steady wind."""
    x, triangles, held = sheet(16, 15, 0.9, 0.8, upright=True), quads(16, 15), np.arange(15)
    motion = simulate(x, triangles, held, wind=lambda t: np.array([-1.0, 4.0, 0.0]), density=0.15)
    save(folder, name, motion, triangles, FPS, held, "Newton VBD, 0.9 x 0.8 m, upper side held, wind (-1, 4, 0) m/s")


def dress(folder: Path, name: str) -> None:
    """A skirt on a turning waist in wind."""
    x, triangles, held = skirt(12, 25, 0.13, 0.34, 0.55), quads(12, 25, closed=True), np.arange(25)

    def path(t: float) -> Array:
        return turned(x[held], 1.0 * smooth(t / 1.0) * np.sin(5 * t))

    motion = simulate(x, triangles, held, path, frames=100, wind=lambda t: np.array([1.5, 2.0, 0.0]))
    save(folder, name, motion, triangles, FPS, held, "Newton VBD, skirt of 0.55 m, waist turned, wind (1.5, 2, 0) m/s")


SHOTS = {"newton-side": side, "newton-flag": flag, "newton-wind": in_wind, "newton-skirt": dress}

if __name__ == "__main__":
    wp.config.quiet = True
    generate(SHOTS)
