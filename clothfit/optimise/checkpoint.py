"""The file from which a fit goes on after it was killed.

It is written whole or not at all: a line with the name of the format and a checksum of all that follows; a line of JSON
with what is fitted to what, and how (`identity`), and with the names and shapes of the records (`journal`); their
numbers, one after the other, as 8 bytes each, little-endian. Nothing in it is ever run.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import stat
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.reading import whole
from clothfit.base.writing import check_writable, write_atomically
from clothfit.objective.experiment import Experiment
from clothfit.scene.scene import Scene, dumps

FORMAT = b"clothfit checkpoint 1 "
SECRET = "#"  # before a digest, which says nothing to a reader


class Record(NamedTuple):
    """What one stage of a fit found."""

    name: str
    values: Array  # of any shape
    text: str = ""


class Content(NamedTuple):
    """What a checkpoint holds of the way so far."""

    seconds: float  # that the fit has taken
    best: Array  # (1 + P,), the best cost and its parameters; (0,) where there is none
    records: Sequence[Record]


NOTHING = Content(0.0, np.zeros(0), ())


@dataclass
class Checkpoint:
    """Where a fit keeps what it needs to go on."""

    path: str | os.PathLike[str]
    after: float = 0.0  # s: a fit that is shorter writes nothing
    written: bool = False  # whether the file is this fit's

    def check(self) -> None:
        """Raise InvalidInput when the file cannot be written, or is there and is no checkpoint."""
        check_writable(self.path)
        if os.path.exists(self.path) and stat.S_ISFIFO(os.stat(self.path).st_mode):  # to open it may take forever
            raise InvalidInput(f"{self._name}: is a pipe, which keeps nothing; name a file for the checkpoint")
        if os.path.isfile(self.path) and os.path.getsize(self.path):
            self._content(len(FORMAT))

    def write(self, identity: Mapping[str, str], content: Content) -> None:
        """Replace the file. Raises InvalidInput."""
        write_atomically(self.path, encoded(identity, content))
        self.written = True

    def read(self, identity: Mapping[str, str]) -> Content:
        """What the file holds. Raises InvalidInput when it is not there, is damaged or belongs to another fit."""
        there, content = decoded(self._content(), self._name)
        self.written = True
        if reasons := differences(there, identity):
            raise InvalidInput(f"{self._name}: belongs to another fit: {'; '.join(reasons)}")
        return content

    def remove(self) -> None:
        """Take the file away where this fit has written it."""
        with suppress(OSError):
            if self.written and stat.S_ISREG(os.stat(self.path).st_mode):
                os.unlink(self.path)

    @property
    def _name(self) -> str:
        return os.fspath(self.path)

    def _content(self, size: int = -1) -> bytes:
        try:
            if os.path.exists(self.path) and not os.path.isfile(self.path):
                raise InvalidInput(f"{self._name}: is not a file, so there is no checkpoint to read")
            with open(self.path, "rb") as file:
                data: bytes = whole(file) if size < 0 else file.read(size)
        except FileNotFoundError:
            raise InvalidInput(f"{self._name}: there is no such checkpoint to resume from") from None
        except OSError as error:
            raise InvalidInput(f"{self._name}: cannot be read: {error.strerror or error}") from None
        if not data.startswith(FORMAT):
            raise InvalidInput(f"{self._name}: is not a checkpoint that this clothfit can read; name another file")
        return data


def encoded(identity: Mapping[str, str], content: Content) -> bytes:
    """The bytes of a file."""
    records = [Record("best", content.best), *content.records]
    shapes = [[record.name, record.text, *record.values.shape] for record in records]
    head = {"identity": dict(identity), "seconds": content.seconds, "records": shapes}
    numbers = b"".join(np.asarray(record.values, "<f8").tobytes() for record in records)
    rest = json.dumps(head).encode() + b"\n" + numbers
    return FORMAT + checksum(rest) + b"\n" + rest


def decoded(data: bytes, name: str) -> tuple[dict[str, str], Content]:
    """Identity and content in the bytes of a file, called `name` in messages. Raises InvalidInput."""
    first, _, rest = data.partition(b"\n")
    if first != FORMAT + checksum(rest):
        raise InvalidInput(f"{name}: is damaged: its checksum is wrong; begin anew, without --resume")
    text, _, numbers = rest.partition(b"\n")
    try:
        return _understood(json.loads(text), np.frombuffer(numbers, "<f8").astype(float))
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError, OverflowError):  # not by `encoded`
        raise InvalidInput(f"{name}: is not what a fit has written; begin anew, without --resume") from None


def _understood(head: Any, flat: Array) -> tuple[dict[str, str], Content]:
    """The same from the line of JSON and all numbers. Raises one of several errors where they are not in order."""
    records, start = [], 0
    for label, word, *shape in head["records"]:
        if not (isinstance(label, str) and isinstance(word, str) and all(type(n) is int and n >= 0 for n in shape)):
            raise ValueError("no record")
        end = start + math.prod(shape)
        records.append(Record(label, flat[start:end].reshape(shape), word))
        start = end
    texts, seconds = head["identity"], head["seconds"]
    plain = all(isinstance(text, str) for text in texts.values())
    if not (plain and start == len(flat) and records[0].values.ndim == 1 and 0 <= float(seconds) < math.inf):
        raise ValueError("no content")
    return texts, Content(float(seconds), records[0].values, records[1:])


def checksum(data: bytes) -> bytes:
    """SHA-256, in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest().encode()


