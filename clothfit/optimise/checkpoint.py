"""The file from which a fit goes on after it was killed, and what it holds.

A fit that is resumed does not repeat its way: it restarts the stage that it was in (`strategy.auto`), the first model
of the ladder that it had not finished, or the optimiser, from the best values, with the prior that it had learned. It
counts evaluations and seconds from its first beginning. So it comes to the same minimum, not to the same last bits.

The file is written whole or not at all: a line with the name of the format and a checksum of all that follows, then a
line of JSON with what is fitted to what, and how (`identity`), and with the `State`. It is written after the first
evaluation, then at most once a second and so rarely that writing takes at most a twentieth of the time, and at the end.
Nothing in it is ever run.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import stat
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import unreadable
from clothfit.base.reading import whole
from clothfit.base.writing import check_writable, write_atomically
from clothfit.engine.inputs.sources import arrays_from_files
from clothfit.objective.experiment import Experiment
from clothfit.optimise.status import Rung, Status
from clothfit.scene.factors import FACTOR_MODES
from clothfit.scene.scene import Scene, dumps

FORMAT_LINE = b"clothfit checkpoint 5 "
SECRET = "#"  # before a digest, which says nothing to a reader

EVERY = 1.0
"""Seconds between two writings, at least, …"""

WRITING_SHARE = 20.0
"""… and this many times what the last one took."""


class State(NamedTuple):
    """What a fit goes on from; P parameters, of which Q are fitted."""

    start: Array  # (P,), where the fit began
    best: Array  # (P,)
    cost: float  # of the best point
    gradient: Array  # (P,), of that, as far as it is known
    centre: Array  # (Q,), coordinates around which the prior scatters; (0,) without one
    tau: tuple[float, ...]  # its widths
    y: Array  # (Q,), from where Gauss–Newton goes on; (0,) where it is not under way, as `before`
    radius: float  # of its trust region; 0: not chosen yet
    window: int  # frames that it compares
    before: Array  # (P,), the best point before it
    before_cost: float
    history: Sequence[float]  # best cost at each evaluation
    beside: int  # further simulations
    seconds: float  # that the fit has taken
    warnings: Sequence[str]
    status: Status | None = None  # None while it runs
    model: str = ""  # that was chosen for the fit, a letter; none was where it is empty
    substeps: int = 0  # that were chosen, steps by BDF2 to a frame of the target; 0: the scene's own step
    rungs: Sequence[Rung] = ()  # the models that were fitted from coarse to fine, to their end
    best_centre: Array = np.zeros(0)  # as `centre`, of the prior that the best point was found with
    best_tau: tuple[float, ...] = ()


@dataclass
class Checkpoint:
    """Where a fit keeps what it needs to go on."""

    path: str | os.PathLike[str]
    after: float = 0.0  # s: a fit that is shorter writes nothing
    written: bool = False  # whether the file is this fit's
    identity: Mapping[str, str] = field(default_factory=dict)  # of this fit
    fault: str = ""  # why the last writing failed
    due: float = -math.inf  # when it is time for the next writing

    def check(self) -> None:
        """Raise InvalidInput when the file cannot be written, or is there and is no checkpoint."""
        check_writable(self.path)
        if os.path.exists(self.path) and stat.S_ISFIFO(os.stat(self.path).st_mode):  # to open it may take forever
            raise InvalidInput(f"{self._name}: is a pipe, which keeps nothing; name a file for the checkpoint")
        if os.path.isfile(self.path) and os.path.getsize(self.path):
            self._content(len(FORMAT_LINE))

    def save(self, state: Callable[[], State], now: bool = False) -> None:
        """Write the state, if not `now`, then only where it is time; a fault is a warning, for the fit goes on."""
        began = time.perf_counter()
        if not now and began < self.due:
            return
        found = state()
        if found.seconds < self.after:
            return
        try:
            write_atomically(self.path, encoded(self.identity, found))
            self.written, self.fault = True, ""
        except InvalidInput as error:
            self.fault = f"the checkpoint is not up to date: {error}"
        end = time.perf_counter()
        self.due = end + max(EVERY, WRITING_SHARE * (end - began))

    def read(self, count: int) -> State:
        """The state of a fit of so many parameters. Raises InvalidInput when the file is not there, is damaged or
        belongs to another fit.
        """
        there, state = decoded(self._content(), self._name)
        self.written = True
        if reasons := differences(there, self.identity):
            raise InvalidInput(f"{self._name}: belongs to another fit: {'; '.join(reasons)}")
        if not state.model and len(state.best) != count:
            raise InvalidInput(f"{self._name}: is not what a fit has written; begin anew, without --resume")
        return state

    def note_result(self, result: bytes) -> None:
        """Note in the file that this fit has ended with the scene in these bytes, which is to replace the scene that it
        began with. A fault is none of the fit: the scene is then refused where the fit is resumed.
        """
        with suppress(InvalidInput, ValueError, OSError):
            _, _, rest = self._content().partition(b"\n")
            noted = json.dumps({**json.loads(rest), "result": digest(result)}).encode()
            write_atomically(self.path, FORMAT_LINE + checksum(noted) + b"\n" + noted)

    def has_result(self, scene: bytes) -> bool:
        """Whether the bytes of a scene are the result of the fit in the file. Raises InvalidInput as `read` does."""
        data = self._content()
        decoded(data, self._name)
        return bool(json.loads(data.partition(b"\n")[2]).get("result") == digest(scene))

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
            kept = "a fit keeps one after a minute, or with --checkpoint, and removes its own when it has converged"
            why = kept if self.after else "no fit that keeps one there has begun"
            raise InvalidInput(f"{self._name}: there is no such checkpoint to resume from; {why}") from None
        except OSError as error:
            raise InvalidInput(f"{self._name}: {unreadable(error)}") from None
        if not data.startswith(FORMAT_LINE):
            raise InvalidInput(f"{self._name}: is not a checkpoint that this clothfit can read; name another file")
        return data


def opened(
    checkpoint: str | os.PathLike[str] | Checkpoint | None, resume: bool, identity: Mapping[str, str], count: int
) -> tuple[Checkpoint | None, State | None]:
    """The checkpoint of a fit of so many parameters, and the state to go on from where it is resumed.

    Raises InvalidInput.
    """
    if checkpoint is None:
        if resume:
            raise InvalidInput("resume: a checkpoint is needed, the file to resume from")
        return None, None
    file = checkpoint if isinstance(checkpoint, Checkpoint) else Checkpoint(checkpoint)
    file.check()
    file.identity = dict(identity)
    return file, file.read(count) if resume else None


def encoded(identity: Mapping[str, str], state: State) -> bytes:
    """The bytes of a file."""
    rest = json.dumps({"identity": dict(identity), "state": state._asdict()}, default=np.ndarray.tolist).encode()
    return FORMAT_LINE + checksum(rest) + b"\n" + rest


def decoded(data: bytes, name: str) -> tuple[dict[str, str], State]:
    """Identity and state in the bytes of a file, called `name` in messages. Raises InvalidInput."""
    first, _, rest = data.partition(b"\n")
    if first != FORMAT_LINE + checksum(rest):
        raise InvalidInput(f"{name}: is damaged: its checksum is wrong; begin anew, without --resume")
    try:
        head = json.loads(rest)
        identity, state = head["identity"], _understood(head["state"])
        possible = all(isinstance(text, str) for text in identity.values()) and is_possible(state)
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError, OverflowError):  # not by `encoded`
        possible = False
    if not possible:
        raise InvalidInput(f"{name}: is not what a fit has written; begin anew, without --resume")
    return identity, state


def _understood(values: Mapping[str, Any]) -> State:
    """A state from JSON. Raises one of several errors where the values are of other types."""
    names = ("start", "best", "gradient", "centre", "y", "before", "best_centre")
    start, best, gradient, centre, y, before, best_centre = (np.array(values[name], float) for name in names)
    numbers = (float(values[name]) for name in ("cost", "before_cost", "radius", "seconds"))
    cost, before_cost, radius, seconds = numbers
    tau, best_tau, history = (tuple(map(float, values[name])) for name in ("tau", "best_tau", "history"))
    window, beside = (int(values[name]) for name in ("window", "beside"))
    warnings, status = [str(text) for text in values["warnings"]], values["status"]
    rungs = [Rung(str(m), int(n), float(e), np.array(p, float), float(s)) for m, n, e, p, s in values["rungs"]]
    return State(
        start, best, cost, gradient, centre, tau, y, radius, window, before, before_cost, history, beside, seconds,
        warnings, None if status is None else Status(status), str(values["model"]), int(values["substeps"]), rungs,
        best_centre, best_tau,
    )  # fmt: skip


def is_possible(state: State) -> bool:
    """Whether a fit can have come to a state."""
    arrays = (state.start, state.best, state.gradient, state.centre, state.y, state.before, state.best_centre)
    return (
        all(array.ndim == 1 and bool(np.isfinite(array).all()) for array in arrays)
        and len(state.start) == len(state.best) == len(state.gradient)
        and len(state.before) in (0, len(state.best))
        and len(state.y) in (0, len(state.centre))
        and all(0 <= number < math.inf for number in (state.cost, state.radius, state.seconds))
        and state.before_cost >= 0
        and all(width > 0 for width in (*state.tau, *state.best_tau))
        and not any(math.isnan(cost) for cost in state.history)
        and all(text.isprintable() for text in state.warnings)
        and min(state.window, state.beside, state.substeps) >= 0
        and state.model in ("", *FACTOR_MODES, "L")
        and all(is_possible_rung(rung, len(state.best)) for rung in state.rungs)
    )


def is_possible_rung(rung: Rung, count: int) -> bool:
    """Whether a model of a fit of so many parameters can have come to this."""
    return (
        rung.model in (*FACTOR_MODES, "G", "L")
        and rung.values >= 0
        and min(rung.rmse, rung.seconds) >= 0
        and math.isfinite(rung.seconds)
        and rung.p.shape == (count,)
        and bool(np.isfinite(rung.p).all())
    )


def checksum(data: bytes) -> bytes:
    """SHA-256, in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest().encode()


