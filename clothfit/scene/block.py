"""Blocks of the fit vector: the parameters of one kind, of one cloth or of the scene, and what they stand for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from clothfit.base.arrays import NO_NUMBERS, Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.scene import bounds
from clothfit.scene.bounds import NO_BOUNDS, Bounds, End
from clothfit.scene.cloth import Cloth
from clothfit.scene.factors import FACTOR_MODES, Factors, factors_of, modes_of_each, one_factor, smooth_maps
from clothfit.scene.families import spring_groups, vertex_groups
from clothfit.scene.kinds import CLOTH_KINDS, SCENE_KINDS, Kind
from clothfit.scene.smooth_maps import vertex_modes

NO_SHAPES: Mapping[str, tuple[int, ...]] = {}


@dataclass(frozen=True)
class Block:
    """The parameters of one kind, of one cloth or of the scene: a slice of the fit vector.

    Mode L has a parameter for every value. In mode G one parameter p (for a vector: three) gives all values as
    p · unit; without a `unit` that is 1. In modes F, R and M the parameters are `factors` on the scene's values.
    """

    cloth: int | None  # index of the object; None: of the scene as a whole
    kind: Kind
    mode: str  # "F", "R", "M", "G" or "L"
    elements: int  # vertices or springs that the block acts on
    start: int  # place in the fit vector
    shape: tuple[int, ...]  # of the values, as in `Elements`
    unit: Array | None = field(default=None, compare=False)  # one number per vertex or spring, only in mode G
    factors: Factors | None = field(default=None, compare=False)  # only in modes F, R and M
    ends: tuple[float, float] = field(default=(-np.inf, np.inf), compare=False)  # bounds of the values in a fit

    @property
    def name(self) -> str:
        """That of the kind."""
        return self.kind.name

    @property
    def count(self) -> int:
        """Number of parameters."""
        if self.factors is not None:
            return self.factors.count
        return int(np.prod(self.shape)) if self.mode == "L" else self.kind.components

    @property
    def is_one(self) -> bool:
        """Whether it is one value, or one vector, or one factor for all."""
        return self.mode in "FG"

    @property
    def weights(self) -> Array:
        """Vertices or springs that each parameter (count,), or the vector it belongs to, acts on; of a map the sum of
        the squares of its mode over them.
        """
        if self.factors is not None:
            return self.factors.weights
        return np.full(self.count, self.elements * self.kind.components / self.count)

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lower and upper bounds (count,) of the parameters."""
        if self.factors is not None:
            return self.factors.bounds(*self.ends)
        return np.full(self.count, self.ends[0]), np.full(self.count, self.ends[1])

    @property
    def value_ends(self) -> tuple[float, float]:
        """Bounds of the values in a fit; of one factor on lengths those of the shortest and of the longest."""
        if self.kind.name == "rest" and self.unit is not None:
            return self.ends[0] * float(self.unit.min()), self.ends[1] * float(self.unit.max())
        return self.ends

    @property
    def constant(self) -> Flags:
        """Which parameters (count,) carry the level of the values: all but the modes of a map that are not constant."""
        return np.ones(self.count, bool) if self.factors is None else self.factors.constant

    def at_level(self, number: float) -> Array:
        """Parameters (count,) that give all values this number, or of factors this geometric mean."""
        return np.full(self.count, number) if self.factors is None else self.factors.at_level(number)

    @property
    def part(self) -> slice:
        """Their places in the fit vector."""
        return slice(self.start, self.start + self.count)

    def reduce(self, per_element: Array, p: Array) -> Array:
        """Gradient (count,) by the parameters at p (P,) from the gradient by the values (shape)."""
        if self.factors is not None:
            return self.factors.gradient(p[self.part], per_element)
        if self.mode == "L":
            return per_element.reshape(-1)
        if self.unit is not None:
            per_element = per_element * self.column
        return np.asarray(per_element.reshape(self._rows).sum(axis=0, keepdims=self.kind.components == 1))

    def spread(self, p: Array) -> Array:
        """The values (shape) from the fit vector (P,)."""
        if self.factors is not None:
            return self.factors.values(p[self.part])
        if self.mode == "L":
            return p[self.part].reshape(self.shape)
        same = np.broadcast_to(p[self.part], (*self._rows[:1], self.kind.components)).reshape(self.shape)
        return same if self.unit is None else same * self.column

    def change(self, p: Array, direction: Array) -> Array:
        """Change of the values (shape) at p (P,) along `direction` (P,): only of factors it depends on p."""
        if self.factors is not None:
            return self.factors.change(p[self.part], direction[self.part])
        return self.spread(direction)

    def gather(self, values: Array) -> Array:
        """The parameters (count,) that fit the values (shape) best: in mode G their mean, of factors in logarithms."""
        if self.factors is not None:
            return self.factors.nearest(values)
        if self.mode == "L":
            return values.reshape(-1)
        if self.unit is not None and self.unit.any():
            moved = self.unit != 0
            values = (values / np.where(moved, self.unit, 1.0).reshape(self.column.shape))[moved]
        return np.asarray(values.reshape(-1, *self._rows[1:]).mean(axis=0, keepdims=self.kind.components == 1))

    @property
    def _rows(self) -> tuple[int, ...]:
        """Shape of the values as a list of numbers or of vectors."""
        return (1, *self.shape) if self.kind.components == 3 and len(self.shape) == 1 else self.shape

    @property
    def column(self) -> Array:
        """The unit as a factor for values of this shape."""
        unit = np.ones(self._rows[0]) if self.unit is None else self.unit
        return unit.reshape(-1, *[1] * (len(self._rows) - 1))


