"""What the generators of shots share: meshes, the force of air on faces, and files that are checked when written.

Needs numpy only. A shot is an npz file: `positions` (frames, vertices, 3) float32, m, right-handed; `triangles`;
`fps`; `held`, the numbers of the vertices that are held, which may move; `up`, "y" or "z"; `note`; and `ball` (centre
and radius), where there is one.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray

AIR = 1.2
"""Density of air, kg/m³."""


def quads(rows: int, columns: int, closed: bool = False) -> Array:
    """Triangles (n, 3) of a grid of vertices, row by row; of a closed one, the last column joins the first."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns if closed else columns - 1), indexing="ij")
    a, b = i * columns + j, i * columns + (j + 1) % columns
    c, d = a + columns, b + columns
    odd = ((i + j) % 2 == 1)[..., None]
    first = np.where(odd, np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    second = np.where(odd, np.stack([b, d, c], -1), np.stack([a, d, c], -1))
    return np.stack([first, second], axis=2).reshape(-1, 3)


def sheet(rows: int, columns: int, height: float, width: float, upright: bool = False, z: float = 1.0) -> Array:
    """Vertices (rows · columns, 3) of a level sheet at height z, or of one that hangs upright from there, z up."""
    u, v = np.linspace(0, width, columns) - width / 2, np.linspace(0, height, rows)
    v, u = np.meshgrid(v, u, indexing="ij")
    still = np.zeros(u.size)
    return np.stack([u.ravel(), still, z - v.ravel()] if upright else [u.ravel(), v.ravel(), still + z], axis=1)


def skirt(rows: int, columns: int, waist: float, hem: float, length: float, z: float = 1.0) -> Array:
    """Vertices (rows · columns, 3) of a cone about the z axis, from its waist's to its hem's radius."""
    s = np.linspace(0, 1, rows)[:, None]
    angle = 2 * np.pi * np.arange(columns) / columns
    radius = waist + (hem - waist) * s
    x = np.stack(np.broadcast_arrays(radius * np.cos(angle), radius * np.sin(angle), z - length * s), axis=-1)
    return x.reshape(-1, 3)


def smooth(s: float) -> float:
    """From 0 at s = 0 to 1 at s = 1, at rest at both."""
    s = min(max(s, 0.0), 1.0)
    return s * s * (3 - 2 * s)


def turned(x: Array, angle: float) -> Array:
    """Points (n, 3) turned about the z axis."""
    c, s = np.cos(angle), np.sin(angle)
    return x @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def on_faces(x: Array, v: Array, triangles: Array, wind: Array, normal: float, along: float = 0.0) -> Array:
    """Force (n, 3) of the air: half its density times area and square of speed, apart by coefficients across and
    along each face.
    """
    a, b, c = (x[triangles[:, k]] for k in range(3))
    n = np.cross(b - a, c - a)
    twice = np.linalg.norm(n, axis=1, keepdims=True)
    n /= np.maximum(twice, 1e-12)
    w = wind - v[triangles].mean(axis=1)
    speed = np.linalg.norm(w, axis=1, keepdims=True)
    across = (w * n).sum(axis=1, keepdims=True) * n
    each = AIR / 2 * twice / 2 * speed * (normal * across + along * (w - across)) / 3
    force = np.zeros_like(x)
    for k in range(3):
        np.add.at(force, triangles[:, k], each)
    return force


def edges(triangles: Array) -> Array:
    """Edges (n, 2) of triangles, each once."""
    return np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)


def stretch(x: Array, triangles: Array) -> tuple[float, float]:
    """The largest of all edges' stretches of motion (frames, n, 3) relative to frame 0, and the 99th percentile of
    the frame where that is largest.
    """
    e = edges(triangles)
    length = np.linalg.norm(x[:, e[:, 0]] - x[:, e[:, 1]], axis=2)
    more = length / length[0] - 1
    return float(more.max()), float(np.quantile(more, 0.99, axis=1).max())


def measures(x: Array) -> tuple[float, float]:
    """Travel and the error of the best still picture, m: root mean squares, over all frames and vertices, of the
    distance from the first and from the mean frame.
    """
    travel, still = (float(np.sqrt(((x - each) ** 2).sum(axis=2).mean())) for each in (x[0], x.mean(axis=0)))
    return travel, still


def save(
    folder: Path, name: str, x: Array, triangles: Array, fps: float, held: Array, note: str, up: str = "z", **more: Any
) -> None:
    """Write a shot and print how far it moves and how much it stretches."""
    x = np.asarray(x, np.float32)
    held = np.asarray(held, np.int32)
    if not np.isfinite(x).all():
        print(f"{name}: not finite, not written")
        return
    travel, still = measures(x.astype(float))
    most, high = stretch(x.astype(float), triangles)
    step = float(np.linalg.norm(np.diff(x, axis=0), axis=2).max() * fps)
    print(
        f"{name}: {x.shape[1]} vertices, {len(x)} frames at {fps:g}, travel {1e3 * travel:.0f} mm, still "
        f"{1e3 * still:.0f} mm, stretch {high:.1%} (largest {most:.1%}), fastest {step:.1f} m/s",
        flush=True,
    )
    np.savez_compressed(
        folder / f"{name}.npz", positions=x, triangles=triangles.astype(np.int32), fps=float(fps), held=held,
        up=up, note=note, **more,
    )  # fmt: skip


def generate(shots: Mapping[str, Callable[[Path, str], None]]) -> None:
    """Write the shots that the command line names into its folder; all, if it names none."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[2:] or shots:
        shots[name](folder, name)