def identity(scene: Scene, targets: Sequence[Experiment] | None, start: object, **options: object) -> dict[str, str]:
    """What must be the same for a fit to go on: a text for each thing, a digest where it is large.

    `targets` None: the scene's own motion; `start` as `fit.estimate` takes it; `options`: whatever else changes the
    way of a fit.
    """
    compared = "the scene's own motion"
    if targets is not None:
        parts: list[bytes | Array] = []
        for target in targets:
            parts += [*arrays(target), b"" if target.scene is scene else dumps(target.scene)]
            parts += [] if target.scene is scene else arrays_from_files(target.scene)
        compared = digest(*parts)
    first = dumps(start) if isinstance(start, Scene) else start
    if isinstance(first, (bytes, np.ndarray, list, tuple)):
        first = digest(first if isinstance(first, bytes) else np.asarray(first, float))
    texts = {name.replace("_", " "): plainly(value) for name, value in options.items()}
    own = {"scene": digest(dumps(scene)), "target": compared, "start": plainly(first)}
    files = arrays_from_files(scene)
    inputs = {"input files": digest(*files)} if files else {}
    return {**own, **inputs, **texts}


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
    if callable(value):
        function = getattr(value, "function", value)
        return f"{function.__module__}.{getattr(function, '__qualname__', type(function).__qualname__)}"
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
