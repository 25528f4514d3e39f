"""The file from which a search goes on after it was killed: of a fit, of a search for controls, of a training.

An `.npz` archive, written whole or not at all. Its first array has the name of the kind and holds text: a checksum of
all that follows, and a line of JSON with what is searched for and how (`identity`), and with all of the state that is
no array; then come the arrays. It is written when a search has taken `after` seconds, then at most once a second and so
rarely that writing takes at most a twentieth of the time, and at the end. Nothing in it is ever run.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import stat
import time
import zipfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clothfit.base import npz
from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import unreadable
from clothfit.base.reading import whole
from clothfit.base.writing import check_writable, write_atomically

SECRET = "#"  # before a digest, which says nothing to a reader

EVERY = 1.0
"""Seconds between two writings, at least, …"""

WRITING_SHARE = 20.0
"""… and this many times what the last one took."""

NAME_AT = 30
"""Where a zip archive has the name of its first file."""


@dataclass
class Checkpoint:
    """Where a search keeps what it needs to go on."""

    path: str | os.PathLike[str]
    after: float = 0.0  # s: a search that is shorter writes nothing
    resume: bool = False  # whether to go on with what the file has
    written: bool = False  # whether the file is this search's
    identity: Mapping[str, str] = field(default_factory=dict)  # of this search
    fault: str = ""  # why the last writing failed
    due: float = -math.inf  # when it is time for the next writing
    began: float = field(default_factory=time.perf_counter)  # when the search did, the time of earlier runs included

    kind: ClassVar[str] = "search"

    def check(self) -> None:
        """Raise InvalidInput when the file cannot be written, or is there and is no checkpoint."""
        check_writable(self.path)
        if os.path.exists(self.path) and stat.S_ISFIFO(os.stat(self.path).st_mode):  # to open it may take forever
            raise InvalidInput(f"{self.name}: is a pipe, which keeps nothing; name a file for the checkpoint")
        if os.path.isfile(self.path) and os.path.getsize(self.path):
            self.content(NAME_AT + 100)

    def begin(self, identity: Mapping[str, str]) -> dict[str, Any]:
        """What to go on with, empty where nothing is asked for. Raises InvalidInput where it belongs to another search.
        """
        self.check()
        self.identity = dict(identity)
        found = self.state() if self.resume else {}
        self.began = time.perf_counter() - found.get("seconds", 0.0)
        return found

    def keep(self, state: Callable[[], Mapping[str, Any]], now: bool = False) -> None:
        """Write a state, if not `now`, then only where it is time; a fault is noted, for the search goes on. Its
        `seconds` are what the search has taken, unless it has its own.
        """
        began = time.perf_counter()
        if not now and began < self.due:
            return
        found = {"seconds": began - self.began, **state()}
        if found["seconds"] < self.after:
            return
        try:
            write_atomically(self.path, encoded(self.kind, self.identity, found))
            self.written, self.fault = True, ""
        except InvalidInput as error:
            self.fault = f"the checkpoint is not up to date: {error}"
        end = time.perf_counter()
        self.due = end + max(EVERY, WRITING_SHARE * (end - began))

    def state(self) -> dict[str, Any]:
        """The state in the file. Raises InvalidInput when the file is not there, is damaged or belongs to another
        search.
        """
        there, state, _ = decoded(self.kind, self.content(), self.name)
        self.written = True
        if reasons := differences(there, self.identity):
            raise InvalidInput(f"{self.name}: belongs to another {self.kind}: {'; '.join(reasons)}")
        return state

    def note_result(self, result: bytes) -> None:
        """Note in the file that this search has ended with the scene in these bytes, which is to replace the scene that
        it began with. A fault is none of the search: the scene is then refused where the search is resumed.
        """
        with suppress(InvalidInput, OSError):
            identity, state, _ = decoded(self.kind, self.content(), self.name)
            write_atomically(self.path, encoded(self.kind, identity, state, digest(result)))

    def has_result(self, scene: bytes) -> bool:
        """Whether the bytes of a scene are the result of the search in the file. Raises InvalidInput as `state` does.
        """
        return decoded(self.kind, self.content(), self.name)[2] == digest(scene)

    def remove(self) -> None:
        """Take the file away where this search has written it."""
        with suppress(OSError):
            if self.written and stat.S_ISREG(os.stat(self.path).st_mode):
                os.unlink(self.path)

    @property
    def name(self) -> str:
        """For messages."""
        return os.fspath(self.path)

    def content(self, size: int = -1) -> bytes:
        """The bytes of the file, or so many of them. Raises InvalidInput where it is no such checkpoint."""
        try:
            if os.path.exists(self.path) and not os.path.isfile(self.path):
                raise InvalidInput(f"{self.name}: is not a file, so there is no checkpoint to read")
            with open(self.path, "rb") as file:
                data: bytes = whole(file) if size < 0 else file.read(size)
        except FileNotFoundError:
            kept = f"a {self.kind} keeps one after a minute, or with --checkpoint, and removes its own when it has "
            why = kept + "converged" if self.after else f"no {self.kind} that keeps one there has begun"
            raise InvalidInput(f"{self.name}: there is no such checkpoint to resume from; {why}") from None
        except OSError as error:
            raise InvalidInput(f"{self.name}: {unreadable(error)}") from None
        if not (data.startswith(npz.ZIP_MAGIC) and data[NAME_AT:].startswith(f"{self.kind}.npy".encode())):
            raise InvalidInput(f"{self.name}: is not a checkpoint that this clothfit can read; name another file")
        return data


def encoded(kind: str, identity: Mapping[str, str], state: Mapping[str, Any], result: str | None = None) -> bytes:
    """The bytes of a file."""
    held = {name: each for name, each in state.items() if isinstance(each, np.ndarray)}
    facts = {name: each for name, each in state.items() if name not in held}
    about = {"identity": dict(identity), "state": facts, "result": result}
    return archived(kind, json.dumps(about, default=np.ndarray.tolist).encode(), held)


def archived(kind: str, about: bytes, held: Mapping[str, NDArray[Any]]) -> bytes:
    """The archive of a text and of arrays, with their checksum."""
    head = np.frombuffer(checksum(about, held) + b"\n" + about, np.uint8)
    file = io.BytesIO()
    np.savez(file, **{kind: head, **held})  # type: ignore[arg-type]  # takes `allow_pickle` for an array
    return file.getvalue()


def decoded(kind: str, data: bytes, name: str) -> tuple[dict[str, str], dict[str, Any], str | None]:
    """Identity, state and the digest of a result in the bytes of a file, called `name` in messages. Raises
    InvalidInput.
    """
    try:
        head, held = opened(kind, data)
    except (*npz.FAULTS, KeyError, NotImplementedError):
        head, held = b"", {}
    first, _, about = head.partition(b"\n")
    if first != checksum(about, held):
        raise InvalidInput(f"{name}: is damaged: its checksum is wrong; begin anew, without --resume")
    try:
        found = json.loads(about)
        identity, state = dict(found["identity"]), {**found["state"], **held}
        possible = all(isinstance(text, str) for text in identity.values())
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError):  # not by `encoded`
        possible = False
    if not possible:
        raise InvalidInput(impossible(kind, name))
    return identity, state, found.get("result")


def impossible(kind: str, name: str) -> str:
    """What is said of a whole file with a state that cannot be."""
    return f"{name}: is not what a {kind} has written; begin anew, without --resume"


def opened(kind: str, data: bytes) -> tuple[bytes, dict[str, NDArray[Any]]]:
    """The text and the arrays in the bytes of a file. Raises one of several errors where they cannot be read."""
    names = [each.removesuffix(".npy") for each in zipfile.ZipFile(io.BytesIO(data)).namelist()]
    held = {name: each.read() for name, each in npz.stored(io.BytesIO(data), names, "").items()}
    return held.pop(kind).tobytes(), held


def checksum(text: bytes, held: Mapping[str, NDArray[Any]]) -> bytes:
    """SHA-256 of a text and of arrays, in hexadecimal digits."""
    total = hashlib.sha256(text)
    for name in sorted(held):
        total.update(repr((name, held[name].dtype.str, held[name].shape)).encode())
        total.update(np.ascontiguousarray(held[name]).tobytes())
    return total.hexdigest().encode()


def digest(*parts: bytes | Array) -> str:
    """A short text that differs where one of the parts differs."""
    total = hashlib.sha256()
    for part in parts:
        own = hashlib.sha256(part if isinstance(part, bytes) else repr(part.shape).encode())
        if not isinstance(part, bytes):
            own.update(np.ascontiguousarray(part, "<f8").data)  # not a copy of it
        total.update(own.hexdigest().encode())
    return SECRET + total.hexdigest()[:16]


def differences(there: Mapping[str, str], here: Mapping[str, str]) -> list[str]:
    """What differs between two identities, each as a few words."""
    found = []
    for name in {**here, **there}:
        old, new = there.get(name, "nothing"), here.get(name, "nothing")
        if old != new:
            secret = old.startswith(SECRET) or new.startswith(SECRET)
            found.append(f"another {name}" if secret else f"{name}: {old} there, {new} now")
    return found
