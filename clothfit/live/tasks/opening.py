"""A scene that is loaded: read, checked and tried in a process of its own.

A scene may come from anybody, and each kind of scene needs code of its own, whose compilation takes a minute and leaves
a hundred megabytes behind that are never freed. So this process parses the text, and takes the first steps, which
leaves compiled code on disk; the server gets the finished scene, and loads code that is small.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable, Mapping
from typing import Any

from clothfit.base.errors import InvalidInput
from clothfit.live import wire

FIELDS = ("scene", "name")
MOST_NAME = 200

Tell = Callable[..., None]


def load(tell: Tell, message: Mapping[str, Any] | str, folder: str) -> None:
    """Read the scene of a message `load`, or of its text, with paths relative to a folder. Tells "id" with the
    message's, then "done" with the scene. Raises InvalidInput or InvalidScene.
    """
    own = wire.parsed(message, wire.LARGEST) if isinstance(message, str) else message
    tell("id", id=own.get("id"))
    check(own)
    made = read(own, folder)
    rehearse(pickle.loads(pickle.dumps(made)))  # as it arrives: code depends on whether arrays may be written to
    tell("done", scene=made)


def check(message: Mapping[str, Any]) -> None:
    """Raise InvalidInput for what is no message to load a scene."""
    if message["type"] != "load":
        raise InvalidInput(wire.TOO_LARGE)
    wire.check_fields(message, FIELDS)
    if not isinstance(message.get("scene"), (dict, str)):
        raise InvalidInput("load: `scene` is needed, the JSON of a scene or its text")


def read(message: Mapping[str, Any], folder: str) -> Any:
    """The scene of a message."""
    from dataclasses import replace

    from clothfit.scene.scene import load as load_scene

    given, name = message["scene"], message.get("name")
    made = load_scene(given if isinstance(given, dict) else io.StringIO(given), folder=folder)
    return replace(made, name=name[:MOST_NAME]) if isinstance(name, str) and name else made


def rehearse(scene: Any) -> None:
    """Do once all that an engine does with a scene, so that its code is on disk."""
    from dataclasses import replace

    from clothfit.engine.system import BDF2, IMPLICIT
    from clothfit.live.moving import Grip, Moving
    from clothfit.live.stepper import diverged

    if scene.self_contact and scene.method == BDF2:  # steps in which it touches itself are implicit ones
        rehearse(replace(scene, method=IMPLICIT))
    for index in range(len(scene.cloths)):
        cloth = Moving(scene, index)
        for _ in range(2):
            if not cloth.advance():
                diverged(cloth)  # the engine will say so, and a slider may mend it
                break
        cloth.pull(Grip(0, cloth.x[0]))
        cloth.retune(scene)
