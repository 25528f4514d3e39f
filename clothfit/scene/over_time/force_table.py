"""Forces as a table (CSV): a line for each step and vertex, for spreadsheets, scripts and engines.

    time,vertex,fx,fy,fz

Times in s, forces in N, in the axes of the scene, the vertices of all objects counted in file order. Numbers are
written so that they read back as the same. Vertices without any force are left out; what is left out is 0.
"""

from __future__ import annotations

import io
from typing import IO

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.memory import human, missing
from clothfit.base.reading import whole

COLUMNS = ("time", "vertex", "fx", "fy", "fz")

MOST_BYTES = 2_000_000_000
"""Largest table that is read."""


def encoded(times: Array, forces: Array) -> bytes:
    """The table of forces (R, n, 3), N, in rows that begin to act at `times` (R,), s."""
    pushed = np.flatnonzero(forces.any(axis=(0, 2)))
    pushed = pushed if len(pushed) else np.zeros(1, int)  # so that the times are known
    numbers = [str(vertex) for vertex in pushed.tolist()]
    lines = [",".join(COLUMNS)]
    for time, row in zip(times.tolist(), forces[:, pushed].tolist(), strict=True):
        lines += [f"{time},{vertex},{x},{y},{z}" for vertex, (x, y, z) in zip(numbers, row, strict=True)]
    return ("\n".join(lines) + "\n").encode()


def arrays(file: IO[bytes], vertices: int | None) -> dict[str, Array]:
    """`times` (R,) and `forces` (R, n, 3) of a table for so many vertices, None: up to the last that it names. Raises
    OSError and ValueError.
    """
    text = whole(file, MOST_BYTES).decode("utf-8-sig")
    head, _, body = text.partition("\n")
    if tuple(part.strip() for part in head.split(",")) != COLUMNS:
        raise ValueError(f"its first line must be {','.join(COLUMNS)}")
    if not body.strip():
        raise ValueError("it has no line of forces")
    table = np.loadtxt(io.StringIO(body), delimiter=",", ndmin=2, comments=None)
    if table.shape[1] != len(COLUMNS):
        raise ValueError(f"its lines have {table.shape[1]} numbers; {len(COLUMNS)} are needed")
    times, row = np.unique(table[:, 0], return_inverse=True)
    vertex = table[:, 1]
    if vertices is None:
        vertices = int(np.clip(np.nan_to_num(vertex.max()), 0.0, 1e9)) + 1
    wrong = np.flatnonzero(~((vertex >= 0) & (vertex < vertices) & (vertex == np.floor(vertex))))
    if len(wrong):
        raise ValueError(f"line {wrong[0] + 2}: {vertex[wrong[0]]:g} is no vertex; there are {vertices}, from 0")
    place = row * vertices + vertex.astype(np.int64)
    if len(np.unique(place)) < len(place):
        raise ValueError("a vertex has two forces at one time")
    free = missing(8 * 3 * len(times) * vertices)
    if free is not None:
        raise ValueError(f"it takes more memory than the {human(free)} that are free")
    forces = np.zeros((len(times) * vertices, 3))
    forces[place] = table[:, 2:]
    return {"times": times, "forces": forces.reshape(len(times), vertices, 3)}
