"""A valid scene in which everything moves that can: wind, gravity, pins and colliders of every shape, all fitted."""

from __future__ import annotations

from typing import Any

from helpers.scenes import cloth, document, sphere

KEYED = "keys.csv"
"""The file of some of the keys."""

TABLE = "time,x,y,z\n0,0,0.1,0\n0.02,1,-0.5,2\n0.1,0,3,-1\n"
"""What is in it."""


def xyz(x: float, y: float, z: float) -> dict[str, float]:
    """A vector."""
    return {"x": x, "y": y, "z": z}


def keys(*values: tuple[float, float, float], **fields: Any) -> dict[str, Any]:
    """Keys 0.02 s apart."""
    return {"times": [0.02 * i for i in range(len(values))], "values": [xyz(*value) for value in values], **fields}


def tetrahedron() -> dict[str, Any]:
    """A closed mesh."""
    points = [xyz(0, 0, 0), xyz(1, 0, 0), xyz(0, 1, 0), xyz(0, 0, 1)]
    return {"vertices": points, "triangles": [0, 1, 2, 0, 2, 3, 0, 3, 1, 1, 3, 2]}


def colliders() -> list[dict[str, Any]]:
    """One of each shape."""
    zero = xyz(0, 0, 0)
    moved, turned = keys((0, 0, 0), (0.1, 0.2, 0), interpolation="smooth"), keys((0, 0, 0), (10, 50, -20))
    law = {"friction": 0.4, "stiffness": 800, "thickness": 0.02}
    turn = {"rot": xyz(0, 20, 5), "rotKeys": turned}
    return [
        {**sphere(), "posKeys": moved},
        {**sphere(), "posKeys": {"file": KEYED}, **law},
        {"type": 0, "pos": xyz(0, -0.3, 0), "scale": xyz(1, 1, 1), **turn, **law},
        {"type": 2, "pos": zero, "scale": xyz(1, 1, 1), "radius": 0.2, "radius2": 0.3, "height": 0.6, **turn, **law},
        {"type": 3, "pos": xyz(0, -0.1, 0), "scale": xyz(0.8, 0.4, 1), "posKeys": moved, **turn, **law},
        {"type": 4, "pos": xyz(0.5, -0.5, 0), "scale": xyz(0.5, 1, 1), "mesh": tetrahedron(), "posKeys": moved, **law},
    ]


def moving() -> dict[str, Any]:
    """The scene: two small cloths, as many vertices as the one where nothing moves."""
    pins = [
        {"vertices": [0], "posKeys": keys((0, 0, 0), (0.01, 0, 0.02), interpolation="hold")},
        {"vertices": [2], "rotKeys": keys((0, 0, 0), (5, 9, 1)), "pivot": xyz(1, 0, 0), "posKeys": {"file": KEYED}},
    ]
    one = cloth(3, 3, optimizationSettings="nF", pins=pins)
    return document(
        one, cloth(2, 2), optimizationIterations=4, windVelKeys=keys((0, 0, 0), (1, 2, 3)),
        gravityKeys={"file": KEYED, "interpolation": "smooth"}, planes="solid", colliders=colliders(),
        colliderOffset=xyz(0.01, 0, -0.02),
        frame={"posKeys": keys((0, 0, 0), (0.1, 0, 0.3), (0, 0, 0), interpolation="smooth")},
        fit={
            "windVelKeys": "L", "friction": "L", "contact": "G", "colliderOffset": True, "bounds": {"friction": [0, 2]},
        },
    )  # fmt: skip
