"""Blocks of the fit vector: the parameters of one kind, of one cloth or of the scene, and what they stand for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from clothfit.base.arrays import Array
from clothfit.scene.cloth import Cloth
from clothfit.scene.kinds import CLOTH_KINDS, KIND, SCENE_KINDS, Kind


@dataclass(frozen=True)
class Block:
    """The parameters of one kind, of one cloth or of the scene: a slice of the fit vector.

    Mode L has a parameter for every value. In mode G one parameter p (for a vector: three) gives all values as
    p · unit; without a `unit` that is 1.
    """

    cloth: int | None  # index of the object; None: of the scene as a whole
    name: str  # of the kind
    mode: str  # "G" or "L"
    elements: int  # vertices or springs that the block acts on
    start: int  # place in the fit vector
    shape: tuple[int, ...]  # of the values, as in `Elements`
    unit: Array | None = field(default=None, compare=False)  # one number per vertex or spring, only in mode G

    @property
    def kind(self) -> Kind:
        """The kind of the parameters."""
        return KIND[self.name]

    @property
    def count(self) -> int:
        """Number of parameters."""
        return int(np.prod(self.shape)) if self.mode == "L" else self.kind.components

    @property
    def weight(self) -> float:
        """Vertices or springs that one parameter, or the vector it belongs to, acts on."""
        return self.elements * self.kind.components / self.count

    @property
    def part(self) -> slice:
        """Their places in the fit vector."""
        return slice(self.start, self.start + self.count)

    def reduce(self, per_element: Array) -> Array:
        """Gradient by the parameters (count,) from the gradient by the values (shape)."""
        if self.mode == "L":
            return per_element.reshape(-1)
        if self.unit is not None:
            per_element = per_element * self.column
        return np.asarray(per_element.reshape(self._rows).sum(axis=0, keepdims=self.kind.components == 1))

    def spread(self, p: Array) -> Array:
        """The values (shape) from the fit vector (P,)."""
        if self.mode == "L":
            return p[self.part].reshape(self.shape)
        same = np.broadcast_to(p[self.part], (*self._rows[:1], self.kind.components)).reshape(self.shape)
        return same if self.unit is None else same * self.column

    def gather(self, values: Array) -> Array:
        """The parameters (count,) that fit the values (shape) best: in mode G their mean."""
        if self.mode == "L":
            return values.reshape(-1)
        if self.unit is not None and self.unit.any():
            moved = self.unit != 0
            values = (values / np.where(moved, self.unit, 1.0).reshape(self.column.shape))[moved]
        return np.asarray(values.reshape(-1, *self._rows[1:]).mean(axis=0, keepdims=self.kind.components == 1))

    @property
    def _rows(self) -> tuple[int, ...]:
        """Shape of the values as a list of numbers or of vectors."""
        return self.shape if self.kind.of != "scene" else (1, *self.shape)

    @property
    def column(self) -> Array:
        """The unit as a factor for values of this shape."""
        unit = np.ones(self._rows[0]) if self.unit is None else self.unit
        return unit.reshape(-1, *[1] * (len(self._rows) - 1))


def flagged(cloths: Sequence[Cloth], fits: Mapping[str, str]) -> tuple[Block, ...]:
    """What a scene of these cloths flags, in the order of the fit vector; `fits` has the modes of its own kinds."""
    found: list[Block] = []
    start = 0
    for cloth, kind, mode in _modes(cloths, fits):
        shape: tuple[int, ...] = (kind.components,)
        unit = None
        if cloth is not None:
            shape = np.shape(getattr(cloths[cloth], kind.name)) or (1,)
            unit = _unit(cloths[cloth], kind) if mode == "G" else None
        if np.prod(shape) > 0:
            found.append(Block(cloth, kind.name, mode, _moved(cloths, cloth, kind), start, shape, unit))
            start += found[-1].count
    return tuple(found)


def _modes(cloths: Sequence[Cloth], fits: Mapping[str, str]) -> Iterator[tuple[int | None, Kind, str]]:
    """Which kind of which cloth, None for the scene's own, is flagged, and in which mode."""
    for index, cloth in enumerate(cloths):
        yield from ((index, kind, cloth.mode(kind.name)) for kind in CLOTH_KINDS if cloth.mode(kind.name) != "n")
    yield from ((None, kind, fits[kind.name]) for kind in SCENE_KINDS if fits.get(kind.name, "n") != "n")


def _unit(cloth: Cloth, kind: Kind) -> Array | None:
    """The factor of the one parameter of a kind at each spring or vertex; None: 1."""
    if kind.name == "rest":
        return cloth.lengths
    return np.where(cloth.fixed, 0.0, 1.0) if kind.name == "velocity" else None


def _moved(cloths: Sequence[Cloth], cloth: int | None, kind: Kind) -> int:
    """How many vertices or springs a kind acts on, at least 1."""
    if cloth is None:
        return max(1, sum(len(cloths[i].mass) for i in reached(cloths, kind.name)))
    return len(cloths[cloth].stiffness if kind.of == "spring" else cloths[cloth].mass)


def reached(cloths: Sequence[Cloth], name: str) -> list[int]:
    """The cloths that a kind of the scene as a whole acts on: the wind on those that feel the air."""
    return [i for i, cloth in enumerate(cloths) if not cloth.fixed.all() and (name != "wind" or cloth.feels_air)]
