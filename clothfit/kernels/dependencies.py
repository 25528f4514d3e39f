"""What the code of a kernel depends on: its own bytecode, that of all kernels it calls, and the constants they use.

Compiled code is kept under a digest of that (`cache`), so an edit compiles again what it touches and nothing else:
neither a comment nor another module counts. A kernel's globals are followed by the names in its bytecode. Names of
modules lead to what their attributes of these names are; other kernels are followed in turn; numbers, text, arrays and
tuples count by value; records by their names of fields; all else, such as NumPy's functions, by name. The lanes and
the passes of the compiler, which write the code of all kernels, count as files.
"""

from __future__ import annotations

import hashlib
import types
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numba.core.types import BaseTuple, Optional

FOLDER = Path(__file__).parent
WRITERS = ("kernel.py", "apart.py", "records.py", "unboxing.py", "compiling.py", "linking.py", "lanes/*.py")
"""Files that decide what any kernel becomes."""

Called: TypeAlias = tuple[Callable[..., object], bool]
"""The function of a kernel that is called, and whether it is of a part that may not be there."""


@cache
def of_all() -> bytes:
    """A digest of what the code of every kernel depends on."""
    files = sorted(path for pattern in WRITERS for path in FOLDER.glob(pattern))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).digest()


@cache
def digest(function: Callable[..., object]) -> str:
    """A digest of what the compiled code of a Python function depends on, 16 digits, the types of arguments apart."""
    parts = sorted(_own(each)[0] for each in reached(function))
    return hashlib.sha256(of_all() + b"".join(parts)).hexdigest()[:16]


def reached(function: Callable[..., object], plain: bool = False) -> set[Callable[..., object]]:
    """The functions of a kernel and of all that it calls; of a `plain` one without those of parts that are not there
    (`kernel.OfPart`).
    """
    found, left = {function}, [function]
    while left:
        new = [each for each, of_part in _own(left.pop())[1] if each not in found and not (plain and of_part)]
        found.update(new)
        left += new
    return found


@cache
def _own(function: Callable[..., object]) -> tuple[bytes, tuple[Called, ...]]:
    """A digest of a function without those that it calls, and the functions of these."""
    plain: Any = function
    called: list[Called] = []
    words = [plain.__module__, plain.__qualname__, *_values(plain.__defaults__, called)]
    scope = dict(plain.__globals__)
    scope.update(zip(plain.__code__.co_freevars, (cell.cell_contents for cell in plain.__closure__ or ()), strict=True))
    names: set[str] = set()
    for code in _codes(plain.__code__):
        words += [code.co_code.hex(), repr(code.co_names), repr(code.co_varnames), repr(code.co_freevars)]
        constants = [each for each in code.co_consts if not isinstance(each, types.CodeType)]
        words += [repr(each) for each in constants if each != plain.__doc__]
        names.update(code.co_names, code.co_freevars)
    for name in sorted(names & scope.keys()):
        words += [name, *_reached(scope[name], names, called)]
    return hashlib.sha256("\n".join(words).encode()).digest(), tuple(called)


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """A code with those within it."""
    yield code
    for each in code.co_consts:
        if isinstance(each, types.CodeType):
            yield from _codes(each)


def _reached(value: Any, names: set[str], called: list[Called]) -> Iterator[str]:
    """What a global stands for; of a module its attributes that have one of these names."""
    if isinstance(value, types.ModuleType):
        yield value.__name__
        if value.__name__.split(".")[0] == __name__.split(".")[0]:
            for name in sorted(names & vars(value).keys()):
                yield from _reached(vars(value)[name], names, called)
    else:
        yield from _values(value, called)


def _values(value: Any, called: list[Called]) -> Iterator[str]:
    """Text for a value, the same in every process; functions of kernels are added to `called`."""
    if hasattr(value, "kernels"):  # one for each kind
        for kind, each in value.kernels.items():
            yield record_text(kind)
            yield from _values(each, called)
    elif hasattr(value, "py_func"):  # a kernel, or a function of numba's
        result = getattr(value, "result", ...)
        if result is ...:  # else it is compiled by itself
            called.append((value.py_func, hasattr(value, "absent")))
        yield f"{value.py_func.__module__}.{value.py_func.__qualname__} {result!r} "
        yield f"{getattr(value, 'absent', '')!r} {getattr(value, 'rows', '')!r}"
    elif value is None or isinstance(value, bool | int | float | complex | str | bytes | np.generic):
        yield f"{type(value).__name__} {value!r}"
    elif isinstance(value, tuple | list):
        yield f"{record_text(type(value))} of {len(value)}"
        for each in value:
            yield from _values(each, called)
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    elif isinstance(value, type):
        yield record_text(value)
    else:
        own = type(value)
        name = getattr(value, "__qualname__", getattr(value, "__name__", ""))
        yield f"{own.__module__}.{own.__qualname__} {getattr(value, '__module__', '')}.{name}"


def record_text(kind: type) -> str:
    """The name of a class, with its fields if it is a record."""
    return f"{kind.__module__}.{kind.__qualname__} {getattr(kind, '_fields', '')}"


def types_text(kinds: Any) -> str:
    """Text for numba's types of arguments that names the fields of the records among them, which their own does not."""
    if isinstance(kinds, Optional):
        return types_text(kinds.type)
    if not isinstance(kinds, tuple | BaseTuple):
        return str(kinds)
    parts: Any = kinds  # numba's types of tuples iterate over those of their parts
    within = ", ".join(map(types_text, parts))
    record = getattr(kinds, "instance_class", None)
    return f"({within})" if record is None else f"{record_text(record)} ({within})"
