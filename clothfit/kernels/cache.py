"""Compiled code on disk, one file per function and types of its arguments.

numba's own cache keeps an index per function, which two programs that compile at once can leave pointing to each
other's code; a damaged file of it, or a full disk, ends the program; it needs a writable folder already when
modules are imported; it notices a change in the file of a compiled function, but not in the files of the functions it
calls; and before it loads anything it imports all that numba needs to compile (SciPy included), which takes longer
than all else that a command does at its start. So here:

- a file's name says what is in it: function, what its code depends on (`dependencies`), types, processor, versions.
  There is no index: after an edit the code has another name, and what has been replaced for days goes;
- files appear whole or not at all, and carry a checksum: what is damaged counts as absent, and is written anew;
- folders are made when there is something to write, never when a module is imported;
- where nothing can be written the program still runs, and warns once.

Folders that are read, and written to where that is possible, in this order: what NUMBA_CACHE_DIR says, else
`__pycache__` in the package; the user's cache folder; one in the folder for temporary files. A file can run anything
when it is loaded, so only `trusted` folders are used.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numba
from llvmlite.binding import parse_assembly
from numba.core.caching import FunctionCache
from numba.core.compiler import CompileResult
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from clothfit.base.errors import InvalidInput
from clothfit.kernels import once
from clothfit.kernels.dependencies import digest, types_text
from clothfit.kernels.trusted import Untrusted, made, opened

PACKAGE = Path(__file__).resolve().parents[1]
PREFIX = "kernels-"
FILE_MARK = b"clothfit kernel 1\n"  # what a file begins with; then the SHA-256 of the rest
DAY = 24 * 3600.0  # s
VERSIONS = f"2 {numba.__version__} {sys.version}"  # of the files' form, of numba, of Python
config: Any = numba.config  # numba has no types
if config.DISABLE_JIT:
    raise InvalidInput("NUMBA_DISABLE_JIT is set, and nothing runs without compiled code; unset it")


@cache
def folders() -> tuple[Path, ...]:
    """The folders for the code of these versions, in the order in which they are tried; they may not exist."""
    first = Path(config.CACHE_DIR) if config.CACHE_DIR else PACKAGE / "__pycache__"
    versions = hashlib.sha256(VERSIONS.encode()).hexdigest()[:16]
    return tuple(base / f"{PREFIX}{versions}" for base in (first, *_own_bases()))


def _own_bases() -> list[Path]:
    """Folders of the user; what is not an absolute path, as without a home, is left out."""
    home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or os.path.expanduser("~/.cache")
    user = str(os.getuid()) if hasattr(os, "getuid") else "user"  # the temporary folder of Windows is the user's own
    with suppress(OSError):  # not even that
        return [base for base in (Path(home) / "clothfit", Path(tempfile.gettempdir()) / f"clothfit-{user}")
                if base.is_absolute()]
    return []


def of_package() -> str:
    """A digest of all files of the package."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(PACKAGE.rglob("*.py")))).hexdigest()


def file_name(name: str, *key: object) -> str:
    """The name of a file for one key."""
    return f"{name}-{hashlib.sha256(repr((name, key)).encode()).hexdigest()[:24]}"


def stem(function: Callable[..., object]) -> str:
    """How the names of all files begin that have the code of a function as it is now."""
    return f"{_named(function)}-{digest(function)}"


def _named(function: Callable[..., object]) -> str:
    return f"{function.__module__.removeprefix('clothfit.')}.{function.__code__.co_name}"


def load(name: str) -> tuple[Path, bytes] | None:
    """The folder and the content that was kept under a name; None where there is none, or it is damaged."""
    for number, path in enumerate(folders()):
        with suppress(OSError):
            with opened(path, named=number == 0) as folder:
                data = folder.read(name)
            mark, content = data[: len(FILE_MARK) + 32], data[len(FILE_MARK) + 32 :]
            if mark == FILE_MARK + hashlib.sha256(content).digest():
                return path, content
    return None


def save(name: str, content: bytes) -> Path:
    """Keep `content` under a name, in the first folder where that is possible; returns the folder. Files that it
    replaces, whose names have the same first part, go when they are old.

    Warns where others can write to NUMBA_CACHE_DIR, which is then left. Raises the OSError of the first folder where
    no folder can be written.
    """
    faults: list[OSError] = []
    for number, path in enumerate(folders()):
        shared = number == 0
        kept = None if shared and config.CACHE_DIR else DAY if shared else 30 * DAY  # it may serve several versions
        try:
            with made(path, shared, PREFIX, kept) as folder:
                folder.write(name, FILE_MARK + hashlib.sha256(content).digest() + content)
                folder.remove_old(".", DAY)  # locks and halves of files of processes that were killed
                if kept is not None and name.count("-") > 1:
                    folder.remove_old(name.split("-")[0] + "-", kept, name.rsplit("-", 1)[0])
        except OSError as error:
            faults.append(error)
            continue
        if faults and isinstance(faults[0], Untrusted) and config.CACHE_DIR:
            _leave_named(str(faults[0].filename), str(faults[0].strerror), path)
        return path
    raise faults[0]  # there is at least one folder


