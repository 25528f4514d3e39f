"""Forces that are applied to the vertices of a scene over time: the record, and its file.

The file is an `.npz` archive: `forces` (steps, vertices, 3) N, in the axes of the scene, the vertices of all objects in
file order; and `times` (steps,) s, when each row begins to act. A row acts until the next, the last one as long as the
one before it; before the first and after the last there is no force. For a feedback it also has `gain` (steps,
vertices) N/m and `places` (steps, vertices, 3) m: springs of that stiffness pull to where the vertices should be; or
the arrays of a `Regulator`.

Or it is a table (CSV) for spreadsheets, scripts and engines, a line for each step and vertex:

    time,vertex,fx,fy,fz

Its numbers are written so that they read back as the same. Vertices without any force are left out; what is left out
is 0.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import IO, Any

import numpy as np

from clothfit.base import npz
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import FARTHEST
from clothfit.base.memory import human, missing
from clothfit.base.messages import unreadable
from clothfit.base.reading import unchanged, whole
from clothfit.base.writing import Data, write_atomically
from clothfit.scene.array_checks import ReadOnly

ARRAYS, FEEDBACK = ("forces", "times"), ("gain", "places")

ROUNDING = 1e-6
"""Share of a row's time by which a step may begin before it and still feel it."""

STRONGEST = 1e9
"""N; more is taken for a fault."""


@dataclass(frozen=True, eq=False)
class Forces(ReadOnly):
    """The forces on all vertices of a scene, row by row."""

    times: Array  # (R,), s, increasing: when each row begins to act
    values: Array  # (R, n, 3), N
    gain: Array | None = None  # (R, n), N/m, of springs that pull the vertices back to `places`; None: none do
    places: Array | None = None  # (R, n, 3), m, where the vertices are after each row
    pulls: bool = False  # whether those springs act
    name: str = "forces"  # of their file, for messages
    regulator: Regulator | None = None  # gains in a reduced basis, which act where `pulls`

    @property
    def end(self) -> float:
        """When the last row ends to act, s."""
        return float(self.times[-1] + self.lasts) if len(self.times) else 0.0

    @property
    def lasts(self) -> float:
        """How long the last row acts, s."""
        return float(self.times[-1] - self.times[-2]) if len(self.times) > 1 else np.inf

    def rows(self, times: Array) -> tuple[Indices, Flags]:
        """Of steps that begin at times (T,), s, the row that acts in each, (T,), and whether one does."""
        shortest = float(np.diff(self.times).min()) if len(self.times) > 1 else 1.0
        late = times + ROUNDING * shortest
        row = np.searchsorted(self.times, late, side="right") - 1
        return np.maximum(row, 0).astype(np.int32), (row >= 0) & (late < self.end)

    def at(self, times: Array) -> tuple[Array, Array | None, Array | None]:
        """The forces (T, n, 3) in steps that begin at times (T,), s, and gains (T, n) and places (T, n, 3) where they
        pull.
        """
        row, acts = self.rows(times)
        values = np.where(acts[:, None, None], self.values[row], 0.0)
        if not self.pulls or self.gain is None or self.places is None:
            return values, None, None
        return values, np.where(acts[:, None], self.gain[row], 0.0), self.places[row]


def refuse(name: str, faults: Iterable[tuple[bool, str]]) -> None:
    """Raise InvalidInput with the first sentence that is about a fault; what follows is not looked at."""
    for wrong, sentence in faults:
        if wrong:
            raise InvalidInput(f"{name}: {sentence}")


def check_forces(forces: Forces, vertices: int) -> None:
    """Raise InvalidInput where forces do not fit a scene of so many vertices, or gains and places the forces."""
    refuse(forces.name, _faults(forces, vertices))


def _faults(forces: Forces, vertices: int) -> Iterator[tuple[bool, str]]:
    values, times, gain, places = forces.values, forces.times, forces.gain, forces.places
    flat = values.ndim != 3 or values.shape[2] != 3
    yield flat, f"forces: have the shape {values.shape}; (steps, vertices, 3) is needed"
    own = values.shape[1]
    yield own != vertices or not vertices, f"forces: are for {own} vertices; the scene has {vertices}"
    yield times.shape != values.shape[:1], f"times: have the shape {times.shape} for {len(values)} rows of forces"
    yield not len(times), "times: is empty; at least one row of forces is needed"
    yield (gain is None) != (places is None), "gain and places belong together; one of them is missing"
    if gain is not None and places is not None:
        other = gain.shape != values.shape[:2] or places.shape != values.shape
        yield other, f"gain {gain.shape} and places {places.shape} do not fit forces {values.shape}"
        beyond = not ((gain >= 0) & (gain <= STRONGEST)).all() or not (np.abs(places) <= FARTHEST).all()
        yield beyond, f"gain must be within 0 … {STRONGEST:g} N/m, and places finite"
    for late in np.flatnonzero(~(np.diff(times) > 0)):
        yield True, f"times[{late + 1}]: is not later than the one before it"
    far = not np.isfinite(times).all() or np.abs(times).max(initial=0.0) > FARTHEST
    yield bool(far), f"times: are not all finite and below {FARTHEST:g} s"
    for t, i, _ in np.argwhere(~(np.abs(values) <= STRONGEST)):
        yield True, f"forces[{t}][{i}]: is not finite and at most {STRONGEST:g} N"


