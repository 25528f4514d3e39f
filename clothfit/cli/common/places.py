"""Files in the wrong place: what they are, and which option or command takes them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from clothfit.base.errors import InvalidInput
from clothfit.formats import registry as kinds

MOVING = (kinds.MOTION, kinds.MESH, kinds.EITHER)
PLACES = {
    "scene_path": (kinds.SCENE,), "scene_paths": (kinds.SCENE,),
    "fitted_path": (kinds.SCENE, kinds.SUBSPACE), "start": (kinds.SCENE,),
    "target_path": MOVING, "target_paths": MOVING, "in_path": MOVING, "given": (kinds.MESH, kinds.EITHER),
    "log_paths": (kinds.LOG,), "subspace_path": (kinds.SCENE, kinds.SUBSPACE, kinds.RECORDED),
    "inputs_path": (kinds.SCENE,),
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
            kind = None if path is None else kinds.kind_of(str(path))
            if kind is not None and kind not in taken:
                article = "an" if kind[0] in "aeiou" else "a"
                raise InvalidInput(f"{path} is {article} {kind}; {advice(kind, command, taken)}")


def advice(kind: str, command: str, taken: tuple[str, ...]) -> str:
    """What to do with a file of that kind where others are taken."""
    if kind in (kinds.MOTION, kinds.EITHER) and kinds.SCENE in taken and command in WITH_TARGET:
        return "did you mean --target?" if kind == kinds.MOTION else "did you mean --target, or clothfit new?"
    if kind == kinds.SCENE and kinds.MESH in taken and kinds.MOTION not in taken:
        return "did you mean clothfit info?"
    resumed = "--checkpoint, with" if command == "estimate" else "clothfit estimate"
    forced = "--forces" if command in WITH_FORCES else "clothfit info, or simulate --forces"
    converted = "did you mean clothfit info, or clothfit convert?"
    known = {
        kinds.SCENE: "did you mean SCENE, or to record its motion with clothfit target?",
        kinds.MOTION: converted if kinds.SCENE in taken else "it has no faces; did you mean estimate --target?",
        kinds.MESH: "did you mean clothfit new?",
        kinds.EITHER: "did you mean clothfit new?",
        kinds.CHECKPOINT: f"did you mean {resumed} --resume?",
        kinds.LOG: "did you mean --log?" if command == "report" else "did you mean clothfit report --log?",
        kinds.MAP: "did you mean --map?",
        kinds.PAGE: "open it in a browser",
        kinds.FORCES: f"did you mean {forced}?",
        kinds.EXPORT: "name the scene that it was made of",
        kinds.SUBSPACE: "did you mean clothfit subspace play, or clothfit evaluate SCENE MODEL?",
        kinds.RECORDED: "did you mean clothfit subspace build?",
    }
    return known[kind]
