"""The scene: what the JSON of the front end says, checked, as arrays in SI units; loading and saving it.

A scene is immutable; a fit makes new ones with other masses and stiffnesses. Each remembers the text it came from, and
saving changes nothing in that text but the numbers that differ. The camelCase names of the file
end here and in `checks`: the rest of the package knows these fields.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from clothfit import checks, structure
from clothfit.arrays import Array, Flags, Indices
from clothfit.errors import InvalidScene
from clothfit.output import write_atomically
from clothfit.source import Readable, Source, constant_problem, name_of, parse, read
from clothfit.splice import splice

SPHERE = 1  # colliders[].type
LETTERS = {"n": "n", "g": "G", "l": "L"}


@dataclass(frozen=True, eq=False)
class Cloth:
    """One object of a scene: n vertices, S springs, T triangles. The arrays are read-only."""

    positions: Array  # (n, 3) initial world positions, m
    fixed: Flags  # (n,) the vertex does not move
    mass: Array  # (n,) kg, above 0
    springs: Indices  # (S, 2) the vertices each spring joins
    stiffness: Array  # (S,) N/m, 0 or more
    triangles: Indices  # (T, 3) the corners of each face
    drag: float  # air drag of the faces, kg/(m^6 s), 0 or more
    damping: float  # alpha: node damping alpha m, spring damping (alpha/2) k
    settings: str  # what to fit, masses then stiffnesses: n nothing, G one value, L one per element

    def __post_init__(self) -> None:
        for field in fields(self):
            if isinstance(array := getattr(self, field.name), np.ndarray):
                array.setflags(write=False)


@dataclass(frozen=True, eq=False)
class Sphere:
    """A fixed sphere that the cloths cannot enter."""

    centre: Array  # (3,) m, read-only
    radius: float  # m, above 0

    def __post_init__(self) -> None:
        self.centre.setflags(write=False)


@dataclass(frozen=True, eq=False)
class Scene:
    """A valid scene."""

    title: str
    method: int  # 0 explicit, 1 symplectic, 2 implicit Euler
    delta: float  # time step, s
    tolerance: float  # of the linear solver, relative to the right-hand side
    frames: int  # compared when fitting, the initial one included
    newton_iterations: int  # per implicit step; 1 is the linearised step
    wind: Array  # (3,) m/s, read-only
    cloths: tuple[Cloth, ...]  # at least one, in file order
    spheres: tuple[Sphere, ...]
    warnings: tuple[str, ...]  # what the file asks for and nobody does, one sentence each
    name: str  # of the file, for messages
    source: Source  # original text, for saving

    def __post_init__(self) -> None:
        self.wind.setflags(write=False)

    @property
    def vertex_counts(self) -> tuple[int, ...]:
        """Number of vertices of each cloth."""
        return tuple(len(cloth.mass) for cloth in self.cloths)

    def with_values(self, masses: Sequence[npt.ArrayLike], stiffnesses: Sequence[npt.ArrayLike]) -> Scene:
        """Make a new scene with other masses, kg (n,), and stiffnesses, N/m (S,), of each of its cloths.

        Raises InvalidScene when a shape differs, a number is not finite, a mass is not above 0 or a stiffness below 0.
        """
        if not len(masses) == len(stiffnesses) == len(self.cloths):
            given = f"{len(masses)} arrays of masses and {len(stiffnesses)} of stiffnesses"
            raise InvalidScene(f"objects: {given} for {len(self.cloths)} objects; one each is needed", self.name)
        problems: list[str] = []
        cloths = []
        for i, (cloth, m, k) in enumerate(zip(self.cloths, masses, stiffnesses, strict=True)):
            mass = checks.new_values(m, len(cloth.mass), f"objects[{i}].vertMass", problems)
            checks.check_masses(mass, f"objects[{i}].vertMass", problems)
            stiffness = checks.new_values(k, len(cloth.stiffness), f"objects[{i}].springStiffness", problems)
            checks.check_stiffnesses(stiffness, f"objects[{i}].springStiffness", problems)
            if mass is not None and stiffness is not None:
                cloths.append(replace(cloth, mass=mass, stiffness=stiffness))
        if problems:
            raise InvalidScene(problems, self.name)
        return replace(self, cloths=tuple(cloths))


def load(path_or_file: Readable) -> Scene:
    """Load a scene from a path, an open text or binary file, or a dict with the fields of the file.

    Raises InvalidScene, and nothing else, when it cannot be read or breaks the format.
    """
    name = name_of(path_or_file)
    source = read(path_or_file)
    parsed = parse(source, name)
    try:
        problems = structure.problems_of(parsed.document)
    except RecursionError:
        problems = ["the JSON is nested too deeply to be a scene"]
    if problems:
        raise InvalidScene(problems, name)
    document = {**structure.defaults("scene"), **parsed.document}
    cloths = tuple(_cloth(item, f"objects[{i}]", problems) for i, item in enumerate(document["objects"]))
    if parsed.constants and not problems:  # one in a field that is not ours
        problems.append(constant_problem(source))
    if problems:
        raise InvalidScene(problems, name)
    return _scene(document, tuple(cloth for cloth in cloths if cloth), name, source)


def save(scene: Scene, path_or_file: str | os.PathLike[str] | IO[str] | IO[bytes]) -> None:
    """Save a scene to a path, whole or not at all, or to an open text or binary file.

    Raises InvalidInput when the path cannot be written; the errors of an open file are passed on.
    """
    data = dumps(scene)
    if isinstance(path_or_file, (str, os.PathLike)):
        write_atomically(path_or_file, data)
        return
    file: IO[Any] = path_or_file
    try:
        file.write(data)
    except TypeError:  # a text file; its encoding is its own business
        file.write(data.removeprefix(scene.source.mark).decode(scene.source.encoding))


def dumps(scene: Scene) -> bytes:
    """Give the text of a scene: the one it came from, but for the masses and stiffnesses that differ."""
    values = [{"vertMass": c.mass.tolist(), "springStiffness": c.stiffness.tolist()} for c in scene.cloths]
    return scene.source.encode(splice(scene.source.text, values))


def _scene(document: dict[str, Any], cloths: tuple[Cloth, ...], name: str, source: Source) -> Scene:
    colliders = document["colliders"]
    planes = [i for i, item in enumerate(colliders) if item["type"] != SPHERE]
    return Scene(
        title=document["title"].encode(errors="replace").decode(),  # "\ud800" in JSON is a text nobody can print
        method=document["integrationMethod"],
        delta=float(document["delta"]),
        tolerance=float(document["tolerance"]),
        frames=document["optimizationIterations"],
        newton_iterations=document["forwardSubSteps"],
        wind=_vector(document["windVel"]),
        cloths=cloths,
        spheres=tuple(_sphere(item) for item in colliders if item["type"] == SPHERE),
        warnings=tuple(f"colliders[{i}]: planes are ignored, as in the editor" for i in planes),
        name=name,
        source=source,
    )


def _cloth(item: dict[str, Any], place: str, problems: list[str]) -> Cloth | None:
    item = {**structure.defaults("object"), **item}
    arrays = checks.arrays(item, place, problems)
    if arrays is None:
        return None
    return Cloth(
        **arrays._asdict(),
        drag=float(item["dragCoefficient"]),
        damping=float(item["damping"]),
        settings="".join(LETTERS[letter.lower()] for letter in item["optimizationSettings"]),
    )


def _sphere(item: dict[str, Any]) -> Sphere:
    return Sphere(_vector(item["pos"]), float(item["scale"]["x"]) / 2)


def _vector(item: dict[str, Any]) -> Array:
    return np.array([item["x"], item["y"], item["z"]], dtype=np.float64)
