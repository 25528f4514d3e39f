"""Make the keys and scenes of controlled cloths: `python examples/keyframes/make.py [FOLDER]`, by default beside this
file.

`README.md` beside this file says what each shows. Units: m, kg, s, N/m; y is up.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clothfit
from clothfit.meshes import new_scene
from clothfit.meshes.mesh import Mesh, air_drag, object_document, plane

Array = NDArray[np.float64]

DIGITS, PLACES = 7, 4  # significant digits of scenes, digits after the point of keys
STEP = 0.02
WAVE, HEIGHT = 4.5, 0.45  # m: length of the flag's wave along the cloth, and its height
LAID, STAYS = 1.2, 1.6  # s: when the sheet lies, and until when it stays
WIDTH, PLEATS, DRAWN, HELD = 1.6, 2, 0.6, 2.0  # m: of the curtain; pleats; share of the width when drawn; s until then
FLOOR = 0.005  # m: thickness of the floor's contact, where a cloth comes to rest


def flag_keys() -> dict[str, Any]:
    """A wave along the flag of `../flag.json` at 1 s, and the flag as it was, at rest, at 2 s."""
    start = plane(10, 7.0, upright=True).positions
    along, y = start[:, 0] - start[:, 0].min(), start[:, 1]
    s = np.linspace(0.0, along.max(), 2001)
    growing = np.clip(s / WAVE, 0.0, 1.0)
    bent = HEIGHT * growing * np.sin(2.0 * np.pi * s / WAVE)
    ahead = np.sqrt(1.0 - np.gradient(bent, s) ** 2)  # the wave is as long as the cloth
    x = np.concatenate([[0.0], np.cumsum(0.5 * (ahead[1:] + ahead[:-1]) * np.diff(s))])
    wave = np.stack([start[:, 0].min() + np.interp(along, s, x), y, np.interp(along, s, bent)], axis=1)
    return {"keys": [posed(1.0, wave), at_rest(2.0, start)]}


def sheet() -> dict[str, Any]:
    """A sheet that is thrown upright, and turning, over a floor."""
    mesh = plane(10, 1.2, upright=True)
    x = mesh.positions.copy()
    x[:, 2] += 0.05 * np.sin(4.0 * x[:, 0]) * np.cos(3.0 * x[:, 1])  # it is no board
    x += (-1.8, 1.0, 0.0)
    cloth = fabric(Mesh(x, mesh.triangles), np.zeros(len(x), bool))
    cloth["vertVel"] = [vector(row) for row in np.array([1.6, 2.5, 0.0]) + np.cross((0.0, 1.5, 0.0), x - x.mean(0))]
    floor = {"type": 0, "pos": vector((0.0, 0.0, 0.0)), "rot": vector((0.0, 0.0, 0.0)), "scale": vector((1.0,) * 3),
             "thickness": FLOOR, "stiffness": 100.0, "friction": 0.3}  # fmt: skip
    return scene("sheet", cloth, STAYS, [floor])


def sheet_keys() -> dict[str, Any]:
    """The sheet flat on a square of the floor."""
    flat = plane(10, 1.2).positions + (0.0, FLOOR, 0.0)
    return {"keys": [at_rest(LAID, flat), at_rest(STAYS, flat)]}


def curtain() -> dict[str, Any]:
    """A curtain that hangs from its two upper corners."""
    mesh = plane(10, WIDTH, upright=True)
    x = mesh.positions.copy()
    x[:, 2] = 0.04 * np.sin(2.0 * np.pi * PLEATS * (x[:, 0] / WIDTH + 0.5))  # it remembers its pleats
    mesh = Mesh(x, mesh.triangles)
    held = (x[:, 1] > x[:, 1].max() - 1e-6) & (np.abs(x[:, 0]) > 0.5 * WIDTH - 1e-6)
    return scene("curtain", fabric(mesh, held), HELD)


def curtain_keys() -> dict[str, Any]:
    """The folds of the curtain after its corners were drawn together at an even pace, and held: reachable, though the
    way there is not told.
    """
    document = curtain()
    corners = [i for i, fixed in enumerate(document["objects"][0]["vertIsFixed"]) if fixed]
    inward = 0.5 * (1.0 - DRAWN) * WIDTH
    document["objects"][0]["pins"] = [
        {"vertices": [corner], "posKeys": {"times": [0.0, 1.2], "values": [vector((0, 0, 0)), vector((move, 0, 0))]}}
        for corner, move in zip(corners, (inward, -inward), strict=True)
    ]
    motion = clothfit.simulate(clothfit.load(document))
    return {"keys": [posed(HELD, motion.positions[-1])]}


def fabric(mesh: Mesh, fixed: NDArray[np.bool_]) -> dict[str, Any]:
    """An object of a mesh, of 0.2 kg/m², dragged by air as real cloth at 2 m/s."""
    return object_document(
        mesh, fixed, density=0.2, stiffness=30.0, damping=0.3, drag=air_drag(mesh, 2.0), settings="nn"
    )


def scene(
    title: str, cloth: dict[str, Any], seconds: float, colliders: list[dict[str, Any]] | None = None
) -> dict[str, Any]:
    """Make a scene of one cloth that lasts until a time."""
    return {
        "integrationMethod": 2,
        "delta": STEP,
        "tolerance": 1e-9,
        "optimizationIterations": round(seconds / STEP) + 1,
        "objects": [cloth],
        "colliders": colliders or [],
        "planes": "solid",
        "windVel": vector((0.0, 0.0, 0.0)),
        "printTimes": False,
        "forwardSubSteps": 1,
        "title": title,
    }


def posed(time: float, x: Array) -> dict[str, Any]:
    """A key of positions (n, 3)."""
    return {"time": time, "positions": (np.round(x, PLACES) + 0.0).tolist()}


def at_rest(time: float, x: Array) -> dict[str, Any]:
    """A key of positions (n, 3) without motion."""
    return {**posed(time, x), "velocities": np.zeros_like(x).astype(int).tolist()}


def vector(xyz: Any) -> dict[str, float]:
    """Name three components."""
    return {name: float(value) for name, value in zip("xyz", xyz, strict=True)}


def rounded(value: Any) -> Any:
    """Round the numbers in a document to the digits that are written."""
    if isinstance(value, dict):
        return {name: rounded(item) for name, item in value.items()}
    if isinstance(value, list):
        return [rounded(item) for item in value]
    return float(f"{value:.{DIGITS}g}") + 0.0 if isinstance(value, float) else value  # + 0.0: no -0.0


def keys_text(document: dict[str, Any]) -> str:
    """Keys as JSON, a line for each."""
    rows = ",\n".join(json.dumps(key, separators=(",", ":")) for key in document["keys"])
    return f'{{"keys": [\n{rows}\n]}}\n'


def files() -> dict[str, str]:
    """The names and texts of all files that need no simulation, whose last digits depend on the machine."""
    scenes = {f"{make.__name__}.json": new_scene.text(rounded(make())) for make in (sheet, curtain)}
    keys = {"flag.keys.json": flag_keys(), "sheet.keys.json": sheet_keys()}
    return scenes | {name: keys_text(document) for name, document in keys.items()}


def main() -> None:
    """Write them."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent
    folder.mkdir(parents=True, exist_ok=True)
    curtains = {"curtain.keys.json": keys_text(curtain_keys())}
    for name, text in (files() | curtains).items():
        (folder / name).write_text(text, encoding="ascii")


if __name__ == "__main__":
    main()