def identity(scene: Scene, targets: Sequence[Experiment] | None, start: object, **options: object) -> dict[str, str]:
    """What must be the same for a fit to go on: a text for each thing, a digest where it is large.

    `targets` None: the scene's own motion; `start` as `fit.estimate` takes it; `options`: whatever else changes the
    way of a fit.
    """
    goals = "the scene's own motion"
    if targets is not None:
        parts: list[bytes | Array] = []
        for target in targets:
            parts += [*arrays(target), b"" if target.scene is scene else dumps(target.scene)]
        goals = digest(*parts)
    first = dumps(start) if isinstance(start, Scene) else start
    if isinstance(first, (bytes, np.ndarray, list, tuple)):
        first = digest(first if isinstance(first, bytes) else np.asarray(first, float))
    texts = {name.replace("_", " "): plainly(value) for name, value in options.items()}
    own = {"scene": digest(dumps(scene)), "target": goals, "start": plainly(first)}
    return {**own, **texts}


def arrays(target: Experiment) -> list[Array]:
    """The arrays of a motion; (0,) for one that it does not have."""
    motion = target.motion
    found = (motion.positions, motion.times, motion.observed, motion.weights)
    return [np.zeros(0) if array is None else np.asarray(array, float) for array in found]


def digest(*parts: bytes | Array) -> str:
    """A short text that differs where one of the parts differs."""
    total = hashlib.sha256()
    for part in parts:
        own = hashlib.sha256(part if isinstance(part, bytes) else repr(part.shape).encode())
        if not isinstance(part, bytes):
            own.update(np.ascontiguousarray(part, "<f8").data)  # not a copy of it
        total.update(own.hexdigest().encode())
    return SECRET + total.hexdigest()[:16]


def plainly(value: object) -> str:
    """A text for a value of an option; numbers that are equal have the same."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name}={plainly(each)}" for name, each in value.items())
    return repr(float(value)) if isinstance(value, (int, float)) else str(value)


def differences(there: Mapping[str, str], here: Mapping[str, str]) -> list[str]:
    """What differs between two identities, each as a few words."""
    found = []
    for name in {**here, **there}:
        old, new = there.get(name, "nothing"), here.get(name, "nothing")
        if old != new:
            secret = old.startswith(SECRET) or new.startswith(SECRET)
            found.append(f"another {name}" if secret else f"{name}: {old} there, {new} now")
    return found