@cache
def _leave_named(folder: str, reason: str, instead: Path) -> None:
    """Warn, once."""
    why = f"as what is in it can run: {folder}: {reason}"
    warn(f"NUMBA_CACHE_DIR is not used, {why}; compiled code is kept in {instead}")


def _warn(message: str) -> None:
    warnings.warn(message, RuntimeWarning, stacklevel=2)


warn: Callable[[str], None] = _warn
"""Called once, with a sentence, when compiled code cannot be kept; a program may replace it."""


def only_called(payload: tuple[Any, ...]) -> tuple[Any, ...]:
    """What numba keeps of a function without what only other functions need, for one that no other calls.

    That is its bitcode, which other code would be linked with: in its place a module with nothing but the names
    by which the function is found. And the environments of numba's own functions that hold no constants: compiled
    code never asks for them, but to load one imports the module it is of, with numba's strings, dates, …
    """
    (name, kind, (machine_code, _)), described, *rest, environments = payload
    names = described.llvm_cpython_wrapper_name, described.llvm_func_name  # for Python; for a call through a pointer
    called = "\n".join(f'define void @"{each}"() {{ ret void }}' for each in names)
    kept = [each for each in environments if each.consts or not each.globals["__name__"].startswith("numba.")]
    return (name, kind, (machine_code, parse_assembly(called).as_bitcode())), described, *rest, tuple(kept)


class KernelCache(FunctionCache):
    """The cache of one function, which numba asks for compiled code and hands compiled code to."""

    failed = False  # whether something could not be written. These two are of the class: they hold for all functions
    used: Path | None = None  # the folder that was last written to, or read from
    names: ClassVar[set[str]] = set()  # of the files written or read

    def __init__(self, function: Callable[..., object], variant: str = "") -> None:
        # not that of the base class, which makes folders
        self._py_func, self._name, self.variant = function, function.__qualname__, variant
        self.linked = variant == "inner"  # not called by an address, but linked with others
        self.enable()

    @property
    def cache_path(self) -> str:
        """The folder that is tried first."""
        return str(folders()[0])

    def flush(self) -> None:
        """Do nothing: files of other sources have other folders."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Give the compiled function for a signature, or None."""
        if not self._enabled:
            return None
        key = self._index_key(sig, target_context.codegen())
        name = self._file(key)
        kept = load(name)
        if kept is None:
            return None
        try:
            found, payload = pickle.loads(kept[1])
        except (AttributeError, ImportError):  # of another checkout, with classes that are not here
            return None
        if found != key:  # other types by the same names
            return None
        KernelCache.used = kept[0]
        KernelCache.names.add(name)
        rtsys.initialize(target_context)  # of all that the base class prepares, what code needs that only runs
        if self.linked:
            from clothfit.kernels.linking import rebuilt  # needed only to compile

            return rebuilt(target_context, payload)
        return CompileResult._rebuild(target_context, *payload)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function."""
        cannot = any(not lifted.can_cache for lifted in data.lifted) or data.library.has_dynamic_globals
        if not self._enabled or cannot or KernelCache.failed:
            return
        key = self._index_key(sig, data.codegen)
        try:
            name = self._file(key)
            payload = data._reduce()
            KernelCache.used = save(name, dumps((key, payload if self.linked else only_called(payload))))
            KernelCache.names.add(name)
        except OSError as error:
            KernelCache.failed = True
            reason = error.strerror or str(error)
            warn(f"compiled code cannot be kept, so every start compiles again: {folders()[0]}: {reason}")

    @contextmanager
    def alone(self, sig: Any, codegen: Any, poll: Callable[[], None]) -> Iterator[None]:
        """Keep other processes from compiling for a signature within the block, if it is not kept yet; `poll` is called
        while another one compiles (`once`).
        """
        name, path = self._file(self._index_key(sig, codegen)), folders()[0]
        with ExitStack() as stack:
            if self._enabled and not KernelCache.failed and not self.holds(sig, codegen):
                with suppress(OSError):
                    folder = stack.enter_context(made(path, True, PREFIX, None if config.CACHE_DIR else DAY))
                    stack.enter_context(once.locked(folder, name, poll))
            yield

    def holds(self, sig: Any, codegen: Any) -> bool:
        """Whether there is a file for a signature."""
        name = self._file(self._index_key(sig, codegen))
        return any((each / name).exists() for each in folders())

    def _file(self, key: object) -> str:
        """The file's name for a function's signature, bytecode and processor."""
        signature: Any = key[0]  # type: ignore[index]
        return file_name(stem(self._py_func), self.variant, key, types_text(getattr(signature, "args", signature)))


def is_kept(function: Callable[..., object]) -> bool:
    """Whether there is compiled code of a kernel."""
    own = stem(getattr(function, "py_func", function)) + "-"
    return any(name.startswith(own) for name in _names())


def _names() -> list[str]:
    """The names of all files that are kept."""
    found = []
    for number, path in enumerate(folders()):
        with suppress(OSError), opened(path, named=number == 0) as folder:
            found += folder.names()
    return found
