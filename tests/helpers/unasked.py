"""Errors that no command comes to: calls from Python, by their message."""

from __future__ import annotations

import io
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np

import clothfit
from clothfit.derivative import verify
from clothfit.evaluation import fit_methods
from clothfit.evaluation import work_precision as precision
from clothfit.meshes import mesh
from clothfit.meshes.mesh import Mesh
from clothfit.meshes.topology import together
from clothfit.motion import energy
from clothfit.scene.scene import load
from helpers.provoked import OTHER, SMALL, SPRINGS

SCENE = load(SMALL)
ONES = np.ones(3)
PLANE = mesh.plane(1, 1.0)
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]])


def triangles(*corners: tuple[int, int, int]) -> np.ndarray:
    """Triangles (T, 3) by their corners."""
    return np.array(corners, np.int32)


def checked(cost: float, direction: np.ndarray = ONES) -> float:
    """The check of a cost that is the same everywhere."""
    return verify.taylor_order(lambda p: cost, np.zeros(3), ONES, direction)


def in_two_steps() -> clothfit.Motion:
    """A motion of which every second frame is not there."""
    whole = clothfit.simulate(SCENE)
    return clothfit.as_motion(SCENE, whole.positions[::2], whole.times[::2])


PYTHON: dict[str, Callable[[], object]] = {
    "budget: … evaluations are too few, at least 1 is needed": lambda: clothfit.estimate(SCENE, budget=0),
    "evaluations must be at least 1; … was given": lambda: fit_methods.compare_methods(SCENE, evaluations=0),
    "frames must be at least 1 (the initial state); … was given": lambda: clothfit.simulate(SCENE, 0),
    "frames must be at least 2 to compare; … was given": lambda: clothfit.evaluate(SCENE, SCENE, frames=1),
    "seconds must be above 0 and finite; … was given": lambda: precision.work_precision(SCENE, seconds=0),
    "error must be above 0 and finite; … m was given": lambda: precision.WorkPrecision.recommended(
        SimpleNamespace(), 0.0
    ),
    "… must be at least …; … was given": lambda: clothfit.estimate_many([SCENE], starts=0),
    "targets: … are given for … scenes; give one item for each": lambda: clothfit.estimate_many([SCENE], []),
    "target: none is given; at least one motion is needed": lambda: clothfit.estimate(SCENE, []),
    "objective: none is given; use one or more of …": lambda: clothfit.estimate(SCENE, objective={}),
    "resume: a checkpoint is needed, the file to resume from": lambda: clothfit.estimate(SCENE, resume=True),
    "start: … is not a number, an array of numbers or a scene": lambda: clothfit.estimate(SCENE, start="a"),
    "start: … values given, … has … parameters": lambda: clothfit.estimate(SCENE, start=[1.0, 2.0]),
    "parameters: shape … given, … has (…,)": lambda: clothfit.with_parameters(SCENE, [1.0, 2.0]),
    "objects: … for … objects; one each is needed": lambda: SCENE.with_values([], []),
    "… items for … objects are given": lambda: SCENE.with_values([1], [1], drag=[]),
    "… must be …; … was given": lambda: clothfit.Reading(up="x"),
    "there is no kind …; there are …": lambda: SCENE.with_values([1], [1], colour=[1]),
    "an array of … of shape … is not …": lambda: SCENE.with_values([np.ones(2)], [np.ones(SPRINGS)]),
    "the text holds half a surrogate pair; save it as UTF-8": lambda: clothfit.load(io.StringIO('{"a": "\ud800"}')),
    "a scene comes from a path, an open file or a dict, not from …": lambda: clothfit.load(5),
    "the file gave … instead of text or bytes": lambda: clothfit.load(SimpleNamespace(read=lambda size: 5)),
    "its objects have … vertices, those of …": lambda: clothfit.estimate(SCENE, clothfit.simulate(load(OTHER))),
    "energies need every vertex, and a frame after every step of … s; give a motion as `simulate` makes it":
        lambda: energy.energies(SCENE, in_two_steps()),
    "a plane of … divisions, … by … m: nothing can be made of that": lambda: mesh.plane(1, 0.0),
    "… triangles share the edge between vertices … and …; at most 2 can": lambda: mesh.sides(
        triangles((0, 1, 2), (1, 0, 3), (0, 1, 4))
    ),
    "vertices … and … need a spring but are at the same place; weld or move them": lambda: mesh.springs(
        Mesh(CORNERS, triangles((0, 1, 2), (1, 0, 3))), 1.0
    ),
    "vertex … has no mass, being in no triangle that has an area; remove it": lambda: mesh.masses(
        PLANE._replace(positions=np.vstack([PLANE.positions, ONES])), 0.1
    ),
    "fixed: … values for … vertices; one each is needed": lambda: mesh.object_document(
        PLANE, [True], density=0.1, stiffness=50.0
    ),
    "drag: faces of … m² in air of … m/s have no coefficient; give a number": lambda: mesh.air_drag(
        Mesh(CORNERS, triangles((0, 1, 1))), 1.0
    ),
    "weld: the distance must be at least 0 and finite; … m was given": lambda: together(CORNERS, -1.0),
    "derivative check: only … of … steps stand above rounding, … are needed; try another direction, or a point where "
    "the cost curves more": lambda: checked(0.0),
    "derivative check: direction of shape … given, p has …": lambda: checked(0.0, np.ones(2)),
    "derivative check: the direction is zero or not finite": lambda: checked(0.0, np.zeros(3)),
    "derivative check: the cost is … near p; a finite one is needed": lambda: checked(np.nan),
}  # fmt: skip
"""Each raises the message of its row."""
