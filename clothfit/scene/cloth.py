"""One object of a scene, and a sphere: arrays in SI units that do not change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.scene import array_checks as checks
from clothfit.scene.bounds import Bounds
from clothfit.scene.keys import Keys, Pin
from clothfit.scene.kinds import LETTERED, Kind
from clothfit.scene.weave.layout import NOTHING, Layout


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
    damping: float  # α: damps a vertex by α m v (α in 1/s), a spring by (α/2) k along its axis (α in s)
    settings: str  # two letters, masses then stiffnesses: n keeps them, the others are those of `Kind.modes`
    velocity: Array  # (n, 3) at the start, m/s; those of fixed vertices do nothing
    rest: Array  # (S,) rest lengths, m, above 0
    fits: Mapping[str, str]  # what else to fit: "damping", "drag", "velocity", "rest" to one of their modes
    layout: Layout = NOTHING  # what the file says of families, regions and the warp
    bounds: Bounds = field(default_factory=dict)  # of a fit, by kind, before those of the scene
    pins: tuple[Pin, ...] = ()  # fixed vertices that move

    def __post_init__(self) -> None:
        for each in fields(self):
            if isinstance(array := getattr(self, each.name), np.ndarray):
                array.setflags(write=False)

    def __repr__(self) -> str:
        sizes = f"{len(self.mass)} vertices, {len(self.stiffness)} springs, {len(self.triangles)} triangles"
        return f"<Cloth: {sizes}, {self.mass.sum():.3g} kg>"

    def mode(self, name: str) -> str:
        """How a kind ("mass", "drag", …) is fitted: "n" not at all, or one of the modes of the kind."""
        return self.settings[LETTERED.index(name)] if name in LETTERED else self.fits.get(name, "n")

    @cached_property
    def lengths(self) -> Array:
        """Lengths (S,) of the springs at the initial positions, m, read-only."""
        lengths = checks.lengths(self.positions, self.springs)
        lengths.setflags(write=False)
        return lengths

    def default(self, kind: Kind) -> npt.ArrayLike:
        """The values of an optional kind where the file gives none."""
        return self.lengths if kind.name == "rest" else np.zeros_like(getattr(self, kind.name))

    @property
    def feels_air(self) -> bool:
        """Whether the air drags the cloth, or may do so in a fit."""
        return bool(len(self.triangles)) and (self.drag > 0 or self.mode("drag") != "n")


@dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere that the cloths cannot enter."""

    centre: Array  # (3,) m, read-only
    radius: float  # m, above 0
    position: Keys | None = None  # how far the centre moves over time, m

    def __post_init__(self) -> None:
        self.centre.setflags(write=False)
