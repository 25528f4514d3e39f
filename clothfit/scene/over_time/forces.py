"""Forces that are applied to the vertices of a scene over time: the record, and its file.

The file is an `.npz` archive: `forces` (steps, vertices, 3) N, in the axes of the scene, the vertices of all objects in
file order; and `times` (steps,) s, when each row begins to act. A row acts until the next, the last one as long as the
one before it; before the first and after the last there is no force. For a feedback it also has `gain` (steps,
vertices) N/m and `places` (steps, vertices, 3) m: springs of that stiffness pull to where the vertices should be; or
the arrays of a `regulator`.
"""

from __future__ import annotations

import io
import os
from dataclasses import dataclass, replace
from typing import IO

import numpy as np

from clothfit.base import npz
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import FARTHEST
from clothfit.base.memory import human, missing
from clothfit.base.messages import unreadable
from clothfit.base.reading import unchanged
from clothfit.base.writing import Data, write_atomically
from clothfit.scene.over_time import force_table
from clothfit.scene.over_time.regulator import NAMES, Regulator, regulator

ARRAYS, FEEDBACK = ("forces", "times"), ("gain", "places")

ROUNDING = 1e-6
"""Share of a row's time by which a step may begin before it and still feel it."""

STRONGEST = 1e9
"""N; more is taken for a fault."""


@dataclass(frozen=True, eq=False)
class Forces:
    """The forces on all vertices of a scene, row by row."""

    times: Array  # (R,), s, increasing: when each row begins to act
    values: Array  # (R, n, 3), N
    gain: Array | None = None  # (R, n), N/m, of springs that pull the vertices back to `places`; None: none do
    places: Array | None = None  # (R, n, 3), m, where the vertices are after each row
    pulls: bool = False  # whether those springs act
    name: str = "forces"  # of their file, for messages
    regulator: Regulator | None = None  # gains in a reduced basis, which act where `pulls`

    def __post_init__(self) -> None:
        for each in (self.values, self.times, self.gain, self.places):
            if each is not None:
                each.setflags(write=False)

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


def check(forces: Forces, vertices: int) -> None:
    """Raise InvalidInput where forces do not fit a scene of so many vertices."""
    values, times, name = forces.values, forces.times, forces.name
    if values.ndim != 3 or values.shape[2] != 3:
        raise InvalidInput(f"{name}: forces: have the shape {values.shape}; (steps, vertices, 3) is needed")
    if values.shape[1] != vertices or not vertices:
        raise InvalidInput(f"{name}: forces: are for {values.shape[1]} vertices; the scene has {vertices}")
    if times.shape != values.shape[:1]:
        raise InvalidInput(f"{name}: times: have the shape {times.shape} for {len(values)} rows of forces")
    if not len(times):
        raise InvalidInput(f"{name}: times: is empty; at least one row of forces is needed")
    check_feedback(forces)
    late = np.flatnonzero(~(np.diff(times) > 0))
    if len(late):
        raise InvalidInput(f"{name}: times[{late[0] + 1}]: is not later than the one before it")
    if not np.isfinite(times).all() or np.abs(times).max(initial=0.0) > FARTHEST:
        raise InvalidInput(f"{name}: times: are not all finite and below {FARTHEST:g} s")
    wrong = np.argwhere(~(np.abs(values) <= STRONGEST))
    if len(wrong):
        t, i, _ = wrong[0]
        raise InvalidInput(f"{name}: forces[{t}][{i}]: is not finite and at most {STRONGEST:g} N")


def check_feedback(forces: Forces) -> None:
    """Raise InvalidInput where gains and places do not fit the forces."""
    gain, places, name = forces.gain, forces.places, forces.name
    if gain is None and places is None:
        return
    if gain is None or places is None:
        raise InvalidInput(f"{name}: gain and places belong together; one of them is missing")
    if gain.shape != forces.values.shape[:2] or places.shape != forces.values.shape:
        shapes = f"gain {gain.shape} and places {places.shape}"
        raise InvalidInput(f"{name}: {shapes} do not fit forces {forces.values.shape}")
    if not ((gain >= 0) & (gain <= STRONGEST)).all() or not (np.abs(places) <= FARTHEST).all():
        raise InvalidInput(f"{name}: gain must be within 0 … {STRONGEST:g} N/m, and places finite")


def load_forces(path: str | os.PathLike[str], vertices: int | None, pulls: bool = False) -> Forces:
    """Read forces on a scene of so many vertices (None: as many as the file has) from a file, .npz or a table (.csv),
    with a feedback where it `pulls`, and check them. Raises InvalidInput.
    """
    name = os.path.basename(os.fspath(path))
    tabular = name.lower().endswith(".csv")
    try:
        with unchanged(path) as file:
            if tabular:
                arrays = force_table.arrays(file, vertices)
            else:
                arrays = read_arrays(file if file.seekable() else io.BytesIO(npz.content(file)))
    except (FileNotFoundError, IsADirectoryError) as error:
        raise InvalidInput(f"{name}: {unreadable(error)}") from None
    except npz.FAULTS as error:
        raise InvalidInput(f"{name}: cannot be read as forces ({'.csv' if tabular else '.npz'}): {error}") from None
    forces = Forces(arrays["times"], arrays["forces"], arrays.get("gain"), arrays.get("places"), pulls, name)
    count = forces.values.shape[1] if vertices is None and forces.values.ndim == 3 else vertices or 0
    check(forces, count)
    forces = replace(forces, regulator=regulator(arrays, len(forces.values), count, name))
    if pulls and forces.gain is None and forces.regulator is None:
        raise InvalidInput(f"{name}: has no gains and places for a feedback; clothfit control writes some")
    return forces


def read_arrays(file: IO[bytes]) -> dict[str, Array]:
    """The arrays of an open file. Raises one of `npz.FAULTS`."""
    found = npz.stored(file, (*ARRAYS, *FEEDBACK, *NAMES), "forces")
    for name in ARRAYS:
        if name not in found:
            raise ValueError(f"there is no array {name}")
    for name in found:
        if found[name].dtype.kind not in "fiu":
            raise ValueError(f"{name} has the type {found[name].dtype}; numbers are needed")
    free = missing(2 * sum(array.nbytes for array in found.values()))
    if free is not None:
        raise ValueError(f"it takes more memory than the {human(free)} that are free")
    return {name: np.array(array.read(), float) for name, array in found.items()}


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
