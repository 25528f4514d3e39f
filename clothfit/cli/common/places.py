"""Files in the wrong place: what they are, and which option or command takes them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from clothfit.base.errors import InvalidInput
from clothfit.formats.registry import (
    CHECKPOINT,
    EITHER,
    EXPORT,
    FORCES,
    LOG,
    MAP,
    MESH,
    MOTION,
    PAGE,
    RECORDED,
    SCENE,
    SUBSPACE,
    kind_of,
)

PLACES = {
    "scene_path": (SCENE,), "scene_paths": (SCENE,), "fitted_path": (SCENE, SUBSPACE), "start": (SCENE,),
    "target_path": (MOTION, MESH, EITHER), "target_paths": (MOTION, MESH, EITHER), "in_path": (MOTION, MESH, EITHER),
    "given": (MESH, EITHER), "log_paths": (LOG,), "subspace_path": (SCENE, SUBSPACE, RECORDED), "inputs_path": (SCENE,),
}  # fmt: skip
"""Parameters of commands that are files to read, and the kinds that they take."""

WITH_FORCES = ("simulate", "target", "estimate", "evaluate", "report", "check")
WITH_TARGET = ("estimate", "evaluate", "report", "check")
ANY = ("info", "completion", "warmup")  # commands that take any file, or none


def check_places(command: str, arguments: Mapping[str, Any]) -> None:
    """Raise InvalidInput at the first file that is recognised as something else than its place takes."""
    if command in ANY:
        return
    for name, taken in PLACES.items():
        value = arguments.get(name)
        paths = value if isinstance(value, tuple) else (value,)
        if command == "validate" and len(paths) > 1:
            continue  # each gets a line of its own
        for path in paths:
            kind = None if path is None else kind_of(str(path))
            if kind is not None and kind not in taken:
                article = "an" if kind[0] in "aeiou" else "a"
                raise InvalidInput(f"{path} is {article} {kind}; {advice(kind, command, taken)}")


def advice(kind: str, command: str, taken: tuple[str, ...]) -> str:
    """What to do with a file of that kind where others are taken."""
    if kind in (MOTION, EITHER) and SCENE in taken and command in WITH_TARGET:
        return "did you mean --target?" if kind == MOTION else "did you mean --target, or clothfit new?"
    if kind == SCENE and MESH in taken and MOTION not in taken:
        return "did you mean clothfit info?"
    known = {
        SCENE: "did you mean SCENE, or to record its motion with clothfit target?",
        MOTION: "did you mean clothfit info, or clothfit convert?" if SCENE in taken else "it has no faces; did you "
        "mean estimate --target?",
        MESH: "did you mean clothfit new?",
        EITHER: "did you mean clothfit new?",
        CHECKPOINT: "did you mean --checkpoint, with --resume?" if command == "estimate" else "did you mean clothfit "
        "estimate --resume?",
        LOG: "did you mean --log?" if command == "report" else "did you mean clothfit report --log?",
        MAP: "did you mean --map?",
        PAGE: "open it in a browser",
        FORCES: f"did you mean {'--forces' if command in WITH_FORCES else 'clothfit info, or simulate --forces'}?",
        EXPORT: "name the scene that it was made of",
        SUBSPACE: "did you mean clothfit subspace play, or clothfit evaluate SCENE MODEL?",
        RECORDED: "did you mean clothfit subspace build?",
    }
    return known[kind]
