"""The long arrays of a scene: from JSON lists to NumPy arrays, and whether they make sense.

Each list is checked as a whole (the set of its types, then array comparisons), and item by item, by the schema, only to
find what is wrong. Indices in messages are those of the list in the file, so `springs[3]` is the second end of the
second spring.
Every function appends its sentences to `problems`, at most a handful per list.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain
from operator import itemgetter
from typing import Any

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.messages import counted, spelt
from clothfit.scene import schema as structure
from clothfit.scene.kinds import KIND, Kind

HANDFUL = 5
NUMBER_TYPES = {int, float}  # exactly these types: a bool is an int to isinstance


class ReadOnly:
    """Base of records whose arrays cannot be changed."""

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)


def arrays(fields: dict[str, Any], place: str, problems: list[str]) -> dict[str, Any] | None:
    """Turn the lists of one object into arrays, by the names of `Cloth`; None when something is wrong with them.

    `fields` has passed the check of the structure and has its defaults; `place` is such as `objects[0]`.
    """
    before = len(problems)
    n = len(fields["vertPos"])
    if n == 0:
        problems.append(f"{place}.vertPos: is empty; an object needs at least one vertex")
    positions = vectors(fields["vertPos"], f"{place}.vertPos", problems)
    fixed = flags(fields["vertIsFixed"], f"{place}.vertIsFixed", problems)
    mass = numbers(fields["vertMass"], f"{place}.vertMass", problems)
    springs = vertices(fields["springs"], n, 2, f"{place}.springs", problems)
    stiffness = numbers(fields["springStiffness"], f"{place}.springStiffness", problems)
    triangles = vertices(fields["triangles"], n, 3, f"{place}.triangles", problems)
    velocity = vectors(fields["vertVel"], f"{place}.vertVel", problems) if "vertVel" in fields else np.zeros((n, 3))
    rest = None
    if given := "springRestLength" in fields:
        rest = numbers(fields["springRestLength"], f"{place}.springRestLength", problems)
    _check_counts(fields, place, problems)
    for kind, values in (("mass", mass), ("stiffness", stiffness), ("rest", rest)):
        check_range(values, KIND[kind], f"{place}.{KIND[kind].field}", problems)
    if positions is not None and springs is not None:
        check_lengths(positions, springs, f"{place}.springs", problems)
        rest = rest if given or len(problems) > before else lengths(positions, springs)
    made = {
        "positions": positions, "fixed": fixed, "mass": mass, "springs": springs, "stiffness": stiffness,
        "triangles": triangles, "velocity": velocity, "rest": rest,
    }  # fmt: skip
    return None if len(problems) > before else made


def vectors(values: list[Any], place: str, problems: list[str]) -> Array | None:
    """Turn a list of {x, y, z} into an array (n, 3)."""
    try:
        flat = list(chain.from_iterable(map(itemgetter("x", "y", "z"), values)))
    except (KeyError, TypeError):  # an item that is no object or lacks a component
        flat = [None]
    array = _doubles(flat)
    if array is None:
        check_items(values, "vertPos", place, problems)
    return None if array is None else array.reshape(-1, 3)


def numbers(values: list[Any], place: str, problems: list[str]) -> Array | None:
    """Turn a list of numbers into an array (n,); all must be finite."""
    array = _doubles(values)
    if array is None:
        check_items(values, "springStiffness", place, problems)
    return array


def flags(values: list[Any], place: str, problems: list[str]) -> Flags | None:
    """Turn a list of true and false into an array (n,)."""
    right = check_types(values, {bool}, "vertIsFixed", place, problems)
    return np.array(values, dtype=np.bool_) if right else None


def vertices(values: list[Any], n: int, size: int, place: str, problems: list[str]) -> Indices | None:
    """Turn a flat list of indices below n, in groups of `size`, into an array (len / size, size)."""
    array = indices(values, n, "vertex", f"the object has {counted(n, 'vertex', 'vertices')}", place, problems)
    group = {1: "numbers", 2: "pairs", 3: "triples"}[size]
    if len(values) % size:
        problems.append(f"{place}: {len(values)} indices do not make {group}; a multiple of {size} is needed")
    return None if array is None or len(values) % size else array.reshape(-1, size)


def indices(values: list[Any], n: int, what: str, there: str, place: str, problems: list[str]) -> Indices | None:
    """Turn whole numbers into an array, if all are from 0 to n − 1, those of `what` there is."""
    if not check_types(values, {int}, "springs", place, problems):
        return None
    try:
        array = np.array(values, dtype=np.int64)
    except OverflowError:
        array = np.array([value if 0 <= value < n else -1 for value in values], dtype=np.int64)
    wrong = np.flatnonzero((array < 0) | (array >= n)).tolist()
    _report(wrong, place, lambda i: f"{what} {spelt(values[i])} does not exist ({there})", problems)
    return None if wrong else array.astype(np.int32)


def check_types(values: list[Any], types: set[type], field: str, place: str, problems: list[str]) -> bool:
    """Check that every item has one of the types, those of a field of an object."""
    right = set(map(type, values)) <= types
    if not right:
        check_items(values, field, place, problems)
    return right


def check_items(values: list[Any], field: str, place: str, problems: list[str]) -> None:
    """Check the items of a list one by one, by what the schema has of such a field of an object."""
    found = structure.item_problems(values, field, place)
    problems.extend(found[:HANDFUL])
    _count_rest(len(found), problems)


def check_range(values: Array | None, kind: Kind, place: str, problems: list[str]) -> None:
    """Check that all values of a kind, if there are any, are in its range: above 0, or 0 or more."""
    if values is not None and kind.valid != "any number":
        wrong = np.flatnonzero(values <= 0 if kind.valid == "above 0" else values < 0).tolist()
        unit = kind.suffix
        _report(wrong, place, lambda i: f"the {kind.title} {float(values[i])}{unit} must be {kind.valid}", problems)


def lengths(positions: Array, springs: Indices) -> Array:
    """Lengths (S,), m, of springs (S, 2) between vertices at `positions` (n, 3)."""
    edge = positions[springs[:, 0]] - positions[springs[:, 1]]
    return np.asarray(np.sqrt((edge * edge).sum(axis=1)))


def check_lengths(positions: Array, springs: Indices, place: str, problems: list[str]) -> None:
    """Check that every spring (S, 2) joins two vertices and has a rest length above 0 and finite."""
    same = springs[:, 0] == springs[:, 1]
    _report_springs(same, springs, place, "vertex {0} is joined to itself; a spring needs two vertices", problems)
    with np.errstate(over="ignore", under="ignore"):
        length = lengths(positions, springs)
    here = "vertices {0} and {1} lie at the same place; a spring needs a rest length above 0"
    _report_springs((length == 0) & ~same, springs, place, here, problems)
    far = "vertices {0} and {1} are too far apart; the spring's rest length is not finite"
    _report_springs(~np.isfinite(length), springs, place, far, problems)


def new_values(values: npt.ArrayLike, shape: int | tuple[int, ...], place: str, problems: list[str]) -> Array | None:
    """Copy given values of a kind into an array of that shape, of finite numbers."""
    shape = (shape,) if isinstance(shape, int) else shape
    try:
        array = np.asarray(values)
    except ValueError:  # rows of different lengths
        array = np.empty((0,) * 9)
    if array.shape != shape or array.dtype.kind not in "fiu":
        needed = "a number" if shape == () else f"{' × '.join(map(str, shape))} numbers"
        problems.append(f"{place}: an array of {array.dtype} of shape {array.shape} is not {needed}")
        return None
    copy = array.astype(np.float64)
    flat = copy.reshape(-1)
    wrong = np.flatnonzero(~np.isfinite(flat)).tolist()
    _report(wrong, place, lambda i: f"{spelt(float(flat[i]))} is {structure.NOT_FINITE}", problems)
    return None if wrong else copy


def _check_counts(fields: dict[str, Any], place: str, problems: list[str]) -> None:
    vertices, ends = counted(len(fields["vertPos"]), "vertex", "vertices"), len(fields["springs"])
    springs = counted(ends // 2, "spring", "springs")
    needed = [(name, len(fields["vertPos"]), vertices) for name in ("vertIsFixed", "vertMass", "vertVel")]
    if ends % 2 == 0:
        needed += [(name, ends // 2, springs) for name in ("springStiffness", "springRestLength")]
    for name, count, owners in needed:
        if name in fields and len(fields[name]) != count:
            has = counted(len(fields[name]), "value", "values")
            problems.append(f"{place}.{name}: {has} for {owners}; one each is needed")


def _doubles(values: list[Any]) -> Array | None:
    """Numbers as an array (n,); None where one is of another type, not finite or beyond the range of doubles."""
    if not set(map(type, values)) <= NUMBER_TYPES:
        return None
    try:
        array = np.array(values, dtype=np.float64)
    except OverflowError:  # an integer
        return None
    return array if np.isfinite(array).all() else None


def _report(wrong: Sequence[int], place: str, sentence: Callable[[int], str], problems: list[str]) -> None:
    problems.extend(f"{place}[{i}]: {sentence(i)}" for i in wrong[:HANDFUL])
    _count_rest(len(wrong), problems)


def _report_springs(wrong: Flags, springs: Indices, place: str, sentence: str, problems: list[str]) -> None:
    starts = (2 * np.flatnonzero(wrong)).tolist()  # indices in the flat list
    _report(starts, place, lambda i: sentence.format(*springs[i // 2]), problems)


def _count_rest(count: int, problems: list[str]) -> None:
    if count > HANDFUL:
        problems[-1] += f" (and {count - HANDFUL} more in this list)"
