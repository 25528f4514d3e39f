"""A block of the fit vector: the parameters of one kind, of one cloth or of the scene, and what they stand for."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from clothfit.base.arrays import Array
from clothfit.scene.kinds import KIND, Kind


@dataclass(frozen=True)
class Block:
    """The parameters of one kind, of one cloth or of the scene: a slice of the fit vector.

    Mode L has a parameter for every value; in mode G one parameter p (of a vector: three) stands for all of them:
    value = p · unit, where `unit` is 1 if there is none.
    """

    cloth: int | None  # index of the object; None: of the scene as a whole
    name: str  # of the kind
    mode: str  # "G" or "L"
    elements: int  # vertices or springs that the block moves
    start: int  # place in the fit vector
    shape: tuple[int, ...]  # of the values, as in `Elements`
    unit: Array | None = field(default=None, compare=False)  # one number per vertex or spring, only in mode G

    @property
    def kind(self) -> Kind:
        """What they are."""
        return KIND[self.name]

    @property
    def count(self) -> int:
        """Number of parameters."""
        return int(np.prod(self.shape)) if self.mode == "L" else self.kind.components

    @property
    def weight(self) -> float:
        """Vertices or springs that one parameter, or the vector it belongs to, moves."""
        return self.elements * self.kind.components / self.count

    @property
    def part(self) -> slice:
        """Where they stand in the fit vector."""
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
        """The parameters (count,) that stand for the values (shape) best: in mode G their mean."""
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
