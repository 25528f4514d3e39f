"""The file from which a search for controls goes on after it was killed.

An `.npz` archive, written whole or not at all: `identity`, a digest of the scene, the keys and what may move, and what
the search was at. It is written when the search has taken `after` seconds, then at most every EVERY seconds and so
rarely that writing takes at most a twentieth of the time.
"""

from __future__ import annotations

import io
import os
import stat
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from clothfit.base import npz
from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import unreadable
from clothfit.base.reading import unchanged
from clothfit.base.writing import check_writable, write_atomically
from clothfit.control.closed_loop import Costs
from clothfit.control.controls import Controls
from clothfit.control.keyframes import Key
from clothfit.engine.inputs.sources import arrays_from_files
from clothfit.optimise.checkpoint import EVERY, WRITING_SHARE, digest
from clothfit.scene.scene import Scene, dumps

NAMES = ("identity", "z", "numbers", "paths", "forces", "multipliers")
"""Of all arrays that a file may have."""


@dataclass
class Checkpoint:
    """Where a search keeps what it needs to go on."""

    path: str | os.PathLike[str]
    after: float = 0.0  # s: a search that is shorter writes nothing
    resume: bool = False  # whether to go on with what the file has
    written: bool = False  # whether the file is this search's
    identity: str = ""  # of this search
    fault: str = ""  # why the last writing failed
    began: float = 0.0
    due: float = 0.0  # when it is time for the next writing

    def check(self) -> None:
        """Raise InvalidInput when the file cannot be written, or is there and is no checkpoint."""
        check_writable(self.path)
        if os.path.exists(self.path) and not stat.S_ISREG(os.stat(self.path).st_mode):
            raise InvalidInput(f"{self.name}: is no file that can be kept; name another one for the checkpoint")
        if os.path.exists(self.path) and os.path.getsize(self.path):
            self.arrays()

    @property
    def name(self) -> str:
        """For messages."""
        return os.fspath(self.path)

    def begin(self, identity: str) -> dict[str, Array]:
        """What to go on with, empty where nothing is asked for. Raises InvalidInput where it belongs to another search.
        """
        self.check()
        self.identity, self.began = identity, time.perf_counter()
        self.due = self.began + self.after
        if not self.resume:
            return {}
        if not os.path.exists(self.path):
            raise InvalidInput(f"{self.name}: there is no such checkpoint to resume from; begin without --resume")
        found = self.arrays()
        if text_of(found["identity"]) != identity:
            raise InvalidInput(f"{self.name}: belongs to another search: another scene, keys or options")
        self.written = True
        return found

    def arrays(self) -> dict[str, Array]:
        """The arrays in the file. Raises InvalidInput."""
        try:
            with unchanged(self.path) as file:
                stored = npz.stored(io.BytesIO(npz.content(file)), NAMES, "identity")
                found = {name: np.array(each.read(), float) for name, each in stored.items()}
        except npz.FAULTS as error:
            raise InvalidInput(f"{self.name}: is not a checkpoint that can be read: {unreadable(error)}") from None
        if "identity" not in found:
            raise InvalidInput(f"{self.name}: is not a checkpoint of clothfit control; name another file")
        if not all(np.isfinite(each).all() for each in found.values()):
            raise InvalidInput(f"{self.name}: is damaged; begin without --resume")
        return found

    def save(self, state: Callable[[], Mapping[str, Array]], now: bool = False) -> None:
        """Write a state where it is time; a fault is noted, for the search goes on."""
        began = time.perf_counter()
        if began < (self.began + self.after if now else self.due):
            return
        try:
            write_atomically(self.path, npz.archive({"identity": numbers_of(self.identity), **state()}))
            self.written, self.fault = True, ""
        except InvalidInput as error:
            self.fault = f"the checkpoint is not up to date: {error}"
        end = time.perf_counter()
        self.due = end + max(EVERY, WRITING_SHARE * (end - began))

    def remove(self) -> None:
        """Take the file away where this search has written it."""
        with suppress(OSError):
            if self.written and stat.S_ISREG(os.stat(self.path).st_mode):
                os.unlink(self.path)


@dataclass
class Search:
    """Where the search for the forces of a cloth is, in its closed loop."""

    path: Array  # (T + 1, n, 3), m, of the loop
    f: Array  # (T, n, 3), N, the best so far
    rate: float  # of the loop's springs, 1/s
    penalty: float
    multipliers: Array  # (M,), of the keys that are penalties, one after another
    ended: float  # which status it ended with; −1 where it has not
    steepest: float  # slope where it began


def packed(searches: Mapping[int, Search]) -> dict[str, Array]:
    """The searches of some cloths as arrays."""
    order = sorted(searches)
    rows = [
        [cloth, len(own.f), own.f.shape[1], own.rate, own.penalty, len(own.multipliers), own.ended, own.steepest]
        for cloth in order
        for own in [searches[cloth]]
    ]
    parts = {name: [np.zeros(0)] for name in ("paths", "forces", "multipliers")}
    for cloth in order:
        own = searches[cloth]
        for name, each in (("paths", own.path), ("forces", own.f), ("multipliers", own.multipliers)):
            parts[name].append(each.reshape(-1))
    return {"numbers": np.array(rows, float), **{name: np.concatenate(each) for name, each in parts.items()}}


def unpacked(arrays: Mapping[str, Array]) -> dict[int, Search]:
    """The searches in such arrays; none where there are none."""
    found, at = {}, [0, 0, 0]
    for cloth, steps, n, rate, penalty, count, *last in arrays.get("numbers", np.zeros((0, 8))):
        size = 3 * int(n) * int(steps)
        ends = [at[0] + size + 3 * int(n), at[1] + size, at[2] + int(count)]
        names = "paths", "forces", "multipliers"
        path, f, left = (arrays[name][begin:end] for name, begin, end in zip(names, at, ends, strict=True))
        shape = (-1, int(n), 3)
        found[int(cloth)] = Search(path.reshape(shape), f.reshape(shape), rate, penalty, left, *last)
        at = ends
    return found


def numbers_of(text: str) -> Array:
    """A text as numbers."""
    return np.frombuffer(text.encode(), np.uint8).astype(float)


def text_of(numbers: Array) -> str:
    """The text of such numbers, empty where it is none."""
    inside = ((numbers >= 32) & (numbers < 127)).all() if numbers.ndim == 1 else False
    return numbers.astype(np.uint8).tobytes().decode("ascii") if inside else ""


def identity(scene: Scene, keys: Sequence[Key], controls: Controls, costs: Costs) -> str:
    """What must be the same for a search to go on."""
    parts: list[bytes | Array] = [dumps(scene), *arrays_from_files(scene)]
    for key in keys:
        given = key.velocities, key.share
        parts += [np.array([key.step, key.cloth, key.weight, key.hard], float), key.vertices.astype(float)]
        parts += [key.positions, *(np.zeros(0) if each is None else each for each in given)]
    for flags in controls.forces or ():
        parts.append(np.asarray(flags, float))
    for handle in controls.handles:
        parts.append(np.concatenate([[handle.cloth], handle.vertices]).astype(float))
    said = controls.wind, controls.velocity, controls.every, controls.modes, controls.pushes, costs
    return digest(*parts, repr(said).encode())
