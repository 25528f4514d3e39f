"""Shots of woven sheets that do not stretch along their yarns: `python benchmarks/shots/inextensible.py FOLDER
[NAME …]`. Needs numpy and scipy.

A grid of rods, projected onto their lengths at each step to a part in 10,000 (fast projection of Goldenthal and
others, 2007, with Newton's method on all rods at once), with soft springs along the diagonals of its quads (shear) and
over two rods (bending), and air as in `shot.on_faces`. A ball keeps vertices outside, with friction. Nothing here is
shared with clothfit.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from shot import Array, generate, on_faces, quads, save, sheet, skirt, smooth, turned

STEP, NEAR = 1 / 960, 1e-4
GRAVITY = np.array([0, 0, -9.81])


def lines(rows: int, columns: int, closed: bool) -> tuple[Array, Array, Array]:
    """Pairs (n, 2) of vertices of a grid: rods along its yarns, diagonals, and ends of two rods in line."""
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")

    def pairs(down: int, right: int) -> Array:
        other = (j + right) % columns if closed else j + right
        there = (i + down < rows) & (other >= 0) & (other < columns)
        return np.stack([(i * columns + j)[there], ((i + down) * columns + other)[there]], axis=1)

    return (
        np.concatenate([pairs(0, 1), pairs(1, 0)]),
        np.concatenate([pairs(1, 1), pairs(1, -1)]),
        np.concatenate([pairs(0, 2), pairs(2, 0)]),
    )


def simulate(
    x: Array, grid: tuple[int, int], held: Array, path: Callable[[float], Array] | None = None, *, frames: int = 90,
    fps: int = 30, density: float = 0.15, shear: float = 8.0, bend: float = 0.4, loss: float = 8e-4,
    wind: Callable[[float], Array] | None = None, normal: float = 1.1, along: float = 0.05, closed: bool = False,
    ball: tuple[float, ...] = (), friction: float = 0.4, rest: Array | None = None,
) -> Array:  # fmt: skip
    """Motion (frames, n, 3); `density` in kg/m², `shear` and `bend` in N/m, `loss` the springs' damping over their
    stiffness, s; `rest` the vertices where nothing is strained, at first `x`.
    """
    triangles, (rods, across, over) = quads(*grid, closed), lines(*grid, closed)
    base, x, n = x if rest is None else rest, x.copy(), len(x)
    area = np.linalg.norm(np.cross(*(base[triangles[:, k]] - base[triangles[:, 0]] for k in (1, 2))), axis=1) / 2
    mass = density / 3 * np.bincount(triangles.ravel(), np.repeat(area, 3), n)
    inverse = 1 / mass
    inverse[held] = 0.0
    lengths = np.linalg.norm(base[rods[:, 0]] - base[rods[:, 1]], axis=1)
    rods, lengths = (each[inverse[rods].sum(axis=1) > 0] for each in (rods, lengths))
    springs = np.concatenate([across, over])
    k = np.r_[np.full(len(across), shear), np.full(len(over), bend)]
    long = np.linalg.norm(base[springs[:, 0]] - base[springs[:, 1]], axis=1)
    weights = sp.diags(np.repeat(inverse, 3))
    v, found = np.zeros_like(x), [x.copy()]
    for frame in range(1, frames):
        for sub in range(round(1 / fps / STEP)):
            t = (frame - 1) / fps + (sub + 1) * STEP
            force = on_faces(x, v, triangles, wind(t) if wind else np.zeros(3), normal, along)
            d, u = (each[springs[:, 1]] - each[springs[:, 0]] for each in (x, v))
            length = np.linalg.norm(d, axis=1)
            pull = (k * (length - long + loss * (d * u).sum(axis=1) / length) / length)[:, None] * d
            np.add.at(force, springs[:, 0], pull)
            np.add.at(force, springs[:, 1], -pull)
            before = x
            v = v + STEP * (inverse[:, None] * force + GRAVITY)
            x = x + STEP * v
            x[held] = path(t) if path else before[held]
            for _ in range(30):
                d = x[rods[:, 1]] - x[rods[:, 0]]
                length = np.linalg.norm(d, axis=1)
                gaps, rows, signs = length - lengths, [rods[:, 0], rods[:, 1]], [-d / length[:, None]]
                signs.append(-signs[0])
                places = [np.arange(len(rods))] * 2
                if ball:
                    away = x - ball[:3]
                    deep = np.linalg.norm(away, axis=1) - ball[3]
                    inside = np.flatnonzero((deep < 0) & (inverse > 0))
                    gaps = np.r_[gaps, deep[inside]]
                    rows.append(inside)
                    signs.append(away[inside] / (deep[inside] + ball[3])[:, None])
                    places.append(len(rods) + np.arange(len(inside)))
                if np.abs(gaps).max() < NEAR * lengths.mean():
                    break
                row = np.repeat(np.concatenate(places), 3)
                column = (3 * np.concatenate(rows)[:, None] + np.arange(3)).ravel()
                jacobian = sp.csr_array((np.concatenate(signs).ravel(), (row, column)), shape=(len(gaps), 3 * n))
                system = (jacobian @ weights @ jacobian.T).tocsc()
                system = system + 1e-5 * sp.diags(system.diagonal())
                x = x - (weights @ (jacobian.T @ splu(sp.csc_matrix(system)).solve(gaps))).reshape(n, 3)
            v = (x - before) / STEP
            if ball:
                touched = np.linalg.norm(x - ball[:3], axis=1) < 1.003 * ball[3]
                v[touched] *= 1 - min(1.0, friction * 9.81 * STEP * 10)
        found.append(x.copy())
    return np.array(found)


def blown(wind: tuple[float, float, float], gust: float, density: float, shear: float, corners: bool):
    """A woven sheet in wind, held at its upper side or at two corners."""

    def make(folder: Path, name: str) -> None:
        grid = (17, 15)
        x = sheet(*grid, 0.9, 0.8, upright=True)
        held = np.array([0, 14]) if corners else np.arange(15)
        air = np.array(wind)
        motion = simulate(
            x, grid, held, wind=lambda t: air * (1 + gust * np.sin(5 * t)), density=density, shear=shear, frames=80,
            rest=x,
        )  # fmt: skip
        note = f"woven, {density} kg/m², wind {wind} m/s, {'two corners' if corners else 'upper side'} held"
        save(folder, name, motion, quads(*grid), 30, held, note)

    return make


def flag(folder: Path, name: str) -> None:
    """A woven flag, waved."""
    grid = (12, 19)
    x, held = sheet(*grid, 0.66, 1.08, upright=True), 19 * np.arange(12)

    def path(t: float) -> Array:
        size = 0.28 * smooth(t / 0.5)
        return x[held] + size * np.array([0.3 * np.cos(5 * t) - 0.3, np.sin(5 * t), 0.35 * np.sin(10 * t)])

    motion = simulate(x, grid, held, path, frames=90, shear=40.0)
    save(folder, name, motion, quads(*grid), 30, held, "woven flag, 1.08 x 0.66 m, 0.15 kg/m², waved in still air")


def dress(turns: float, sway: float, wind: tuple[float, float, float]):
    """A woven skirt, its waist turned to and fro and moved."""

    def make(folder: Path, name: str) -> None:
        grid = (12, 25)
        x, held = skirt(*grid, 0.13, 0.36, 0.6), np.arange(25)

        def path(t: float) -> Array:
            moved = np.array([sway * np.sin(4 * t), 0, 0]) * smooth(t / 0.5)
            return turned(x[held], turns * smooth(t / 1.5) * np.sin(3.5 * t)) + moved

        motion = simulate(
            x, grid, held, path, frames=80, closed=True, wind=lambda t: np.array(wind), density=0.2, shear=40.0
        )
        note = f"woven skirt, 0.6 m long, waist turned by {turns} rad and moved by {sway} m, wind {wind} m/s"
        save(folder, name, motion, quads(*grid, closed=True), 30, held, note)

    return make


def over_ball(folder: Path, name: str) -> None:
    """A woven sheet drops on a ball."""
    grid, ball = (17, 17), (0.04, 0.4, 0.62, 0.28)
    x, held = sheet(*grid, 0.9, 0.9), np.zeros(0, int)
    motion = simulate(x, grid, held, frames=60, fps=40, ball=ball, density=0.2, shear=30.0)
    save(folder, name, motion, quads(*grid), 40, held, "woven, 0.9 m, drops on a ball", ball=np.array(ball))


SHOTS = {
    "woven-wind-1": blown((0.8, 4.0, 0.3), 0.0, 0.12, 6.0, False),
    "woven-wind-2": blown((-0.5, 5.0, -1.0), 0.0, 0.2, 15.0, True),
    "woven-wind-3": blown((2.0, 3.0, 0.0), 0.4, 0.15, 14.0, True),
    "woven-flag": flag,
    "woven-skirt-1": dress(1.2, 0.0, (0.0, 2.5, 0.0)),
    "woven-skirt-2": dress(0.5, 0.12, (2.0, 1.0, 0.0)),
    "woven-ball": over_ball,
}

if __name__ == "__main__":
    generate(SHOTS)
