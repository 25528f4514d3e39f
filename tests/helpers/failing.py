"""Commands that fail, as data: what `failing_commands` and `failing_files` list and `test_errors` runs.

A command runs in a folder with `scene.json` (4 × 4 vertices, one mass to fit, 5 frames), `good.npz` (its motion) and
the files of its case. A message is a template: `…` stands for what varies.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from helpers.paths import DOCS
from helpers.scenes import changed, trial

VERTICES, SPRINGS = 16, 33
SMALL = trial("nG", 5)
GOOD = {"positions": np.zeros((5, VERTICES, 3)), "times": 0.02 * np.arange(5)}


@dataclass(frozen=True)
class Case:
    """A command, the files around it (bytes, documents, or arrays of motions, by name) and its exit code."""

    arguments: str
    files: Mapping[str, Any] = field(default_factory=dict)
    prepare: Callable[[Any], object] = lambda patch: None  # is given pytest's monkeypatch
    code: int = 3

    def fill(self, folder: Path) -> None:
        """Write the files."""
        for name, content in {"scene.json": SMALL, "good.npz": GOOD, **self.files}.items():
            path = folder / name
            path.parent.mkdir(exist_ok=True)
            if isinstance(content, bytes):
                path.write_bytes(content)
            elif name.endswith(".npz"):
                np.savez(path, **content)
            else:
                path.write_text(json.dumps(content), encoding="utf-8")


def ending(code: int, case: Case | str) -> Case:
    """A case, or a command without files, with another exit code."""
    return replace(case if isinstance(case, Case) else Case(case), code=code)


def scene(path: tuple[str | int, ...], value: Any) -> Case:
    """A simulation of the scene with another value at a path."""
    return Case("simulate scene.json", {"scene.json": changed(SMALL, path, value)})


def own(name: str, *rest: Any) -> Case:
    """The same with a path in the object: name, further steps, value."""
    return scene(("objects", 0, name, *rest[:-1]), rest[-1])


def text(data: bytes) -> Case:
    """A scene of that text."""
    return Case("simulate scene.json", {"scene.json": data})


def motion(**arrays: Any) -> Case:
    """A fit to a motion with other arrays; None takes one away."""
    made = {name: array for name, array in {**GOOD, **arrays}.items() if array is not None}
    return Case("estimate scene.json --target bad.npz", {"bad.npz": made})


def fit(options: str = "", of: Any = SMALL, **files: Any) -> Case:
    """A fit with options."""
    return Case(f"estimate scene.json {options}", {"scene.json": of, **files})


def patched(case: Case | str, name: str, value: Any) -> Case:
    """A case in which something of the program, or of the system, is replaced."""
    case = case if isinstance(case, Case) else Case(case)
    return replace(case, prepare=lambda patch: patch.setattr(name, value))


def raising(error: BaseException) -> Callable[..., Any]:
    """A function that fails."""

    def function(*_: Any, **__: Any) -> Any:
        raise error

    return function


class Row(NamedTuple):
    """A message in docs/errors.md."""

    message: str
    code: int
    remedy: str


def rows() -> list[Row]:
    """The messages of the page."""
    found = re.findall(r"^\| `(.+?)` \| (\d+) \| (.+) \|$", (DOCS / "errors.md").read_text("utf-8"), re.MULTILINE)
    return [Row(message, int(code), remedy) for message, code, remedy in found]


def pattern(message: str) -> re.Pattern[str]:
    """What matches a message with anything in its gaps."""
    return re.compile(".*".join(map(re.escape, message.split("…"))), re.DOTALL)
