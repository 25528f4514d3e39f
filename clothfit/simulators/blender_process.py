"""Blender in a process of its own, which plays one cloth after another."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput

PLAYER = Path(__file__).with_name("blender_player.py")
ANSWER = "clothfit-blender: "  # of the player
VARIABLE = "CLOTHFIT_BPY"
"""Names the program, where no option does."""


def program(given: str | None) -> list[str]:
    """The command that runs the player in Blender: from an option, CLOTHFIT_BPY, or `blender` of the path. Raises
    InvalidInput where there is none.
    """
    named = given or os.environ.get(VARIABLE) or shutil.which("blender")
    if not named or not shutil.which(named):
        what = f"{named}: no such program" if named else "Blender is not here"
        raise InvalidInput(
            f"{what}; name it by --blender, or {VARIABLE}: the program blender, or a Python with Blender as a module "
            "(pip install bpy==4.2.23 'numpy<2' in an environment of its own)"
        )
    if "python" in Path(named).name.lower():
        return [named, str(PLAYER)]
    return [named, "--background", "--factory-startup", "--python-exit-code", "9", "--python", str(PLAYER)]


class Blender:
    """A running Blender; `with Blender(command) as blender`. Raises InvalidInput where it does not start."""

    def __init__(self, command: list[str]) -> None:
        self.folder = tempfile.TemporaryDirectory(prefix="clothfit-blender-")
        self.name = command[0]
        self.log: IO[str] = open(Path(self.folder.name) / "log", "w+", encoding="utf-8")  # noqa: SIM115
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.log, text=True, encoding="utf-8"
        )
        self.version = str(self.answer().get("version"))

    def __enter__(self) -> Blender:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End it."""
        if self.process.stdin:
            self.process.stdin.close()
        try:
            self.process.wait(5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        if self.process.stdout:
            self.process.stdout.close()
        self.log.close()
        self.folder.cleanup()

    def answer(self) -> dict[str, Any]:
        """The next answer; what else Blender prints is passed over. Raises InvalidInput where it has ended."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.startswith(ANSWER):
                found: dict[str, Any] = json.loads(line.removeprefix(ANSWER))
                if "fault" in found:
                    raise InvalidInput(f"blender: {found['fault']}")
                return found
        self.log.seek(0)
        words = self.log.read().strip().splitlines()[-1:] or ["it ended"]
        raise InvalidInput(f"{self.name}: does not play cloths: {words[0]}")

    def play(self, job: dict[str, Any]) -> Array:
        """The positions (frames, n, 3) of a job (see the player), in Blender's axes."""
        assert self.process.stdin is not None
        out = Path(self.folder.name) / "motion.npy"
        try:
            self.process.stdin.write(json.dumps({**job, "out": str(out)}) + "\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # its answer says why
        found: Array = np.load(self.answer()["done"])
        return found

    def file(self, name: str, data: bytes) -> str:
        """Write a file for it; returns its path."""
        path = Path(self.folder.name) / name
        path.write_bytes(data)
        return str(path)
