"""The few values of Blender's cloth, and Blender itself in the loop, in a process of its own: what it does with them is
what Blender does.

The values are those that the export maps, as factors on the ranges of stiffness, dampings and the mass of a vertex. The
motion is played at a frame rate that the scene's steps fit, about 50 a second; a motion of another clock is compared at
Blender's frames.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import IO, Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.export import blender as mapping
from clothfit.formats.axes import Axes, facing, from_scene, to_scene
from clothfit.scene.scene import Scene
from clothfit.simulators.values import Tool, Value
from clothfit.simulators.xpbd import refuse

AXES = Axes("z", "right", 1.0)
RATE = 50.0
"""Frames per second that are aimed at."""

LEAST = 1e-4
"""Dampings that the mapping leaves at 0 start here."""

SIMILAR = 0.02
"""Of a logarithm, for differences: below, the accuracy of Blender's solver, a hundredth, shows."""

PLAYER = Path(__file__).with_name("blender_player.py")
ANSWER = "clothfit-blender: "  # of the player
VARIABLE = "CLOTHFIT_BPY"
"""Names the program, where no option does."""


def stride(scene: Scene) -> int:
    """How many steps of the scene there are in a frame of Blender's."""
    return max(1, round(1.0 / (RATE * scene.delta)))


def tool_of(scene: Scene, index: int, frames: int, blender: Blender) -> Tool:
    """Blender for one cloth, over so many of its frames. Raises InvalidInput, InvalidScene."""
    refuse(scene, "blender")
    own = scene.cloths[index]
    if own.pins or scene.changes:
        raise InvalidInput(f"{scene.name}: the model of blender has no pins that move, and no inputs over time")
    base = mapping.one(index, own, *mapping.steps_of(scene))
    mesh = io.BytesIO()
    np.savez(mesh, positions=from_scene(own.positions, AXES), triangles=facing(own.triangles, AXES))
    job = {
        "mesh": blender.file(f"mesh{index}.npz", mesh.getvalue()),
        "script": blender.file(f"script{index}.py", mapping.files(scene)["blender.py"]),
        "fps": 1.0 / (stride(scene) * scene.delta),
        "frames": frames,
    }
    values = values_of(base)
    names = [value.name for value in values]

    def motion(numbers: Array) -> Array | None:
        positions = blender.play({**job, "values": with_values(base, names, numbers)})
        return to_scene(positions, AXES) if np.isfinite(positions).all() else None

    return Tool("blender", tuple(values), motion, None, SIMILAR)


def left_out(scene: Scene) -> list[str]:
    """What of a scene the export to Blender does not have, in words."""
    there = {
        "the wind": bool(scene.wind.any()) and any(cloth.feels_air for cloth in scene.cloths),
        "the drag of the air": any(cloth.feels_air for cloth in scene.cloths),
        "the spheres": bool(scene.spheres),
    }
    return [words for words, found in there.items() if found]


def values_of(base: dict[str, Any]) -> list[Value]:
    """The values of an object that may change."""
    found = []
    if base["structural"]:
        found += [Value(name, "times the mapped one", 1.0, 1.0) for name in ("tension", "compression")]
        damping = float(base["spring_damping"])
        found += [Value(f"{name} damping", "", max(damping, LEAST), damping) for name in ("tension", "compression")]
    if base["bending"] and base["bending"]["stiffness_max"] > 0:
        found.append(Value("bending", "times the mapped one", 1.0, 1.0))
    air, mass = float(base["air_damping"]), float(base["mass"])
    return [*found, Value("air damping", "", max(air, LEAST), air), Value("mass", "kg", mass, mass)]


def with_values(base: dict[str, Any], names: list[str], numbers: Array) -> dict[str, Any]:
    """The values of an object for the script, with other numbers."""
    found: dict[str, Any] = json.loads(json.dumps(base))
    new = dict(zip(names, map(float, numbers), strict=True))
    found["mass"], found["air_damping"] = new["mass"], min(new["air damping"], mapping.MOST_AIR)
    if "bending" in new:
        scale(found["bending"], new["bending"])
    for kind in ("tension", "compression"):
        if kind in new:
            found[kind] = scale(dict(base["structural"]), new[kind])
            found[f"{kind}_damping"] = min(new[f"{kind} damping"], mapping.MOST_DAMPING)
    return found


def scale(group: dict[str, Any], factor: float) -> dict[str, Any]:
    """Multiply a range of stiffness, up to Blender's limit; returns it without its weights."""
    for name in ("stiffness", "stiffness_max"):
        group[name] = min(group[name] * factor, mapping.LARGEST_STIFFNESS)
    return {name: group[name] for name in ("stiffness", "stiffness_max")}


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

    def __exit__(self, *fault: object) -> None:
        try:
            self.process.communicate(timeout=5)  # there are no more jobs
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()
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
