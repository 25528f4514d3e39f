"""One scene that is played, tuned and fitted: its state, and what all who watch are told. One thread at a time uses it.

The scene that moves is a base, as it was loaded or fitted, with factors on its masses and stiffnesses and with other
values beside; the history goes back through all three. The target is a motion that was given, or that of the scene as
it was loaded. `commands` has what each message does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from clothfit.base import memory
from clothfit.base.errors import InvalidInput
from clothfit.base.version import __version__
from clothfit.live import changes, wire
from clothfit.live.changes import History, UndoState
from clothfit.live.engine import Engine
from clothfit.live.task import Loading, Task
from clothfit.motion.motion import Motion
from clothfit.report.contents import mesh, surroundings
from clothfit.scene.scene import Scene, dumps

LARGEST_TARGET = 16 << 20
"""Bytes of a target that is shown; of a longer one every second frame, or fewer."""

PAUSE = 0.5
"""Seconds that a motion goes on after its target has ended, before it begins again."""

SOON = 0.05
"""Seconds that an answer waits for the first frame after a return to the start, which may have to be compiled for."""

MOST_FRAMES = 2000
"""Frames for which the page knows where obstacles are that move."""

Send = Callable[[Any], None]
"""Sends a message to all who watch: a dict as text, bytes as they are."""


class Session:
    """What is behind a page. `send` is called with what all who watch should know, from several threads."""

    def __init__(
        self, scene: Scene, send: Send, on_frame: Callable[[], None], target: Motion | None = None,
        later: Callable[[Callable[[], None]], None] | None = None,
    ) -> None:  # fmt: skip
        """`later` takes what a task's thread wants to be done in the thread of the messages."""
        self.send, self._later, self._noted = send, later or (lambda act: act()), on_frame
        self.generation, self.loop = 0, True
        self.task: Task | None = None
        self.loading: Loading | None = None
        self.engine = Engine(scene, on_frame=on_frame)
        self._begin(scene, target)

    def _begin(self, scene: Scene, target: Motion | None) -> None:
        """Begin with a scene."""
        self.base = scene
        self.factors: changes.Factors = {}
        self.history = History()
        self.target = target
        self.outcome: dict[str, Any] | None = None
        if target is None:
            self.start_task("record", scene=scene)

    @property
    def scene(self) -> Scene:
        """The scene that moves, with its values of now."""
        return self.engine.scene

    # ---- what all see

    def status(self) -> dict[str, Any]:
        """How things stand."""
        engine = self.engine
        busy = "load" if self.loading is not None else None if self.task is None else self.task.name
        return {"status": {
            "running": engine.running, "frame": engine.frame, "time": engine.shared().time,
            "speed": engine.speed, "loop": self.loop, "error": None if engine.error is None else str(engine.error),
            "busy": busy, "undo": len(self.history), "generation": self.generation,
            "target": self.target is not None, "outcome": self.outcome,
        }}  # fmt: skip

    def scenery(self, generation: int | None = None) -> dict[str, Any]:
        """The scene as a page draws it."""
        named = self.generation if generation is None else generation
        return {"type": "scene", **described(self.scene, named), **self.values()}

    def values(self) -> dict[str, Any]:
        """The values that sliders show."""
        scene = self.scene
        return {"values": {
            "damping": [cloth.damping for cloth in scene.cloths], "drag": [cloth.drag for cloth in scene.cloths],
            "wind": scene.wind.tolist(), "gravity": scene.gravity.tolist(),
            "factors": changes.listed(self.base, self.factors),
        }}  # fmt: skip

    def target_packet(self) -> bytes | None:
        """The target as a binary message, where there is one."""
        if self.target is None:
            return None
        x, times = self.target.positions, self.target.times
        every = 1 + x.nbytes // (2 * LARGEST_TARGET)
        step = float(times[1] - times[0]) * every if len(times) > 1 else self.scene.delta
        return wire.packed(wire.TARGET, self.generation, len(x[::every]), step, x[::every])

    def frame_packet(self) -> bytes | None:
        """The last frame as a binary message; None while a scene that was loaded has none yet."""
        frame = self.engine.shared()
        if frame.mark != self.generation:
            return None
        return wire.packed(wire.FRAME, frame.mark, frame.number, frame.time, frame.positions)

    def text(self) -> bytes:
        """The scene as a file: the one that was loaded, but for the values that differ."""
        return dumps(self.scene)

    def text_now(self) -> str:
        """The same as text, without a byte order mark."""
        source = self.scene.source
        return self.text().removeprefix(source.mark).decode(source.encoding)

    def send_status(self) -> dict[str, Any]:
        """The status, which all get."""
        status = self.status()
        self.send({"type": "status", **status})
        return status

    def send_values(self) -> dict[str, Any]:
        """The values and the status, which all get."""
        values = self.values()
        self.send({"type": "values", **values})
        return values | self.send_status()

    def undo_state(self) -> UndoState:
        """What `undo` goes back to, if something changes now."""
        return UndoState(self.scene, self.base, self.factors)

    def close(self) -> None:
        """End the thread and the processes."""
        if self.loading is not None:
            self.end_loading(self.loading.refused("the server ends"))
        if self.task is not None:
            self.task.kill()
        self.engine.stop()

    # ---- another scene

    def open(self, head: dict[str, Any], message: Mapping[str, Any] | str) -> Loading:
        """Let a process read the scene of a message, or of its text; what moves goes on meanwhile."""
        self.free()

        def heard(loading: Loading, kind: str, content: dict[str, Any]) -> None:
            self._later(lambda: self._hear_loading(loading, kind, content))

        self.loading = Loading(head, heard, message=message, folder=self.scene.folder)
        self.send_status()
        return self.loading

    def _hear_loading(self, loading: Loading, kind: str, content: dict[str, Any]) -> None:
        """Take what the process says that reads a scene, unless it was given up."""
        if loading is not self.loading:
            return
        if kind == "id":
            loading.head |= {} if content["id"] is None else content
        elif kind == "done":
            self._open(content["scene"])
            self.end_loading(loading.done(self.status()))
        else:
            self.end_loading(loading.refused(content.get("reason", "the load was cancelled")))

    def _open(self, scene: Scene) -> None:
        """Go on with another scene, whose frames are sent from now on."""
        mark = self.generation + 1
        self.engine.reset(scene, mark)
        self._begin(scene, None)
        self.send(self.scenery(mark))
        self.generation = mark
        self.engine.wait(SOON)
        self._noted()

    def end_loading(self, answer: dict[str, Any]) -> None:
        """Be done with a scene that was being read; a failure is told to all if its sender has been answered."""
        loading, self.loading = self.loading, None
        assert loading is not None
        if loading.answered and answer["type"] == "refused":
            self.send({"type": "ended", "of": "load", "status": "failed", "reason": answer["reason"]})
        status = self.send_status()
        loading.end(answer | (status if answer["type"] == "done" else {}))
        memory.give_back()

    def still_loading(self, loading: Loading) -> dict[str, Any] | None:
        """The answer to a sender who has waited long; None where there is another by now."""
        if loading.answer.done():
            return None
        loading.answered = True
        return loading.done(self.status())

    # ---- long work beside what is played

    def check_not_loading(self) -> None:
        """Raise InvalidInput while another scene is being loaded."""
        if self.loading is not None:
            raise InvalidInput("a scene is being loaded; wait until it is there, or cancel it")

    def free(self) -> None:
        """Raise InvalidInput while something is computed; a record of the target gives way."""
        self.check_not_loading()
        if self.task is not None and self.task.name != "record":
            raise InvalidInput(f"{self.task.name} is running; cancel it first")

    def start_task(self, name: str, **arguments: Any) -> None:
        """Start a task."""
        self.outcome = None
        if self.task is not None:
            self.task.kill()

        def heard(kind: str, content: dict[str, Any]) -> None:
            self._later(lambda: self._hear(task, kind, content))

        task = Task(name, heard, **arguments)
        self.task = task

    def _hear(self, task: Task, kind: str, content: dict[str, Any]) -> None:
        """Take what a task says; one that another has taken the place of is not heard."""
        if task is not self.task:
            return
        if content.get("values") is not None:
            self.engine.use(self.scene.with_values(**content["values"]))
            self.base, self.factors = self.scene, {}  # the base of later factors
            self.send({"type": "values", **self.values()})
        if kind == "progress":
            self.send({"type": "progress", "of": task.name, **content["figures"]})
            return
        self.task = None
        if kind == "done" and "motion" in content:
            self.target = content["motion"]
            self.send(self.target_packet())
        if "forces" in content:
            self.engine.reset(self.scene.with_forces(content["forces"]))
            self.engine.start()
        if task.name != "record" or kind == "failed":
            own = content.get("summary") or {"status": "failed" if kind == "failed" else "cancelled"}
            self.outcome = {"of": task.name, "reason": content.get("reason"), **own}
            self.send({"type": "ended", **self.outcome})
        self.send_status()

    def again(self) -> None:
        """Go back to the start where the target has ended, if that is wanted."""
        frame, target = self.engine.shared(), self.target
        if frame.mark != self.generation or target is None or not (self.loop and self.engine.running):
            return
        if frame.time > target.times[-1] + PAUSE:
            self.engine.reset()


