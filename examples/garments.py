"""Make a garment as a mesh: `python examples/garments.py [FOLDER]` writes shirt.obj there.

It takes the place of a mesh from a garment tool: metres, y up, quads cut into triangles. `docs/gallery.md` shows what
is done with it.

- shirt: two panels, a front and a back, of one outline, sewn at the sides, the shoulders and along both sleeves; open
  at the neck, the hem and the cuffs. Its vertices stand on an ellipse across the body, so that it is worn, not flat.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]  # (n, 3), m; of a panel (n, 2)
Faces = NDArray[np.intp]  # (T, 3)

CHEST, LENGTH, ARMPIT, SHOULDER, NECK = 0.27, 0.70, 0.44, 0.66, 0.085
"""Half the width of the shirt, its length, the heights of armpit and shoulder's end, half the width of the neck, m."""

SLEEVE, CUFF, DEPTH = 0.24, 0.085, 0.11
"""Length of a sleeve, half the width of its cuff, and how far the front stands before the seams, m."""

ROWS, COLUMNS, SLEEVE_COLUMNS = 26, 20, 9  # cells of a panel, and of a sleeve
YOKE = 9  # the upper rows of the body, at which a sleeve begins


def shirt() -> tuple[Points, Faces]:
    """A T-shirt. The front and the back share the vertices of their seams."""
    flat, cells = outline()
    depth = DEPTH * bulge(flat)
    seam = depth == 0.0
    front = np.column_stack([flat, depth])
    count = len(flat)
    own = np.cumsum(~seam) - 1 + count  # numbers of the back's own vertices
    back = np.where(seam, np.arange(count), own)
    behind = np.column_stack([flat, -0.8 * depth])[~seam]
    neck = front[:, 1] > SHOULDER  # the front of the neck is cut lower than the back
    front[neck, 1] -= 0.06 * np.clip(1.0 - (front[neck, 0] / NECK) ** 2, 0.0, 1.0)
    return np.concatenate([front, behind]), np.concatenate([triangles(cells), triangles(back[cells])[:, ::-1]])


def outline() -> tuple[Points, Faces]:
    """The panel of a shirt, (n, 2), and its cells (K, 4)."""
    grid = np.zeros((ROWS + 1, COLUMNS + 1, 2))
    for row in range(ROWS + 1):
        lower = row <= ROWS - YOKE
        across = np.linspace(-1.0, 1.0, COLUMNS + 1)
        if lower:
            height = ARMPIT * row / (ROWS - YOKE) * np.ones(COLUMNS + 1)
            half = CHEST + 0.02 * (1.0 - row / (ROWS - YOKE))
        else:
            share = (row - ROWS + YOKE) / YOKE
            half = CHEST - 0.045 * np.sin(0.5 * np.pi * share)
            top = np.interp(np.abs(across * half), [NECK, half], [LENGTH, SHOULDER])
            height = ARMPIT + share * (top - ARMPIT)
        grid[row, :, 0], grid[row, :, 1] = half * across, height
    points, cells = [grid.reshape(-1, 2)], [quads(np.arange(grid[..., 0].size).reshape(ROWS + 1, COLUMNS + 1))]
    count = grid[..., 0].size
    for side, edge in ((1, COLUMNS), (-1, 0)):
        root = np.arange(ROWS - YOKE, ROWS + 1) * (COLUMNS + 1) + edge
        begin = grid[ROWS - YOKE :, edge]
        share = np.linspace(0.0, 1.0, YOKE + 1)[:, None]
        end = np.array([side * (CHEST + SLEEVE), 0.50]) + (share - 0.5) * 2.0 * CUFF * np.array([side * 0.45, 0.9])
        along = np.linspace(0.0, 1.0, SLEEVE_COLUMNS + 1)[1:]
        sleeve = begin[:, None] + along[:, None] * (end - begin)[:, None]
        numbers = np.column_stack([root, count + np.arange(sleeve[..., 0].size).reshape(YOKE + 1, -1)])
        count += sleeve[..., 0].size
        points.append(sleeve.reshape(-1, 2))
        cells.append(quads(numbers)[:, ::side])
    return np.concatenate(points), np.concatenate(cells)


def bulge(flat: Points) -> Points:
    """How far each vertex (n,) of the panel stands before its seams, 0 … 1: that of an ellipse over the width."""
    body = (COLUMNS + 1) * (ROWS + 1)
    found = np.zeros(len(flat))
    row, column = np.divmod(np.arange(body), COLUMNS + 1)
    across = 2.0 * column / COLUMNS - 1.0
    share = np.clip((row - ROWS + YOKE) / YOKE, 0.0, 1.0)
    side = np.where(share > 0.0, 0.35 * share, 0.0)  # the armholes stand open: sleeves begin there
    round_body = np.sqrt(np.clip(1.0 - across**2 * (1.0 - side), 0.0, 1.0))
    top = np.sqrt(np.clip(1.0 - share**3, 0.0, 1.0))
    neck = np.clip(1.0 - np.abs(flat[:body, 0]) / NECK, 0.0, 1.0) ** 0.5 * 0.45
    found[:body] = np.maximum(round_body * top, np.where(row == ROWS, neck, 0.0))
    rest = np.arange(len(flat) - body) % ((YOKE + 1) * SLEEVE_COLUMNS)
    line, out = np.divmod(rest, SLEEVE_COLUMNS)
    tube = np.sqrt(np.clip(1.0 - (2.0 * line / YOKE - 1.0) ** 2, 0.0, 1.0))
    found[body:] = tube * (0.60 + 0.10 * (out + 1) / SLEEVE_COLUMNS)
    found[found < 1e-7] = 0.0  # of rounding
    return found


def quads(numbers: Faces) -> Faces:
    """The cells (K, 4) of a grid of vertices."""
    return np.stack([numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, 1:], numbers[1:, :-1]], axis=-1).reshape(-1, 4)


def triangles(cells: Faces) -> Faces:
    """Two triangles (2 K, 3) for each cell, along one diagonal or the other in turn."""
    turned = np.where((np.arange(len(cells)) % 2 == 0)[:, None], cells, np.roll(cells, 1, axis=1))
    return np.concatenate([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]])


GARMENTS: dict[str, Callable[[], tuple[Points, Faces]]] = {"shirt": shirt}


def text(points: Points, faces: Faces) -> str:
    """A mesh as an OBJ file."""
    lines = ["v " + " ".join(f"{value:.6g}" for value in point) for point in points + 0.0]
    return "\n".join([*lines, *("f " + " ".join(str(1 + vertex) for vertex in face) for face in faces)]) + "\n"


def main() -> None:
    """Write them."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    folder.mkdir(parents=True, exist_ok=True)
    for name, make in GARMENTS.items():
        (folder / f"{name}.obj").write_text(text(*make()), encoding="ascii")


if __name__ == "__main__":
    main()
