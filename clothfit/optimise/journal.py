"""What a fit remembers of its way, so that it can go on after it was killed.

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
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Protocol

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.optimise.checkpoint import NOTHING, Checkpoint, Content, Record

EVERY = 1.0
"""Seconds between two writings, at least, …"""

SHARE = 20.0
"""… and this many times what the last one took."""


class Standing(Protocol):
    """How far a fit is."""

    best: Array  # (P,)
    best_cost: float

    @property
    def seconds(self) -> float:
        """Since it began."""


class Journal:
    """The answers so far, in the order of the questions; without a file nothing is kept."""

    def __init__(
        self, file: Checkpoint | None = None, identity: Mapping[str, str] | None = None, known: Content = NOTHING
    ) -> None:
        """`known`: what an earlier fit has kept of the same way."""
        self.file, self.identity, self.known = file, dict(identity or {}), known
        self.records = list(known.records)
        self.place = 0  # of the next record, where the way is being repeated
        self.standing: Standing | None = None
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
        at = self.standing
        if at is None:
            return Content(self.known.seconds, self.known.best, self.records)
        best = self.known.best if self.is_behind(at.best_cost) else np.array([at.best_cost, *at.best])
        return Content(at.seconds, best, self.records)


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
