"""Make the scenes in which the world moves: `python examples/world/make.py [FOLDER]`, by default beside this file.

`README.md` beside this file says what each shows and hides. Units: m, kg, s, N/m; y is up.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.meshes import new_scene
from clothfit.meshes.mesh import Mesh, air_drag, object_document, plane

Array = NDArray[np.float64]

DIGITS = 7  # significant digits written
STEP, FRAMES = 0.02, 80
WIND = 9.0  # m/s, of the flag
FRICTION = 0.2  # of the table
OFFSET = (0.015, -0.01, 0.008)  # m, of the figure in its cape

SPEED, CADENCE = 1.3, 0.9
"""Of the walk, m/s, and of its pairs of steps, 1/s."""

FIGURE: dict[str, tuple[float, float, float]] = {
    "head": (0.10, 0.10, 0.04), "torso": (0.13, 0.16, 0.30), "hips": (0.15, 0.14, 0.10),
    "left thigh": (0.07, 0.09, 0.36), "right thigh": (0.07, 0.09, 0.36),
    "left shin": (0.045, 0.065, 0.36), "right shin": (0.045, 0.065, 0.36),
    "left arm": (0.04, 0.05, 0.46), "right arm": (0.04, 0.05, 0.46),
}  # fmt: skip
"""Capsules: radius below and above, and the distance between the centres of their ends, m."""


class Pose(NamedTuple):
    """Where a part of the figure is at each of K times."""

    centre: Array  # (K, 3), m
    swing: Array  # (K,), degrees about z


def cape() -> dict[str, Any]:
    """A cape on a walking figure of capsules; hides one factor on all stiffnesses, and where the figure is in it."""
    rows, columns = 14, 18
    share, angle = np.linspace(0.0, 1.0, rows + 1), np.radians(np.linspace(-112, 112, columns + 1))
    down, around = np.meshgrid(share, angle, indexing="ij")
    wide, deep = 0.18 + 0.26 * down**0.3, 0.17 + 0.18 * down**0.7
    x, z = -deep * np.cos(around), wide * np.sin(around)
    y = 1.47 - 0.05 * np.abs(np.sin(around)) * (1.0 - down) - 1.0 * down
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    fixed = np.arange(len(points)) <= columns
    cloth = garment(Mesh(points, grid(rows, columns)), fixed, stiffness=30.0, settings="nF")
    times = np.arange(0.0, STEP * FRAMES + 0.1, 0.1)
    poses = walk(times)
    cloth["pins"] = [{"vertices": list(range(columns + 1)), "posKeys": keys(times, poses["torso"].centre)}]
    limbs = [capsule(name, pose, times) for name, pose in poses.items()]
    made = scene("cape", cloth, [*limbs, collider(0, (0.0, 0.0, 0.0))])
    return {**made, "colliderOffset": vector(OFFSET), "fit": {"colliderOffset": "G"}}


def walk(times: Array) -> dict[str, Pose]:
    """The figure at times (K,), s: it starts from standing, and walks along x."""
    going = np.clip(times / 0.6, 0.0, 1.0)  # how much of a walk it is by then
    phase = 2.0 * np.pi * CADENCE * times
    steady = np.cumsum(going) * (times[1] - times[0])
    body = np.stack([SPEED * steady, 0.025 * going * (np.cos(2 * phase) - 1.0), np.zeros_like(times)], axis=1)
    still = np.zeros_like(times)
    found = {name: Pose(body + (0.0, y, 0.0), still) for name, y in (("head", 1.66), ("torso", 1.20), ("hips", 0.94))}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        leg, arm = sign * 30.0 * going * np.sin(phase), -sign * 24.0 * going * np.sin(phase)
        bend = leg - 22.0 * going * (1.0 + sign * np.sin(phase - 1.2))
        hip = body + (0.0, 0.88, 0.10 * sign)
        found[f"{side} thigh"] = Pose(hang(hip, leg, 0.215), leg)
        found[f"{side} shin"] = Pose(hang(hang(hip, leg, 0.43), bend, 0.21), bend)
        found[f"{side} arm"] = Pose(hang(body + (0.0, 1.36, 0.205 * sign), arm, 0.27), arm)
    return found


def hang(joint: Array, swing: Array, length: float) -> Array:
    """A place (K, 3) so far below a joint, on a limb that swings by so many degrees about z."""
    angle = np.radians(swing)
    return np.asarray(joint + length * np.stack([np.sin(angle), -np.cos(angle), np.zeros_like(angle)], axis=1))


def capsule(name: str, pose: Pose, times: Array) -> dict[str, Any]:
    """A limb that moves."""
    low, high, height = FIGURE[name]
    turn = np.stack([np.zeros_like(times), np.zeros_like(times), pose.swing], axis=1)
    limb = collider(2, pose.centre[0], friction=0.3)
    limb |= {"radius": low, "radius2": high, "height": height, "posKeys": keys(times, pose.centre)}
    return limb | ({"rotKeys": keys(times, turn)} if pose.swing.any() else {})


def curtain() -> dict[str, Any]:
    """A curtain that is drawn along its rail; hides damping and one factor on all stiffnesses."""
    mesh = plane(23, 2.0, 1.25, upright=True)
    x = mesh.positions.copy()
    x[:, 2] = 0.03 * np.sin(2.0 * np.pi * (x[:, 0] + 1.0) / 0.5)  # it is no board
    top = np.flatnonzero(x[:, 1] == x[:, 1].max())
    hooks = top[::3]
    cloth = garment(Mesh(x, mesh.triangles), np.isin(np.arange(len(x)), hooks), stiffness=20.0, settings="nF")
    cloth["fit"] = {"damping": "G"}
    cloth["pins"] = []
    for k, hook in enumerate(hooks):
        way = np.zeros((3, 3))
        way[1:, 0] = -0.6 * 2.0 * k / 8  # the first hook stays
        cloth["pins"].append({"vertices": [int(hook)], "posKeys": keys(np.array([0.0, 1.0, 1.6]), way)})
    return scene("curtain", cloth, [])


def tablecloth() -> dict[str, Any]:
    """A cloth that is laid over a box, with friction, not in its middle; hides the coefficient of friction."""
    mesh = plane(20, 1.2)
    x = mesh.positions + (0.10, 0.03, 0.06)
    cloth = garment(Mesh(x, mesh.triangles), np.zeros(len(x), bool), stiffness=25.0, settings="nn")
    table = collider(3, (0.0, -0.36, 0.0), size=(0.7, 0.7, 0.5), friction=FRICTION, thickness=0.02)
    floor = collider(0, (0.0, -0.71, 0.0), friction=FRICTION)
    return {**scene("tablecloth", cloth, [table, floor], newton=3), "fit": {"friction": "G"}}


def flag(wind: dict[str, Any] | None = None, title: str = "flag", settings: str = "nF") -> dict[str, Any]:
    """A flag in the gusts of a file; hides one factor on all stiffnesses."""
    mesh = plane(11, 1.8, 1.2, upright=True)
    pole = mesh.positions[:, 0] == mesh.positions[:, 0].min()
    cloth = garment(mesh, pole, stiffness=60.0, settings=settings, speed=WIND)
    made = scene(title, cloth, [], wind=(WIND, 0.0, 1.0))
    made["windVelKeys"] = wind or {"file": "gusts.csv"}
    return made


def calm() -> dict[str, Any]:
    """The same flag without gusts, whose values are to be found: a vector each 0.1 s."""
    times = np.arange(0.0, STEP * FRAMES + 0.05, 0.1)
    made = flag(keys(times, np.zeros((len(times), 3)), "linear"), "calm", "nn")
    return {**made, "fit": {"windVelKeys": "L"}}


def gusts() -> str:
    """Wind over time: what is added to the mean, m/s, ten times a second."""
    times = np.arange(0.0, STEP * FRAMES + 0.05, 0.1)
    rng = np.random.default_rng(7)
    noise = rng.normal(size=(len(times), 3)) * (2.0, 0.6, 2.0)
    slow = np.zeros_like(noise)
    for k in range(1, len(times)):
        slow[k] = 0.8 * slow[k - 1] + 0.6 * noise[k]
    rows = [f"{t:.1f},{x:.3f},{y:.3f},{z:.3f}" for t, (x, y, z) in zip(times, slow + 0.0, strict=True)]
    return "\n".join(["time,x,y,z", *rows]) + "\n"


def layers() -> dict[str, Any]:
    """A shirt over a skirt on a dress form that turns; hides a factor on the stiffnesses of each."""
    times = np.arange(0.0, STEP * FRAMES + 0.1, 0.1)
    turns = np.stack([0.0 * times, 70.0 * np.sin(2.0 * np.pi * times) * np.minimum(times / 0.5, 1.0), 0.0 * times], 1)
    form = around(FORM[:, 0], 0.0, ROUND)
    faces = np.concatenate([rings(len(FORM), ROUND)[:, ::-1], caps(len(FORM), ROUND)])
    place = np.concatenate([form, [(0.0, FORM[0, 0], 0.0), (0.0, FORM[-1, 0], 0.0)]])
    body = collider(4, (0.0, 0.0, 0.0), friction=0.4)
    body |= {"mesh": {"vertices": [vector(p) for p in place], "triangles": faces.ravel().tolist()}}
    body["rotKeys"] = keys(times, turns)
    shirt = np.linspace(1.465, 0.9, 18)
    over = around(shirt, 0.012 + 0.02 * (1.465 - shirt), ROUND)
    skirt = np.linspace(1.06, 0.52, 16)
    under = around(skirt, 0.006 + 0.02 * (1.06 - skirt) + 0.6 * np.maximum(0.88 - skirt, 0.0), ROUND)
    objects = []
    for points, rows in ((over, len(shirt)), (under, len(skirt))):
        waist = np.arange(len(points)) < (ROUND if points is under else 0)
        objects.append(garment(Mesh(points, rings(rows, ROUND)), waist, stiffness=30.0, settings="nF"))
    objects[1]["pins"] = [{"vertices": list(range(ROUND)), "rotKeys": keys(times, turns)}]
    touching = {"betweenObjects": True, "thickness": 0.006, "stiffness": 100.0, "friction": 0.2}
    return {**scene("layers", objects[0], [body]), "objects": objects, "selfCollision": touching}


ROUND = 32
"""Vertices around the dress form and what it wears."""

FORM = np.array([
    (0.62, 0.150, 0.120), (0.75, 0.170, 0.130), (0.90, 0.175, 0.135), (1.00, 0.150, 0.115), (1.08, 0.125, 0.100),
    (1.20, 0.150, 0.115), (1.32, 0.165, 0.120), (1.42, 0.170, 0.100), (1.46, 0.130, 0.080), (1.50, 0.060, 0.058),
    (1.58, 0.050, 0.055),
])  # fmt: skip
"""The dress form: height, half of its width and of its depth, m."""


def around(heights: Array, distance: Array | float, count: int) -> Array:
    """Rings of so many points about the dress form, (rows · count, 3), m, at a distance from it."""
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    wide, deep = (np.interp(heights, FORM[:, 0], FORM[:, k]) + distance for k in (1, 2))
    x, z = np.outer(wide, np.cos(angle)), np.outer(deep, np.sin(angle))
    return np.stack([x, np.broadcast_to(heights[:, None], x.shape), z], axis=-1).reshape(-1, 3)


def rings(rows: int, count: int) -> NDArray[np.int32]:
    """Two triangles for each cell between rings of vertices."""
    first = (np.arange(rows - 1)[:, None] * count + np.arange(count)).ravel()
    after = (np.arange(rows - 1)[:, None] * count + (np.arange(count) + 1) % count).ravel()
    cells = np.stack([first, after, after + count, first, after + count, first + count], axis=-1)
    return np.asarray(cells.reshape(-1, 3), np.int32)


def caps(rows: int, count: int) -> NDArray[np.int32]:
    """The triangles that close rings with a vertex below and one above, which come last."""
    at, after, last = np.arange(count), (np.arange(count) + 1) % count, (rows - 1) * count
    below, above = np.full(count, rows * count), np.full(count, rows * count + 1)
    return np.concatenate([np.stack([below, at, after], -1), np.stack([above, last + after, last + at], -1)]).astype(
        np.int32
    )


SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    "cape.json": cape, "curtain.json": curtain, "tablecloth.json": tablecloth, "flag.json": flag, "calm.json": calm,
    "layers.json": layers,
}  # fmt: skip


def garment(
    mesh: Mesh, fixed: NDArray[np.bool_], stiffness: float, settings: str, speed: float = 1.0
) -> dict[str, Any]:
    """An object of a mesh, of a fabric of 0.2 kg/m²; air of this speed, m/s, drags it as it does real cloth."""
    return object_document(
        mesh, fixed, density=0.2, stiffness=stiffness, damping=0.3, drag=air_drag(mesh, speed), settings=settings
    )


def scene(
    title: str, cloth: dict[str, Any], colliders: list[dict[str, Any]], wind: Sequence[float] = (0.0, 0.0, 0.0),
    newton: int = 1,
) -> dict[str, Any]:
    """Make a scene of one cloth."""
    return {
        "integrationMethod": 2,
        "delta": STEP,
        "tolerance": 1e-9,
        "optimizationIterations": FRAMES,
        "objects": [cloth],
        "colliders": colliders,
        "planes": "solid",
        "windVel": vector(wind),
        "printTimes": False,
        "forwardSubSteps": newton,
        "title": title,
    }


def collider(
    kind: int, centre: Sequence[float] | Array, size: Sequence[float] = (1.0, 1.0, 1.0), **law: float
) -> dict[str, Any]:
    """A collider at rest, soft enough for light vertices."""
    place = {"pos": vector(centre), "rot": vector((0.0, 0.0, 0.0)), "scale": vector(size)}
    return {"type": kind, **place, "thickness": 0.005, "stiffness": 100.0, **law}


def keys(times: Array, values: Array, interpolation: str = "smooth") -> dict[str, Any]:
    """Values (K, 3) at times (K,), s."""
    return {"times": times.tolist(), "values": [vector(row) for row in values], "interpolation": interpolation}


def vector(xyz: Sequence[float] | Array) -> dict[str, float]:
    """Name three components."""
    return {name: float(value) for name, value in zip("xyz", xyz, strict=True)}


def grid(rows: int, columns: int) -> NDArray[np.int32]:
    """Two triangles for each cell of a grid of vertices, row by row."""
    numbers = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, 1:], numbers[1:, :-1]
    cells = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    return np.asarray(cells, np.int32)


def rounded(value: Any) -> Any:
    """Round the numbers in a document to the digits that are written."""
    if isinstance(value, dict):
        return {name: rounded(item) for name, item in value.items()}
    if isinstance(value, list):
        return [rounded(item) for item in value]
    return float(f"{value:.{DIGITS}g}") + 0.0 if isinstance(value, float) else value  # + 0.0: no -0.0


def files() -> dict[str, str]:
    """The names and texts of all files."""
    made = {name: new_scene.text(rounded(make())) for name, make in SCENES.items()}
    return {**made, "gusts.csv": gusts()}


def main() -> None:
    """Write them."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files().items():
        (folder / name).write_text(text, encoding="ascii")


if __name__ == "__main__":
    main()