def load_forces(path: str | os.PathLike[str], vertices: int | None, pulls: bool = False) -> Forces:
    """Read forces on a scene of so many vertices (None: as many as the file has) from a file, .npz or a table (.csv),
    with a feedback where it `pulls`, and check them. Raises InvalidInput.
    """
    name = os.path.basename(os.fspath(path))
    tabular = name.lower().endswith(".csv")
    try:
        with unchanged(path) as file:
            if tabular:
                arrays = table_arrays(file, vertices)
            else:
                arrays = read_arrays(file if file.seekable() else io.BytesIO(npz.content(file)))
    except (FileNotFoundError, IsADirectoryError) as error:
        raise InvalidInput(f"{name}: {unreadable(error)}") from None
    except npz.FAULTS as error:
        raise InvalidInput(f"{name}: cannot be read as forces ({'.csv' if tabular else '.npz'}): {error}") from None
    forces = Forces(arrays["times"], arrays["forces"], arrays.get("gain"), arrays.get("places"), pulls, name)
    count = forces.values.shape[1] if vertices is None and forces.values.ndim == 3 else vertices or 0
    check_forces(forces, count)
    forces = replace(forces, regulator=regulator(arrays, len(forces.values), count, name))
    if pulls and forces.gain is None and forces.regulator is None:
        raise InvalidInput(f"{name}: has no gains and places for a feedback; clothfit control writes some")
    return forces


def read_arrays(file: IO[bytes]) -> dict[str, Array]:
    """The arrays of an open file. Raises one of `npz.FAULTS`."""
    found = npz.stored(file, (*ARRAYS, *FEEDBACK, *REGULATOR), "forces")
    for name in ARRAYS:
        if name not in found:
            raise ValueError(f"there is no array {name}; clothfit control writes such files")
    for name in found:
        if found[name].dtype.kind not in "fiu":
            raise ValueError(f"{name} has the type {found[name].dtype}; numbers are needed")
    _check_room(2 * sum(array.nbytes for array in found.values()))
    return {name: np.array(array.read(), float) for name, array in found.items()}


def _check_room(needed: int) -> None:
    """Raise ValueError where so many bytes are not free."""
    if (free := missing(needed)) is not None:
        raise ValueError(f"it takes more memory than the {human(free)} that are free")


def save_forces(forces: Forces, path: str | os.PathLike[str]) -> None:
    """Write forces as `.npz`, whole or not at all. Raises InvalidInput when a path cannot be written."""
    write_atomically(path, archive(forces))


def archive(forces: Forces) -> Data:
    """What writes forces to a file."""
    arrays = {"forces": forces.values, "times": forces.times}
    if forces.gain is not None and forces.places is not None:
        arrays |= {"gain": forces.gain, "places": forces.places}
    if forces.regulator is not None:
        arrays |= forces.regulator.arrays()
    return npz.archive(arrays)


COLUMNS = ("time", "vertex", "fx", "fy", "fz")
"""Of a table."""

MOST_BYTES = 2_000_000_000
"""Largest table that is read."""


def table(times: Array, forces: Array) -> bytes:
    """The table of forces (R, n, 3), N, in rows that begin to act at `times` (R,), s."""
    pushed = np.flatnonzero(forces.any(axis=(0, 2)))
    pushed = pushed if len(pushed) else np.zeros(1, int)  # so that the times are known
    numbers = [str(vertex) for vertex in pushed.tolist()]
    lines = [",".join(COLUMNS)]
    for time, row in zip(times.tolist(), forces[:, pushed].tolist(), strict=True):
        lines += [f"{time},{vertex},{x},{y},{z}" for vertex, (x, y, z) in zip(numbers, row, strict=True)]
    return ("\n".join(lines) + "\n").encode()


