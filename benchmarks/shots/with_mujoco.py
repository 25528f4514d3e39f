"""Shots of MuJoCo's flexible sheets: `python benchmarks/shots/with_mujoco.py FOLDER [NAME …]`. Needs `mujoco`.

Made with MuJoCo 4.0. Sheets are elastic (`flexcomp`, `elastic2d`) in steps of 0.1 ms. Held vertices are so heavy that
the cloth does not move them, and are put on their paths at each step. Air is a force on each face (panels), or
MuJoCo's own fluid forces on a box at each vertex. The nine of `windy` are those of docs/accuracy.md, as near as its
description goes: the way that the boxes hang is chosen so that they travel as far as there.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from shot import Array, generate, on_faces, quads, save, sheet

STEP, HEAVY = 1e-4, 1e5


def simulate(
    x: Array, triangles: Array, held: Array, path: Callable[[float], Array] | None = None, *, frames: int = 90,
    fps: int = 40, mass: float = 0.2, stiffness: float = 1500.0, bend: float = 0.002, damping: float = 2e-4,
    wind: Callable[[float], Any] | None = None, normal: float = 1.2, along: float = 0.0, ball: tuple[float, ...] = (),
    fluid: str = "", box: float = 0.02,
) -> Array:  # fmt: skip
    """Motion (frames, n, 3) of a sheet of so many kg and N/m, and of the thickness `bend`, m; `path` gives the held
    vertices' places at a time.
    """
    hard = "solref='0.002 1' solimp='0.99 0.999 0.001'"
    geom = "<geom type='sphere' size='{3}' pos='{0} {1} {2}' friction='0.5' {4}/>".format(*ball, hard) if ball else ""
    contact = "contype='1' conaffinity='1'" if ball else "contype='0' conaffinity='0'"
    xml = f"""<mujoco><option timestep='{STEP}' integrator='Euler' {fluid}/>
    <worldbody>{geom}<flexcomp name='c' type='direct' dim='2' radius='0.005' mass='{mass}' inertiabox='{box}'
    point='{" ".join(map(str, x.ravel()))}' element='{" ".join(map(str, triangles.ravel()))}'>
    <elasticity young='{stiffness / bend}' poisson='0.2' thickness='{bend}' elastic2d='both' damping='{damping}'/>
    <contact selfcollide='none' {contact} {hard}/></flexcomp></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    bodies = model.flex_vertbodyid
    dofs = model.body_dofadr[bodies][:, None] + np.arange(3)
    joints = model.jnt_qposadr[model.body_jntadr[bodies]][:, None] + np.arange(3)
    model.body_mass[bodies[held]] *= HEAVY
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    if np.abs(data.flexvert_xpos - x).max() > 1e-6:
        raise SystemExit("the vertices are not where they were put")
    found = [data.flexvert_xpos.copy()]
    each = round(1 / fps / STEP)
    for frame in range(1, frames):
        for sub in range(each):
            t = ((frame - 1) * each + sub + 1) * STEP
            if wind is not None:
                velocity = data.qvel[dofs]
                air = np.asarray(wind(t), float)
                data.qfrc_applied[dofs] = on_faces(data.flexvert_xpos, velocity, triangles, air, normal, along)
            now, before = (path(t), path(t - STEP)) if path else (x[held], x[held])
            data.qvel[dofs[held]] = (now - before) / STEP
            data.qpos[joints[held]] = before - x[held]
            mujoco.mj_step(model, data)
            data.qpos[joints[held]] = now - x[held]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_flex(model, data)
        found.append(data.flexvert_xpos.copy())
    return np.array(found)


def side(folder: Path, name: str) -> None:
    """A level sheet falls from one side."""
    x, triangles, held = sheet(15, 15, 1, 1), quads(15, 15), np.arange(15)
    motion = simulate(x, triangles, held, fps=50, frames=100)
    save(folder, name, motion, triangles, 50, held, "MuJoCo, 1 m, 0.2 kg, level, one side held")


def corners(folder: Path, name: str) -> None:
    """A level sheet falls from two corners of a diagonal, in air."""
    x, triangles, held = sheet(14, 16, 0.9, 1.1), quads(14, 16), np.array([0, 223])
    motion = simulate(x, triangles, held, fps=40, frames=90, stiffness=4000, wind=lambda t: (0, 0, 0))
    save(folder, name, motion, triangles, 40, held, "MuJoCo, 1.1 x 0.9 m, two opposite corners held, in air")


def wave(x: Array, size: float, rate: float, t: float) -> Array:
    """Places of held vertices that are waved across and along, from rest."""
    grown = min(1.0, 2 * t) ** 2 * (3 - 2 * min(1.0, 2 * t))
    moved = size * grown * np.array([0.4 * np.cos(rate * t) - 0.4, np.sin(rate * t), 0.3 * np.sin(2 * rate * t)])
    return np.asarray(x + moved)


