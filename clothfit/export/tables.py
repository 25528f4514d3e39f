"""Plain tables (CSV): one row per object, vertex and spring, for spreadsheets and scripts.

SI units, the scene's axes; the first line names the columns. Damping of a spring is (α/2) k, N s/m.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from clothfit.export.topology import roles
from clothfit.scene.scene import Scene

OBJECT_COLUMNS = ("object", "vertices", "springs", "triangles", "damping", "drag")
VERTEX_COLUMNS = ("object", "vertex", "x", "y", "z", "fixed", "mass")
SPRING_COLUMNS = ("object", "spring", "a", "b", "kind", "rest_length", "stiffness", "damping")


def files(scene: Scene) -> dict[str, bytes]:
    """The three tables."""
    objects, vertices, springs = [], [], []
    for number, cloth in enumerate(scene.cloths):
        counts = (len(cloth.mass), len(cloth.springs), len(cloth.triangles))
        objects.append((number, *counts, float(cloth.damping), float(cloth.drag)))
        places, fixed, mass = cloth.positions.tolist(), cloth.fixed.tolist(), cloth.mass.tolist()
        vertices += [(number, i, *x, int(f), m) for i, (x, f, m) in enumerate(zip(places, fixed, mass, strict=True))]
        damping = (0.5 * cloth.damping * cloth.stiffness).tolist()
        columns = (cloth.springs.tolist(), roles(cloth).names, cloth.rest.tolist(), cloth.stiffness.tolist(), damping)
        springs += [(number, s, *ends, *rest) for s, (ends, *rest) in enumerate(zip(*columns, strict=True))]
    return {
        "objects.csv": table(OBJECT_COLUMNS, objects),
        "vertices.csv": table(VERTEX_COLUMNS, vertices),
        "springs.csv": table(SPRING_COLUMNS, springs),
    }


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> bytes:
    """A table; numbers as Python writes them, which reads back as the same."""
    return "".join(f"{','.join(map(str, row))}\n" for row in (head, *rows)).encode()
