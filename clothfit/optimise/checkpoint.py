"""The file from which a fit goes on after it was killed.

It is written whole or not at all: a line with the name of the format and a checksum of all that follows; a line of JSON
with what is fitted to what, and how (`identity`), and with the names and shapes of the records (`journal`); their
numbers, one after the other, as 8 bytes each, little-endian. Nothing in it is ever run.

What a fit remembers of its way, so that it can go on after it was killed.

A fit is deterministic, and all that takes long in it are a few kinds of stage: a cost, a cost with its gradient, a
momentum fit, a scan. Each asks `recall` instead of computing at once, and the answers are kept in order. A fit that is
resumed walks the same way again and is answered from the journal, until that ends and the computing begins: it needs to
know nothing of where the earlier one was. Gauss–Newton, whose models are too large to keep, replaces all that it has
asked by its state after each iteration (`replace`); what came before that is not walked again.

Written: after each iteration of Gauss–Newton; otherwise at most once a second, and so rarely that writing takes at most
a twentieth of the time; and at the end, whatever the end. Killed at any instant, a fit loses what came since.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import stat
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
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
EVERY = 1.0
"""Seconds between two writings, at least, …"""

SHARE = 20.0
"""… and this many times what the last one took."""

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


class Journal:
    """The answers so far, in the order of the questions; without a file nothing is kept."""

    def __init__(
        self, file: Checkpoint | None = None, identity: Mapping[str, str] | None = None, known: Content = NOTHING
    ) -> None:
        """`known`: what an earlier fit has kept of the same way."""
        self.file, self.identity, self.known = file, dict(identity or {}), known
        self.records = list(known.records)
        self.place = 0  # of the next record, where the way is being repeated
        self.search: Any = None  # whose best point and seconds are kept
        self.fault = ""  # why the last writing failed
        self.strayed = False  # whether the way was another than the one known
        self._changed, self._next = False, -np.inf

    @property
    def repeating(self) -> bool:
        """Whether the way is still known."""
        return self.place < len(self.records)

    @property
    def warnings(self) -> list[str]:
        """What the user should know."""
        found = [f"the checkpoint is not up to date: {self.fault}"] if self.fault else []
        if self.strayed:
            found.append("the way of the checkpoint could be followed only in part (other versions of the libraries?)")
        return found

    @contextmanager
    def trusted(self) -> Iterator[None]:
        """Take records for those of such a fit: what goes wrong in the block is put down to a file that was resumed
        from, whose checksum anybody can make. Raises InvalidInput.
        """
        try:
            yield
        except (ValueError, LookupError, TypeError, ArithmeticError) as error:
            if isinstance(error, InvalidInput) or self.file is None or self.known is NOTHING:
                raise
            name = os.fspath(self.file.path)
            raise InvalidInput(f"{name}: holds what no such fit has found; begin anew, without --resume") from error

    def recall(self, name: str, compute: Callable[[], Array], point: Array | None = None) -> Array:
        """An array of any shape: what is known of it, else what `compute` gives, which is kept.

        `compute` must not ask the journal itself. Where a `point` is given, only the answer for that point will do.
        """
        if self.file is None:
            return compute()
        label = name if point is None else f"{name} at {hashlib.sha256(point.tobytes()).hexdigest()[:16]}"
        record = self.next(label)
        if record is None:
            record = Record(label, compute())
            self._keep(record)
        return record.values.copy()  # what is kept stays, whatever becomes of the answer

    def next(self, name: str) -> Record | None:
        """The next record of a known way, which must have that name: one with another ends what is known."""
        if not self.repeating:
            return None
        if self.records[self.place].name != name:
            self.strayed = True
            self.records = self.records[: self.place]
            return None
        self.place += 1
        return self.records[self.place - 1]

    def is_behind(self, cost: float) -> bool:
        """Whether a fit whose best point has that cost is not yet, or no more, where the known one was.

        Past the end of a known way it is further, even if at a larger cost: what the prior adds is not in the cost.
        """
        known = self.known.best
        return len(known) > 0 and (self.repeating or (self.strayed and bool(known[0] < cost)))

    def follows(self, name: str) -> bool:
        """Whether the next record of a known way has that name."""
        return self.repeating and self.records[self.place].name == name

    def replace(self, place: int, records: Sequence[Record], now: bool = True) -> None:
        """Put records in the place of all from `place` on, and write, if not `now`, then in time."""
        if self.file is not None:
            self.records = [*self.records[:place], *records]  # in one step: an interrupt may come between any two
            self.place, self._changed = len(self.records), True
            self.write(now)

    def _keep(self, record: Record) -> None:
        self.place += 1  # first: an interrupt may come between, and nothing must seem to be left of a known way
        self.records.append(record)
        self._changed = True
        self.write(now=False)

    def write(self, now: bool = True) -> None:
        """Write the file, if not `now`, then only where it is time; a fault is a warning, for the fit goes on."""
        began = time.perf_counter()
        if self.file is None or not self._changed or not (now or began >= self._next):
            return
        content = self._content()
        if content.seconds < self.file.after:
            return
        try:
            self.file.write(self.identity, content)
            self.fault, self._changed = "", False
        except InvalidInput as error:
            self.fault = str(error)
        end = time.perf_counter()
        self._next = end + max(EVERY, SHARE * (end - began))

    def _content(self) -> Content:
        at = self.search
        if at is None:
            return Content(self.known.seconds, self.known.best, self.records)
        best = self.known.best if self.is_behind(at.best.cost) else np.array([at.best.cost, *at.best.p])
        return Content(at.progress.seconds, best, self.records)


def opened(checkpoint: str | os.PathLike[str] | Checkpoint | None, resume: bool, same: Mapping[str, str]) -> Journal:
    """The journal in a checkpoint, with what an earlier fit left there where it is resumed.

    `same` is what must be the same for that (`checkpoint.identity`). Raises InvalidInput.
    """
    if checkpoint is None:
        if resume:
            raise InvalidInput("resume: a checkpoint is needed, the file to resume from")
        return Journal()
    file = checkpoint if isinstance(checkpoint, Checkpoint) else Checkpoint(checkpoint)
    file.check()
    return Journal(file, same, file.read(same)) if resume else Journal(file, same)