def flag(folder: Path, name: str) -> None:
    """A flag whose pole is waved."""
    x, triangles = sheet(12, 18, 0.7, 1.1, upright=True), quads(12, 18)
    held = np.arange(12) * 18
    path = partial(wave, x[held], 0.3, 6.0)
    motion = simulate(
        x, triangles, held, path, fps=40, frames=100, mass=0.15, stiffness=4000, wind=lambda t: (0.0, 0.0, 0.0)
    )
    save(folder, name, motion, triangles, 40, held, "MuJoCo, 1.1 x 0.7 m, pole waved in still air")


def over_ball(folder: Path, name: str) -> None:
    """A sheet drops on a ball."""
    x, triangles, ball = sheet(17, 17, 1, 1, z=0.95), quads(17, 17), (0.05, 0.42, 0.6, 0.3)
    motion = simulate(x, triangles, np.array([0, 16]), fps=40, frames=70, mass=0.25, stiffness=4000, ball=ball)
    save(
        folder, name, motion, triangles, 40, np.array([0, 16]), "MuJoCo, 1 m, two corners held, drops on a ball",
        ball=np.array(ball),
    )  # fmt: skip


def in_wind(folder: Path, name: str) -> None:
    """An upright sheet, held at its upper side, in steady wind."""
    x, triangles, held = sheet(15, 15, 1, 1, upright=True), quads(15, 15), np.arange(15)
    motion = simulate(x, triangles, held, fps=40, frames=100, wind=lambda t: (1.0, 4.5, 0.5), along=0.05)
    save(folder, name, motion, triangles, 40, held, "MuJoCo, 1 m, upper side held, wind (1, 4.5, 0.5) m/s")


def twist(folder: Path, name: str) -> None:
    """A sheet hangs between two sides, one of which is turned."""
    x, triangles = sheet(20, 12, 1.0, 0.6, upright=True), quads(20, 12)
    top, bottom = np.arange(12), np.arange(228, 240)
    held = np.r_[top, bottom]

    def path(t: float) -> Array:
        angle, s = 2.2 * (1 - np.cos(np.pi * min(t / 1.5, 1.0))) / 2, min(t / 1.5, 1.0)
        c, n = np.cos(angle), np.sin(angle)
        low = x[bottom] @ np.array([[c, n, 0], [-n, c, 0], [0, 0, 1]]) + [0, 0, 0.3 * s * s * (3 - 2 * s)]
        return np.concatenate([x[top], low])

    motion = simulate(x, triangles, held, path, fps=40, frames=90, wind=lambda t: (0, 0, 0))
    save(folder, name, motion, triangles, 40, held, "MuJoCo, 0.6 x 1 m, lower side turned by 126 degrees and raised")


WINDY: list[tuple[str, tuple[float, float, float], dict[str, Any]]] = [
    ("panels", (-2, 1.5, -6), {}),
    ("panels", (4, 1, -3), {}),
    ("panels", (-0.5, -2, 7), {}),
    ("panels", (-2, 1.5, -6), {"mass": 0.4, "stiffness": 1500.0}),
    ("panels", (1.5, 0.5, -5), {"mass": 0.1}),
    ("panels", (3, 2, 4), {"corners": True, "along": 0.1, "stiffness": 2500.0}),
    ("boxes", (-4, 2, 0), {"box": 0.05}),
    ("boxes", (4, 1, -3), {"box": 0.03, "mass": 0.6, "stiffness": 1500.0}),
    ("boxes", (-7.4, 2.8, -0.2), {"box": 0.03, "corners": True, "side": 14, "stiffness": 3000.0}),
]
"""Air, wind, m/s, z up, and what else is different, of the sheets of docs/accuracy.md. Panels are level at first and
reach from their held side, along y, towards -x; boxes hang in the plane of y and z. The seventh's
wind is (-2, 0, -4) there, in axes with y up that are turned.
"""


def windy(folder: Path, name: str) -> None:
    """One of the sheets in wind of docs/accuracy.md."""
    air, wind, more = WINDY[int(name.rpartition("-")[2]) - 1]
    options = {"mass": 0.2, "stiffness": 1000.0, **more}
    n = options.pop("side", 12)
    if air == "panels":
        x, options["wind"] = sheet(n, n, 1, 1), lambda t: wind
    else:
        x = sheet(n, n, 1, 1, upright=True)
        options["fluid"] = "density='1.2' viscosity='1.8e-5' wind='{} {} {}'".format(*wind)
    x, triangles = x[:, [1, 0, 2]] * (-1.0, 1.0, 1.0), quads(n, n)
    held = np.array([0, n - 1]) if options.pop("corners", False) else np.arange(n)
    motion = simulate(x, triangles, held, fps=50, frames=80, **options)
    save(folder, name, motion, triangles, 50, held, f"MuJoCo, 1 m, {air}, wind {wind} m/s, z up")


SHOTS = {
    "mujoco-side": side, "mujoco-corner-pair": corners, "mujoco-flag": flag, "mujoco-ball": over_ball,
    "mujoco-wind": in_wind, "mujoco-twist": twist, **{f"windy-{k}": windy for k in range(1, 10)},
}  # fmt: skip

if __name__ == "__main__":
    generate(SHOTS)