def flagged(
    cloths: Sequence[Cloth],
    fits: Mapping[str, str],
    asked: Bounds = NO_BOUNDS,
    base: Sequence[Block] = (),
    shapes: Mapping[str, tuple[int, ...]] = NO_SHAPES,
) -> tuple[Block, ...]:
    """What a scene of these cloths flags, in the order of the fit vector; `fits` has the modes of its own kinds,
    `asked` its own bounds, `shapes` the shape of those that are not one vector. The factors are those of `base`, where
    these blocks of another scene are given.
    """
    found: list[Block] = []
    start = 0
    for cloth, kind, mode in _modes(cloths, fits):
        shape = shapes.get(kind.name, (kind.components,))
        if cloth is not None:
            shape = np.shape(getattr(cloths[cloth], kind.name)) or (1,)
        if np.prod(shape) > 0:
            if cloth is None:
                count = max(1, sum(len(cloths[i].mass) for i in reached(cloths, kind.name)))
            else:
                count = len(cloths[cloth].stiffness if kind.of == "spring" else cloths[cloth].mass)
            block = Block(cloth, kind, mode, count, start, shape)
            wanted = asked.get(kind.name, (None, None))
            if cloth is None:
                block = replace(block, ends=bounds.of_values(kind, NO_NUMBERS, wanted))
            else:
                wanted = cloths[cloth].bounds.get(kind.name, wanted)
                block = _of_cloth(block, cloths[cloth], wanted, base[len(found)] if base else None)
            found.append(block)
            start += found[-1].count
    return tuple(found)


def _modes(cloths: Sequence[Cloth], fits: Mapping[str, str]) -> Iterator[tuple[int | None, Kind, str]]:
    """Which kind of which cloth, None for the scene's own, is flagged, and in which mode."""
    for index, cloth in enumerate(cloths):
        names = [kind.name for kind in CLOTH_KINDS if cloth.mode(kind.name) != "n"]
        yield from ((index, cloth.kind(name), cloth.mode(name)) for name in names)
    yield from ((None, kind, fits[kind.name]) for kind in SCENE_KINDS if fits.get(kind.name, "n") != "n")


def _of_cloth(block: Block, cloth: Cloth, asked: tuple[End, End], base: Block | None) -> Block:
    """A block of a cloth with its unit or factors and its bounds; the factors of `base` where that is given."""
    kind = block.kind
    if block.mode in FACTOR_MODES:
        values = getattr(cloth, kind.name)
        if base is not None and base.shape == np.shape(values):
            return replace(block, factors=base.factors, ends=base.ends)
        ends = bounds.of_values(kind, values, asked)
        if base is not None:
            return replace(block, factors=_like(base, cloth, kind, block.mode), ends=ends)
        return replace(block, factors=_factors(cloth, kind, block.mode, ends), ends=ends)
    if kind.name == "rest" and block.mode == "G":
        ends = kind.lower, kind.upper
        if asked != (None, None):
            ends = bounds.of_factor(cloth.lengths, bounds.of_values(kind, cloth.lengths, asked))
        return replace(block, unit=cloth.lengths, ends=ends)
    unit = np.where(cloth.fixed, 0.0, 1.0) if kind.name == "velocity" and block.mode == "G" else None
    values = np.ravel(getattr(cloth, kind.name))
    if kind.name == "drag":
        values = np.append(values, cloth.air_drag)
    return replace(block, unit=unit, ends=bounds.of_values(kind, values, asked))


def _like(base: Block, cloth: Cloth, kind: Kind, mode: str) -> Factors:
    """The factors of another mesh in the order of `base`: of groups by their names. Raises InvalidInput."""
    values, names = getattr(cloth, kind.name), base.factors.names if base.factors else ()
    if mode == "F":
        return one_factor(values)
    groups = vertex_groups(cloth) if kind.of == "vertex" else spring_groups(cloth)
    if mode != "R" or (unknown := [name for name in groups.names if name not in names]):
        what = f"mode {mode}" if mode != "R" else f"the group {unknown[0]!r}, which the main scene has not"
        raise InvalidInput(f"{kind.title}: {what}: cloths of several meshes are fitted by one factor (F) or by groups "
                           "of the same names (R)")  # fmt: skip
    place = np.array([names.index(name) for name in groups.names], np.int32)
    return factors_of(values, place[groups.of], names)


def _factors(cloth: Cloth, kind: Kind, mode: str, ends: tuple[float, float]) -> Factors:
    """The factors of a kind of a cloth."""
    values = getattr(cloth, kind.name)
    if mode == "F":
        return one_factor(values)
    groups = vertex_groups(cloth) if kind.of == "vertex" else spring_groups(cloth)
    if mode == "R":
        return factors_of(values, groups.of, groups.names)
    sizes = np.bincount(groups.of, minlength=len(groups.names)).tolist()
    modes = vertex_modes(cloth, max(modes_of_each(sizes)))
    if kind.of == "spring":
        modes = modes[cloth.springs].mean(axis=1)
    return smooth_maps(values, groups.of, groups.names, modes, ends)


def reached(cloths: Sequence[Cloth], name: str) -> list[int]:
    """The cloths that a kind of the scene as a whole acts on: the wind on those that feel the air."""
    airy = name in ("wind", "gusts")
    return [i for i, cloth in enumerate(cloths) if not cloth.fixed.all() and (cloth.feels_air or not airy)]
