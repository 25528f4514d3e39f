"""The cases of `stability.py`: cloths on which a linearised implicit step is tried hard, one way each.

Where nothing else is said: 12 × 12 vertices over 1 m, level, 0.5 kg/m², stiffness 50 N/m, held at one side, steps of
0.02 s, no damping, no air. Those in wind are 7 m wide and light, as the examples are, so that the wind moves them.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import clothfit
from clothfit.engine.system import System, build
from clothfit.meshes.mesh import Mesh, object_document, plane
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import bounds
from clothfit.scene.scene import Scene

Document = dict[str, Any]
SIDE = 12  # vertices


class Case(NamedTuple):
    """A case: its scene, and a change of the System of its first object where no file could ask for it."""

    scene: Document
    change: Callable[[System], System] = lambda system: system
    windy: bool = False  # wind gives energy, so that there is no bar for it

    def load(self) -> Scene:
        """The scene."""
        return clothfit.load(io.StringIO(json.dumps(self.scene)))

    def systems(self) -> list[System]:
        """The System of each object."""
        scene = self.load()
        first, *others = (build(scene, index) for index in range(len(scene.cloths)))
        return [self.change(first), *others]


def vector(values: Any) -> dict[str, float]:
    """A vector as the file writes it."""
    return dict(zip("xyz", map(float, values), strict=True))


def document(*objects: Document, **fields: Any) -> Document:
    """A scene of implicit steps of 0.02 s."""
    made = {"integrationMethod": 2, "delta": 0.02, "tolerance": 1e-5, "optimizationIterations": 100}
    return {**made, "objects": list(objects), "colliders": [], **fields}


def cloth(
    side: int = SIDE,
    size: float = 1.0,
    fixed: str = "side",
    stiffness: float = 50.0,
    density: float = 0.5,
    damping: float = 0.0,
    drag: float = 0.0,
) -> Document:
    """An object of side × side vertices; `fixed` is side, all or none."""
    mesh = plane(side - 2, size)
    return of_mesh(mesh, held(mesh, fixed), stiffness, density, damping, drag)


def held(mesh: Mesh, fixed: str) -> NDArray[np.bool_]:
    """Which vertices are fixed."""
    z = mesh.positions[:, 2]
    return np.asarray({"side": z == z.max(), "all": z == z, "none": z != z}[fixed])


def of_mesh(
    mesh: Mesh, fixed: Any, stiffness: float = 50.0, density: float = 0.5, damping: float = 0.0, drag: float = 0.0
) -> Document:
    """An object of a mesh."""
    return object_document(
        mesh, fixed, density=density, stiffness=stiffness, damping=damping, drag=drag, settings="LL"
    )


def thing(points: Any, springs: Any, fixed: Any, triangles: Any = (), **fields: Any) -> Document:
    """An object from its points, pairs and triples; 0.1 kg each, 50 N/m."""
    made = {
        "vertPos": [vector(point) for point in points],
        "vertIsFixed": [i in fixed for i in range(len(points))],
        "vertMass": [0.1] * len(points),
        "springs": np.reshape(springs, -1).tolist(),
        "springStiffness": [50.0] * len(springs),
        "triangles": np.reshape(triangles, -1).tolist(),
        "dragCoefficient": 0.0,
        "damping": 0.0,
        "optimizationSettings": "LL",
    }
    return {**made, **fields}


def ball(centre: Any, radius: float) -> Document:
    """A sphere collider."""
    return {"type": 1, "pos": vector(centre), "rot": vector((0, 0, 0)), "scale": vector([2 * radius] * 3)}


def positions(made: Document) -> NDArray[np.float64]:
    """Positions (n, 3) of an object."""
    return np.array([[p["x"], p["y"], p["z"]] for p in made["vertPos"]])


def ends(made: Document) -> NDArray[np.int64]:
    """Springs (S, 2) of an object."""
    return np.reshape(made["springs"], (-1, 2))


def lengths(made: Document) -> NDArray[np.float64]:
    """Lengths (S,) of the springs of an object, m."""
    x, pairs = positions(made), ends(made)
    return np.asarray(np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1))


def pressed(made: Document, part: float, noise: float = 0.0) -> Document:
    """The object with every spring at a part of its rest length, and its vertices moved a little at random, m."""
    rest = lengths(made) / part
    x = positions(made) + noise * np.random.default_rng(2).normal(size=(len(made["vertPos"]), 3))
    return {**made, "springRestLength": rest.tolist(), "vertPos": [vector(p) for p in x]}


def mixed(made: Document, field: str, low: float, high: float) -> Document:
    """The object with the values of a field drawn between two, evenly in their logarithm."""
    drawn = np.random.default_rng(1).random(len(made[field]))
    return {**made, field: (low * (high / low) ** drawn).tolist()}


def swapped(made: Document) -> Document:
    """The object with pairs of free neighbours in each other's place: turned over elements, springs out of length."""
    x, rest = positions(made), lengths(made).tolist()
    for i in range(0, len(x) // 2, 5):
        x[[i, i + 1]] = x[[i + 1, i]]
    return {**made, "springRestLength": rest, "vertPos": [vector(p) for p in x]}


def slivers(height: float) -> Document:
    """A cloth with a row of triangles of almost no height, m."""
    mesh = plane(SIDE - 2, 1.0)
    x = mesh.positions.copy()
    rows = np.unique(x[:, 2])
    x[x[:, 2] == rows[5], 2] = rows[6] - height
    return of_mesh(Mesh(x, mesh.triangles), held(mesh, "side"))


def in_parts() -> Document:
    """Three cloths and two lone vertices as one object; only the first is held."""
    one, count = cloth(5), 25
    far = [positions(one) + np.array([2.0 * k, 0.0, 0.0]) for k in range(3)]
    points = np.concatenate([*far, [(0, 3, 0), (0, -3, 0)]])
    joined = np.concatenate([ends(one) + k * count for k in range(3)])
    return thing(points, joined, np.flatnonzero(one["vertIsFixed"]))


def zero_length(system: System) -> System:
    """The system with both ends of a spring in one place, which a file cannot say, as the cloth may come to it."""
    x = system.x0.copy()
    a, b = system.springs.ends[0]
    x[a] = x[b]
    return system._replace(x0=x)


def blown(speed: tuple[float, float, float], made: Document | None = None) -> Case:
    """A cloth of 7 m and 4.9 kg in wind, m/s."""
    made = made or cloth(size=7.0, density=0.1, drag=0.1, damping=0.1)
    return Case(document(made, windVel=vector(speed)), windy=True)


TRIANGLE = thing([(0, 0, 0), (1, 0, 0), (0, 0, 1)], [(0, 1), (1, 2), (0, 2)], [0], [(0, 1, 2)])
SPRING = thing([(0, 0, 0), (1, 0, 0)], [(0, 1)], [0])
POINTLIKE = thing([(0, 0, 0), (1e-9, 0, 0)], [(0, 1)], [0], springRestLength=[1.0])

CASES: dict[str, Case] = {
    **{f"stiffness {k:g}": Case(document(cloth(stiffness=k))) for k in (1e-4, 1.0, 1e4, 1e7)},
    "stiffness 1e-4 to 1e7 in one cloth": Case(document(mixed(cloth(), "springStiffness", 1e-4, 1e7))),
    "masses 1:1e6 in one cloth": Case(document(mixed(cloth(), "vertMass", 1e-6, 1.0))),
    "masses 1:1e6, stiffness 1e4": Case(document(mixed(cloth(stiffness=1e4), "vertMass", 1e-6, 1.0))),
    **{f"h {h:g}": Case(document(cloth(), delta=h)) for h in (1e-4, 1e-3, 0.05, 0.2)},
    **{f"h {h:g}, stiffness 1e5": Case(document(cloth(stiffness=1e5), delta=h)) for h in (1e-4, 0.05, 0.2)},
    "crushed": Case(document(pressed(cloth(), 0.2))),
    "crushed, nearly flat": Case(document(pressed(cloth(), 0.2, 1e-4))),
    "crushed, damped": Case(document(pressed(cloth(damping=0.5), 0.2, 1e-4))),
    "crushed, stiffness 1e5": Case(document(pressed(cloth(stiffness=1e5), 0.2, 1e-4))),
    "crushed, held nowhere": Case(document(pressed(cloth(fixed="none"), 0.2, 1e-4))),
    "stretched 3 times": Case(document(pressed(cloth(stiffness=1e3), 3.0))),
    "a spring at 1e-9 of its rest length": Case(document(POINTLIKE)),
    "a spring of length 0": Case(document(cloth()), zero_length),
    "inverted triangles": Case(document(swapped(cloth()))),
    "slivers of 1e-6 m": Case(document(slivers(1e-6))),
    "two objects in one place": Case(document(cloth(), cloth())),
    "parts, lone vertices": Case(document(in_parts())),
    "held everywhere": Case(document(cloth(fixed="all"))),
    "held nowhere": Case(document(cloth(fixed="none"))),
    "one triangle": Case(document(TRIANGLE)),
    "one spring": Case(document(SPRING)),
    "wind 300 m/s across": blown((0, 300, 0)),
    "wind 300 m/s along": blown((10, 1, 300)),
    "wind 300 m/s, crushed": blown((0, 300, 20), pressed(cloth(size=7.0, density=0.1, drag=0.1), 0.2, 1e-4)),
    "deep in a sphere": Case(document(cloth(), colliders=[ball((0, -0.1, 0), 0.4)])),
    "a vertex at a sphere's centre": Case(document(cloth(13), colliders=[ball((0, 0, 0), 0.4)])),
}
"""By name; all but the windy ones must not gain energy."""


def bounds_objective() -> tuple[Objective, NDArray[np.float64], NDArray[np.float64]]:
    """The cost of a cloth by all of its masses and stiffnesses over 50 frames, and the ends of what a fit may try."""
    scene = clothfit.load(io.StringIO(json.dumps(document(cloth(6), optimizationIterations=50))))
    return Objective(scene, clothfit.simulate(scene)), *bounds(scene)