def table_arrays(file: IO[bytes], vertices: int | None) -> dict[str, Array]:
    """`times` (R,) and `forces` (R, n, 3) of a table for so many vertices, None: up to the last that it names. Raises
    OSError and ValueError.
    """
    text = whole(file, MOST_BYTES).decode("utf-8-sig")
    head, _, body = text.partition("\n")
    if tuple(part.strip() for part in head.split(",")) != COLUMNS:
        raise ValueError(f"its first line must be {','.join(COLUMNS)}")
    if not body.strip():
        raise ValueError("it has no line of forces")
    rows = np.loadtxt(io.StringIO(body), delimiter=",", ndmin=2, comments=None)
    if rows.shape[1] != len(COLUMNS):
        raise ValueError(f"its lines have {rows.shape[1]} numbers; {len(COLUMNS)} are needed")
    times, row = np.unique(rows[:, 0], return_inverse=True)
    vertex = rows[:, 1]
    if vertices is None:
        vertices = int(np.clip(np.nan_to_num(vertex.max()), 0.0, 1e9)) + 1
    wrong = np.flatnonzero(~((vertex >= 0) & (vertex < vertices) & (vertex == np.floor(vertex))))
    if len(wrong):
        raise ValueError(f"line {wrong[0] + 2}: {vertex[wrong[0]]:g} is no vertex; there are {vertices}, from 0")
    place = row * vertices + vertex.astype(np.int64)
    if len(np.unique(place)) < len(place):
        raise ValueError("a vertex has two forces at one time")
    _check_room(8 * 3 * len(times) * vertices)
    forces = np.zeros((len(times) * vertices, 3))
    forces[place] = rows[:, 2:]
    return {"times": times, "forces": forces.reshape(len(times), vertices, 3)}


REGULATOR = ("measure", "push", "gains", "reference", "bound")
"""The arrays of a feedback in a reduced basis."""


@dataclass(frozen=True, eq=False)
class Regulator:
    """A feedback of C objects with n vertices in all, over R rows of forces, in a reduced basis: what forces answer a
    cloth that is not where it should be.

    Each object with n vertices is seen through k shapes. Weights W (n, k) make coordinates of positions and velocities,
    q = Wᵀ x and p = Wᵀ v, each (k, 3). In a row of the forces with gains K and reference z₀ the answer is

        u = E g,    g = −K (z − z₀),    z = (q, p) as one vector (6 k,), g (3 m,) that of (m, 3)

    with E (n, m) the m shapes of forces on the vertices that forces act on. Numbers are 0 in objects without a
    feedback.
    """

    measure: Array  # W, (n, k), kg^½
    push: Array  # E, (n, m)
    gains: Array  # K, (C, R, 3 m, 6 k), N and N s for each kg^½ m
    reference: Array  # z₀, (C, R, 6 k), kg^½ m and kg^½ m/s, at the beginning of each row
    bound: float = np.inf  # N, largest force on a vertex, that of the plan included

    def arrays(self) -> dict[str, Array]:
        """What a file has of it: the gains with 7 digits, which are more than a feedback needs."""
        gains: Any = self.gains.astype(np.float32)
        return dict(zip(REGULATOR, (self.measure, self.push, gains, self.reference, np.array(self.bound)), strict=True))

    def answer(self, cloth: int, part: slice, row: int, place: Array, x: Array, v: Array) -> Array:
        """The forces (n, 3), N, at x and v (n, 3) on the cloth that is this part of all vertices, the coordinates of
        which should be `place` (6 k,).
        """
        away = state(self.measure[part], x, v) - place
        return np.asarray(self.push[part] @ -(self.gains[cloth, row] @ away).reshape(-1, 3))


def state(measure: Array, x: Array, v: Array) -> Array:
    """The coordinates (6 k,) of positions and velocities (n, 3) by weights (n, k)."""
    return np.concatenate([(measure.T @ x).reshape(-1), (measure.T @ v).reshape(-1)])


def regulator(arrays: dict[str, Array], rows: int, vertices: int, name: str) -> Regulator | None:
    """The feedback in the arrays of a file, None where it has none. Raises InvalidInput where they do not fit so many
    rows of forces on so many vertices.
    """
    lacking = [each for each in REGULATOR if each not in arrays]
    if len(lacking) == len(REGULATOR):
        return None
    refuse(name, [(bool(lacking), f"{', '.join(REGULATOR)} belong together; missing: {', '.join(lacking)}")])
    refuse(name, _faults_of_gains(arrays, rows, vertices))
    measure, push, gains, reference, bound = (arrays[each] for each in REGULATOR)
    return Regulator(measure, push, gains, reference, float(bound))


def _faults_of_gains(arrays: dict[str, Array], rows: int, vertices: int) -> Iterator[tuple[bool, str]]:
    measure, push, gains, reference, bound = (arrays[each] for each in REGULATOR)
    shapes = f"measure {measure.shape} and push {push.shape}"
    other = measure.ndim != 2 or push.ndim != 2 or not len(measure) == len(push) == vertices
    yield other, f"{shapes} do not fit {vertices} vertices; (vertices, shapes) is needed"
    k, m = measure.shape[1], push.shape[1]
    shapes = f"gains {gains.shape} and reference {reference.shape}"
    other = gains.ndim != 4 or gains.shape[1:] != (rows, 3 * m, 6 * k) or reference.shape != (*gains.shape[:2], 6 * k)
    needed = f"(objects, {rows}, {3 * m}, {6 * k}) and (objects, {rows}, {6 * k}) are needed"
    yield other, f"{shapes} do not fit forces, measure and push; {needed}"
    for each in REGULATOR[:4]:
        yield not np.isfinite(arrays[each]).all(), f"{each}: is not finite everywhere"
    yield bound.shape != () or not bound > 0, "bound: must be one number above 0, N"
