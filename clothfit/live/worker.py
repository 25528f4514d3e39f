"""A process that does one task, so that what is played meanwhile does not wait: started by `task`, which it talks with
in pickles over its standard input and output.

It gets one task, then perhaps the word "cancel", which ends a fit as Ctrl-C would: with the best so far. When its
input ends, so does it.
"""

from __future__ import annotations

import io
import os
import pickle
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from clothfit.base import interrupts
from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.live import wire
from clothfit.scene.scene import Scene
from clothfit.scene.scene import load as load_scene

# ---- A scene that is loaded: read, checked and tried in a process of its own.
#
# A scene may come from anybody, and each kind of scene needs code of its own, whose compilation takes a minute and
# leaves a hundred megabytes behind that are never freed. So this process parses the text, and takes the first steps,
# which leaves compiled code on disk; the server gets the finished scene, and loads code that is small.

FIELDS = ("scene", "name")
MOST_NAME = 200

Send = Callable[..., None]


def load(send: Send, message: Mapping[str, Any] | str, folder: str) -> None:
    """Read the scene of a message `load`, or of its text, with paths relative to a folder. Tells "id" with the
    message's, then "done" with the scene. Raises InvalidInput or InvalidScene.
    """
    own = wire.parsed(message, wire.LARGEST) if isinstance(message, str) else message
    send("id", id=own.get("id"))
    check_load(own)
    made = read_scene_of(own, folder)
    rehearse(pickle.loads(pickle.dumps(made)))  # as it arrives: code depends on whether arrays may be written to
    send("done", scene=made)


def check_load(message: Mapping[str, Any]) -> None:
    """Raise InvalidInput for what is no message to load a scene."""
    if message["type"] != "load":
        raise InvalidInput(wire.TOO_LARGE)
    wire.check_fields(message, FIELDS)
    if not isinstance(message.get("scene"), (dict, str)):
        raise InvalidInput("load: `scene` is needed, the JSON of a scene or its text")


def read_scene_of(message: Mapping[str, Any], folder: str) -> Any:
    """The scene of a message."""
    given, name = message["scene"], message.get("name")
    made = load_scene(given if isinstance(given, dict) else io.StringIO(given), folder=folder)
    return replace(made, name=name[:MOST_NAME]) if isinstance(name, str) and name else made


def rehearse(scene: Any) -> None:
    """Do once all that an engine does with a scene, so that its code is on disk."""
    from clothfit.engine.system import BDF2, IMPLICIT
    from clothfit.live.engine import diverged
    from clothfit.live.moving import Grip, Moving

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


# ---- What a process searches for: a recorded target, the values of a fit, forces through keys. Each function tells
# what it finds by `tell(kind, **content)`, at the end with "done".

OFTEN = 0.05
"""Seconds between two reports, at least."""


def values_of(scene: Scene) -> dict[str, Any]:
    """What a fit may find, as `Scene.with_values` takes it."""
    kinds = "mass", "stiffness", "rest", "velocity", "damping", "drag"
    own = {name: [getattr(cloth, name) for cloth in scene.cloths] for name in kinds}
    shared = {name: np.array(getattr(scene, name)) for name in ("wind", "gravity", "friction", "contact")}
    return {"masses": own.pop("mass"), "stiffnesses": own.pop("stiffness"), **own, **shared}


def record(send: Send, scene: Scene) -> None:
    """Record the motion of a scene's own values, as a target."""
    from clothfit.fit.estimate import record_target

    send("done", motion=record_target(scene))


def estimate(send: Send, scene: Scene, target: Any, budget: float | None) -> None:
    """Fit what a scene flags to a target, from the scene's values."""
    from clothfit.fit import estimate as fits
    from clothfit.fit.observer import Observer
    from clothfit.fit.options import FitOptions

    class Report(Observer):
        last, shown = 0.0, np.inf

        def progress(self, progress: Any) -> None:
            now, values = time.monotonic(), None
            if progress.best is not None and progress.cost < self.shown:
                self.shown, values = progress.cost, values_of(progress.best())
            elif now < self.last + OFTEN:
                return
            self.last = now
            numbers = {name: finite(getattr(progress, name)) for name in ("cost", "rmse", "seconds")}
            names = ("evaluations", "iteration", "stage", "window", "frames")
            counts = {name: getattr(progress, name) for name in names}
            send("progress", figures={**numbers, **counts}, values=values)

    fit = fits.estimate(scene, target, time_limit=budget, options=FitOptions(keep_step=True), observer=Report())
    summary = {
        "status": str(fit.status), "cost": finite(fit.cost), "rmse": finite(fit.rmse),
        "evaluations": fit.evaluations, "seconds": finite(fit.seconds),
    }  # fmt: skip
    send("done", summary=summary, values=values_of(fit.scene))


def control(send: Send, scene: Scene, keys: str, budget: float | None) -> None:
    """Find the forces that take a scene through keys, JSON as in a file."""
    from clothfit.control.control import find_forces
    from clothfit.control.keyframes import from_json

    found = find_forces(scene, from_json(keys, "keys", scene), budget=budget)
    summary = {
        "status": str(found.status), "effort": finite(found.effort), "evaluations": found.evaluations,
        "seconds": finite(found.seconds), "keys": [{"time": key.time, "rmse": finite(key.rmse)} for key in found.keys],
    }  # fmt: skip
    send("done", summary=summary, forces=found.forces)


def finite(value: float) -> float | None:
    """A number as JSON has it."""
    return float(value) if np.isfinite(value) else None


TASKS: dict[str, Callable[..., None]] = {"record": record, "estimate": estimate, "control": control, "load": load}


def listen(source: Any) -> None:
    """Hear what else is asked for, in a thread."""
    while True:
        try:
            word = pickle.load(source)
        except (EOFError, OSError, pickle.UnpicklingError):
            os._exit(0)  # whoever asked is gone
        if word == "cancel":
            interrupts.request()


def main() -> None:
    """Do one task."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what others print is no message
    lock = threading.Lock()

    def send(kind: str, **content: Any) -> None:
        with lock:
            pickle.dump((kind, content), out)
            out.flush()

    name, arguments = pickle.load(sys.stdin.buffer)
    threading.Thread(target=listen, args=[sys.stdin.buffer], daemon=True).start()
    try:
        with interrupts.deferred():
            TASKS[name](send, **arguments)
    except ClothfitError as error:
        send("failed", reason=str(error), code=error.exit_code, invalid=isinstance(error, InvalidInput))
    except KeyboardInterrupt:
        send("cancelled")
    except MemoryError:
        send("failed", reason=f"{name}: there is not enough memory", code=1, invalid=False)


if __name__ == "__main__":
    main()
