"""Small valid scenes for tests, and what `load` says of broken ones."""

import copy
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import clothfit.scene.scene
from clothfit.base.errors import InvalidScene

MISSING = object()  # as the new value of a field: take it away


def cloth(nx: int = 4, ny: int = 3, size: float = 1.0, **fields: Any) -> dict[str, Any]:
    """A flat object of nx by ny vertices, `size` m apart, a spring per edge of its triangles, two corners fixed."""
    index = [[nx * j + i for i in range(nx)] for j in range(ny)]
    triangles: list[tuple[int, int, int]] = []
    for j in range(ny - 1):
        for i in range(nx - 1):
            a, b, c, d = index[j][i], index[j + 1][i], index[j + 1][i + 1], index[j][i + 1]
            triangles += [(a, b, c), (a, c, d)]
    edges = sorted({tuple(sorted(pair)) for a, b, c in triangles for pair in ((a, b), (b, c), (a, c))})
    n = nx * ny
    made = {
        "vertPos": [{"x": i * size, "y": 0.0, "z": j * size} for j in range(ny) for i in range(nx)],
        "vertIsFixed": [i in (0, nx - 1) for i in range(n)],
        "vertMass": [0.01 + 0.001 * i for i in range(n)],
        "springs": [vertex for edge in edges for vertex in edge],
        "springStiffness": [25.0 + s for s in range(len(edges))],
        "triangles": [vertex for triangle in triangles for vertex in triangle],
        "dragCoefficient": 0.1,
        "damping": 0.1,
        "optimizationSettings": "nn",
    }
    return {**made, **fields}


def sphere(radius: float = 0.5, **fields: Any) -> dict[str, Any]:
    """A sphere at the origin."""
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    scale = {"x": 2 * radius, "y": 2 * radius, "z": 2 * radius}
    return {"type": 1, "pos": zero, "rot": dict(zero), "scale": scale, **fields}


def document(*objects: dict[str, Any], **fields: Any) -> dict[str, Any]:
    """A scene of the given objects (default: one cloth), every field of the format present."""
    made = {
        "title": "test",
        "integrationMethod": 2,
        "delta": 0.02,
        "tolerance": 1e-5,
        "optimizationIterations": 100,
        "forwardSubSteps": 1,
        "printTimes": False,
        "windVel": {"x": 0.0, "y": 0.0, "z": 0.0},
        "objects": list(objects) or [cloth()],
        "colliders": [],
    }
    return {**made, **fields}


def changed(original: Any, path: tuple[str | int, ...], value: Any) -> Any:
    """A copy of a document with another value at a path; MISSING takes the field away."""
    made = copy.deepcopy(original)
    owner = made
    for step in path[:-1]:
        owner = owner[step]
    if value is MISSING:
        del owner[path[-1]]
    else:
        owner[path[-1]] = value
    return made


def kind(path: tuple[str | int, ...], value: Any) -> str:
    """A short name for a changed value, for the list of tests."""
    shown = "missing" if value is MISSING else str(value)[:20]
    return f"{'.'.join(map(str, path))} {shown}"


def load_text(text: str | bytes) -> clothfit.scene.scene.Scene:
    """Load a scene from its text."""
    return clothfit.scene.scene.load(io.StringIO(text) if isinstance(text, str) else io.BytesIO(text))


def problems(scene: dict[str, Any] | str | bytes) -> list[str]:
    """What `load` finds wrong with a document or a text."""
    with pytest.raises(InvalidScene) as caught:
        load_text(scene if isinstance(scene, (str, bytes)) else json.dumps(scene))
    return caught.value.problems


def trial(settings: str, frames: int = 20, nx: int = 4, ny: int = 4, **fields: Any) -> dict[str, Any]:
    """A document to fit: one cloth with those settings; fields of an object go to it, all others to the scene."""
    own = {name: fields.pop(name) for name in list(fields) if name in (*cloth(2, 2), "note")}
    return document(cloth(nx, ny, optimizationSettings=settings, **own), optimizationIterations=frames, **fields)


def even(settings: str, frames: int = 20, nx: int = 4, ny: int = 4, **fields: Any) -> dict[str, Any]:
    """The same with one mass and one stiffness all over, so that settings with G can reach the truth."""
    n, springs = nx * ny, len(cloth(nx, ny)["springStiffness"])
    values = {"vertMass": [0.02] * n, "springStiffness": [30.0] * springs}
    return trial(settings, frames, nx, ny, **{**values, **fields})


def names(place: str = ".") -> list[str]:
    """What is in a folder."""
    return sorted(os.listdir(place))


def write_scene(folder: Path, scene: dict[str, Any], name: str = "scene.json", **layout: Any) -> str:
    """Write a document to a file; `layout` goes to json.dumps. Returns the path."""
    path = folder / name
    path.write_text(json.dumps(scene, **layout), encoding="utf-8")
    return str(path)


def environment(**changes: str) -> dict[str, str]:
    """What a command is started with: this checkout first on the path, no wishes about colour. One with a folder of its
    own for compiled code finds none of the user's, nor any that is kept among temporary files.
    """
    if "NUMBA_CACHE_DIR" in changes:
        beside = os.path.dirname(changes["NUMBA_CACHE_DIR"])
        changes = {"XDG_CACHE_HOME": os.path.join(beside, "none"), "TMPDIR": beside, **changes}
    root = str(Path(clothfit.__file__).resolve().parents[1])
    kept = {key: value for key, value in os.environ.items() if key not in ("NO_COLOR", "CLOTHFIT_TRACEBACK")}
    return {**kept, "PYTHONPATH": root, **changes}


def started(*arguments: str, **keywords: Any) -> subprocess.CompletedProcess[bytes]:
    """Run `clothfit` as a process of its own and wait for it; both streams are kept unless redirected."""
    command = [sys.executable, "-m", "clothfit", *arguments]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "timeout": 50, "env": environment()}
    return subprocess.run(command, **{**streams, **keywords}, check=False)


needs_full_disk = pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")


def tokens(text: str) -> list[str]:
    """The tokens of a JSON text, white space included."""
    return re.findall(r'"(?:[^"\\]|\\.)*"|[\[\]{}:,]|\s+|[^\s\[\]{}:,"]+', text)

