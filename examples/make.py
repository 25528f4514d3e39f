"""Make the example scenes: `python examples/make.py` writes them, `--check` only checks that they are up to date.

Four cloths of 12 × 12 vertices over 7 m, as the editor would build them (`clothfit.mesh`). `README.md` beside this
file says what each holds and hides. Units: m, kg, s, N/m.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from clothfit.base.arrays import Flags
from clothfit.meshes import new_scene
from clothfit.meshes.mesh import Mesh, object_document, plane

FOLDER = Path(__file__).resolve().parent
DIVISIONS, SIZE = 10, 7.0
DIGITS = 12  # significant digits written; machines may differ in the digits after them
WIND = (106.066, 0.0, -106.066)  # 150 m/s; air drag grows with the cube of a face's area, here 0.2 m²
SPHERE_CENTRE, SPHERE_DIAMETER = (0.0, -4.1, 0.0), 8.0  # its top 0.1 m below the cloth


def side() -> dict[str, Any]:
    """A level cloth held at one side; hides one stiffness per spring."""
    mesh = plane(DIVISIONS, SIZE)
    return scene("side", mesh, at_edge(mesh, axis=2, sign=1), "nL")


def corners() -> dict[str, Any]:
    """A level cloth held at its four corners; hides one mass per vertex."""
    mesh = plane(DIVISIONS, SIZE)
    return scene("corners", mesh, at_edge(mesh, axis=0) & at_edge(mesh, axis=2), "Ln")


def flag() -> dict[str, Any]:
    """An upright cloth held at its windward side in a strong wind; hides one stiffness for all springs."""
    mesh = plane(DIVISIONS, SIZE, upright=True)
    return scene("flag", mesh, at_edge(mesh, axis=0, sign=-1), "nG", wind=WIND)


def drape() -> dict[str, Any]:
    """A level cloth held nowhere that falls on a sphere; hides one mass for all vertices."""
    mesh = plane(DIVISIONS, SIZE)
    sphere = {
        "type": 1,
        "pos": vector(SPHERE_CENTRE),
        "rot": vector((0.0, 0.0, 0.0)),
        "scale": vector((SPHERE_DIAMETER,) * 3),
    }
    return scene("drape", mesh, np.zeros(len(mesh.positions), bool), "Gn", colliders=[sphere])


SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    "side.json": side,
    "corners.json": corners,
    "flag.json": flag,
    "drape.json": drape,
}


def at_edge(mesh: Mesh, axis: int, sign: int = 0) -> Flags:
    """Which vertices (n,) lie at the upper (sign 1), lower (−1) or either (0) end of the mesh along an axis."""
    x = mesh.positions[:, axis]
    lower, upper = x == x.min(), x == x.max()
    chosen: Flags = {-1: lower, 0: lower | upper, 1: upper}[sign]
    return chosen


def scene(
    title: str,
    mesh: Mesh,
    fixed: Flags,
    settings: str,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    colliders: list[dict[str, Any]] | None = None,
) -> dict[str, Any]:
    """Make a scene of one cloth, in the order of fields in which the editor writes them."""
    cloth = object_document(mesh, fixed, density=0.1, stiffness=50.0, damping=0.1, drag=0.1, settings=settings)
    return {
        "integrationMethod": 2,
        "delta": 0.02,
        "tolerance": 1e-5,
        "optimizationIterations": 100,
        "objects": [cloth],
        "colliders": colliders or [],
        "windVel": vector(wind),
        "printTimes": False,
        "forwardSubSteps": 1,
        "title": title,
    }


def vector(xyz: tuple[float, ...]) -> dict[str, float]:
    """Name three components."""
    return dict(zip("xyz", xyz, strict=True))


def text(document: dict[str, Any]) -> str:
    """Write a scene as JSON."""
    return new_scene.text(rounded(document))


def rounded(value: Any) -> Any:
    """Round the numbers in a document to the digits that are written."""
    if isinstance(value, dict):
        return {name: rounded(item) for name, item in value.items()}
    if isinstance(value, list):
        return [rounded(item) for item in value]
    return float(f"{value:.{DIGITS}g}") + 0.0 if isinstance(value, float) else value  # + 0.0: no -0.0


def main() -> int:
    """Write the scenes, or check them; the exit code."""
    parser = argparse.ArgumentParser(description="Write the example scenes beside this file.")
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if a scene is not up to date")
    check = parser.parse_args().check
    wanted = {FOLDER / name: text(make()).encode() for name, make in SCENES.items()}
    stale = [path for path, data in wanted.items() if not path.is_file() or path.read_bytes() != data]
    for path in stale:
        if not check:
            path.write_bytes(wanted[path])
        print(f"{path.name}: {'not up to date; run python examples/make.py' if check else 'written'}")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