def described(scene: Scene, generation: int) -> dict[str, Any]:
    """The scene: names, mesh, surroundings, and what the file asks to fit."""
    frames = min(scene.frames, MOST_FRAMES) if scene.moves else 2
    times = scene.delta * np.arange(frames, dtype=float)
    start = np.concatenate([cloth.positions for cloth in scene.cloths])
    modes = {name: [cloth.mode(name) for cloth in scene.cloths] for name in ("mass", "stiffness")}
    fits = {name: next((mode for mode in own if mode != "n"), "n") for name, own in modes.items()}
    flags = {name: any(cloth.mode(name) != "n" for cloth in scene.cloths) for name in ("damping", "drag")}
    return {
        "version": __version__,
        "generation": generation,
        "title": scene.title.strip() or scene.name,
        "name": scene.name,
        "delta": scene.delta,
        "frames": scene.frames,
        "mesh": mesh(scene),
        "surroundings": surroundings(scene, times, np.broadcast_to(start, (frames, *start.shape))),
        "fit": {**fits, **flags, **{name: scene.mode(name) != "n" for name in ("wind", "gravity")}},
        "airy": any(len(cloth.triangles) for cloth in scene.cloths),
        "warnings": list(scene.warnings)[:20],
    }


def elements_of(scene: Scene) -> dict[str, Any]:
    """The masses and stiffnesses of a scene, as in its mesh."""
    whole = mesh(scene)
    return {name: whole[name] for name in ("mass", "stiffness")}
