"""One scene that is played, tuned and fitted: what each message does. One thread at a time calls it.

The scene that moves is a base, as it was loaded or fitted, with factors on its masses and stiffnesses and with other
values beside; `undo` goes back through all three. The target is a motion that was given, or that of the scene as it was
loaded.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from numbers import Real
from typing import Any, NamedTuple

from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.live import sliders, wire
from clothfit.live.asked import fitted_fields, flag, number, whole
from clothfit.live.engine import Engine
from clothfit.live.scenery import described
from clothfit.live.tasks import Task
from clothfit.motion.motion import Motion
from clothfit.scene.scene import Scene, dumps, load

MOST_UNDO = 100
LARGEST_TARGET = 64 << 20
"""Bytes of a target that is shown."""

PAUSE = 0.5
"""Seconds that a motion goes on after its target has ended, before it begins again."""

SOON = 0.05
"""Seconds that an answer waits for the first frame after a return to the start, which may have to be compiled for."""

Tell = Callable[[Any], None]
"""Sends a message to all who watch: a dict as text, bytes as they are."""


class Moment(NamedTuple):
    """What `undo` goes back to."""

    scene: Scene
    base: Scene
    factors: sliders.Factors


class Session:
    """What is behind a page. `tell` is called with what all who watch should know, from several threads."""

    def __init__(
        self, scene: Scene, tell: Tell, on_frame: Callable[[], None], target: Motion | None = None,
        later: Callable[[Callable[[], None]], None] | None = None,
    ) -> None:  # fmt: skip
        """`later` takes what a task's thread wants to be done in the thread of the messages."""
        self.tell, self._later, self._noted = tell, later or (lambda act: act()), on_frame
        self.generation, self.loop = 0, True
        self.task: Task | None = None
        self._given = target
        self.engine = Engine(scene, on_frame=on_frame)
        self._begin(scene, target)

    def _begin(self, scene: Scene, target: Motion | None) -> None:
        """Begin with a scene."""
        self.base = scene
        self.factors: sliders.Factors = {}
        self.history: list[tuple[str | None, Moment]] = []
        self.target = target
        self.outcome: dict[str, Any] | None = None
        if target is None:
            self._start("record", scene=scene)

    def answer(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Do what a message asks for: an answer, or a refusal with its reason."""
        kind = str(message["type"])
        head = {"of": kind[:40]} | ({"id": message["id"]} if message.get("id") is not None else {})
        try:
            if kind not in DOES:
                raise InvalidInput(f"there is no message {kind[:40]!r}; there are {', '.join(DOES)}")
            unknown = sorted(set(message) - {"type", "id"} - set(DOES[kind][1]))
            if unknown:
                fields = ", ".join(DOES[kind][1]) or "none"
                raise InvalidInput(f"{kind}: there is no field {unknown[0][:40]!r}; there are: {fields}")
            more = DOES[kind][0](self, message)
        except ClothfitError as error:
            return {"type": "refused", **head, "reason": str(error)}
        return {"type": "done", **head, **(more or {})}

    # ---- what all see

    def status(self, message: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """How things stand."""
        engine = self.engine
        return {"status": {
            "running": engine.running, "frame": engine.frame, "time": engine.shared().time,
            "speed": engine.speed, "loop": self.loop, "error": None if engine.error is None else str(engine.error),
            "busy": None if self.task is None else self.task.name, "undo": len(self.history),
            "generation": self.generation, "target": self.target is not None, "outcome": self.outcome,
        }}  # fmt: skip

    def scenery(self, generation: int | None = None) -> dict[str, Any]:
        """The scene as a page draws it."""
        named = self.generation if generation is None else generation
        return {"type": "scene", **described(self.engine.scene, named), **self.values()}

    def values(self) -> dict[str, Any]:
        """The values that sliders show."""
        scene = self.engine.scene
        return {"values": {
            "damping": [cloth.damping for cloth in scene.cloths], "drag": [cloth.drag for cloth in scene.cloths],
            "wind": scene.wind.tolist(), "gravity": scene.gravity.tolist(),
            "factors": sliders.listed(self.base, self.factors),
        }}  # fmt: skip

    def target_packet(self) -> bytes | None:
        """The target as a binary message, where there is one that is not too large to show."""
        if self.target is None:
            return None
        x, times = self.target.positions, self.target.times
        every = 1 + x.nbytes // (2 * LARGEST_TARGET)
        step = float(times[1] - times[0]) * every if len(times) > 1 else self.engine.scene.delta
        return wire.packed(wire.TARGET, self.generation, len(x[::every]), step, x[::every])

    def frame_packet(self) -> bytes | None:
        """The last frame as a binary message; None while a scene that was loaded has none yet."""
        frame = self.engine.shared()
        if frame.mark != self.generation:
            return None
        return wire.packed(wire.FRAME, frame.mark, frame.number, frame.time, frame.positions)

    def text(self) -> bytes:
        """The scene as a file: the one that was loaded, but for the values that differ."""
        return dumps(self.engine.scene)

    def close(self) -> None:
        """End the thread and the process."""
        if self.task is not None:
            self.task.kill()
        self.engine.stop()

    # ---- what messages do

    def play(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Go on, at a speed and with a return to the start after the target's end where that is asked for."""
        if "speed" in message:
            self.engine.speed = message["speed"]
        if "loop" in message:
            self.loop = flag(message, "loop")
        self.engine.start()
        return self._told()

    def pause(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Stand still."""
        self.engine.pause()
        return self._told()

    def step(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Take steps."""
        self.engine.step(whole(message, "n", 1, 1000, 1), wait=False)
        return self._told()

    def reset(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Go back to the start."""
        self.engine.reset()
        self.engine.wait(SOON)
        return self._told()

    def load(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Begin with another scene."""
        given = message.get("scene")
        if not isinstance(given, (dict, str)):
            raise InvalidInput("load: `scene` is needed, the JSON of a scene or its text")
        self._free()
        made = load(given if isinstance(given, dict) else io.StringIO(given), folder=self.engine.scene.folder)
        name = message.get("name")
        made = replace(made, name=str(name)[:200]) if isinstance(name, str) and name else made
        mark = self.generation + 1
        self.engine.reset(made, mark)
        self._begin(made, None)
        self.tell(self.scenery(mark))
        self.generation = mark  # from now on its frames are sent
        self.engine.wait(SOON)
        self._noted()
        return self._told()

    def set(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Give other values, or factors on those of the base."""
        values, asked = message.get("values", {}), message.get("factors", {})
        index = whole(message, "object", 0, len(self.base.cloths) - 1, None)
        if not isinstance(values, dict) or not isinstance(asked, dict) or not (values or asked):
            raise InvalidInput("set: `values` or `factors` is needed, an object")
        if "of" in values:
            raise InvalidInput("set: `of` is no value; `object` says whose they are")
        if {"mass", "stiffness"} & values.keys() and asked:
            raise InvalidInput("set: either masses and stiffnesses, or factors on them")
        before, own = self._moment(), dict(values)
        factors = sliders.with_asked(self.base, self.factors, asked, index) if asked else self.factors
        made: dict[str, Any] = {kind: sliders.multiplied(self.base, factors, kind) for kind in asked}
        if made:
            self.engine.set(**made)
        if own:
            try:
                self.engine.set(of=index, **own)
            except ClothfitError:
                self.engine.use(before.scene)
                raise
        if {"mass", "stiffness"} & own.keys():
            self.base, factors = self.engine.scene, {}
        self.factors = factors
        self._remember(message.get("gesture"), before)
        if {"pins", "colliders"} & own.keys():
            self.tell(self.scenery())
        return self._told_values()

    def undo(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Go back to the values before the last change."""
        if not self.history:
            raise InvalidInput("undo: there is nothing to undo")
        if self.task is not None and self.task.name == "estimate":
            raise InvalidInput("undo: a fit is running; cancel it first")
        scene, self.base, self.factors = self.history.pop()[1]
        self.engine.use(scene)
        self.tell(self.scenery())
        return self._told_values()

    def drag(self, message: Mapping[str, Any]) -> None:
        """Pull a vertex by hand, or let go."""
        vertex = message.get("vertex")
        if vertex is None:
            self.engine.release()
            return
        place = message.get("place")
        if not isinstance(place, list) or not all(isinstance(x, Real) and not isinstance(x, bool) for x in place):
            raise InvalidInput("drag: `place` is needed, three numbers in m")
        self.engine.pull(vertex, place)

    def estimate(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Fit what is chosen to the target, from the values of now."""
        self._free()
        if self.target is None:
            raise InvalidInput("estimate: there is no target yet; its motion is being computed")
        document = fitted_fields(json.loads(self.text_now()), message.get("fit"))
        if "frames" in message:
            document["optimizationIterations"] = whole(message, "frames", 2, len(self.target.times), 2)
        document["optimizationIterations"] = min(document.get("optimizationIterations", 100), len(self.target.times))
        scene = load(document, folder=self.engine.scene.folder)
        budget = number(message, "budget", 0.1, 86400.0, None)
        self._remember(None, self._moment())
        self.outcome = None
        self._start("estimate", scene=scene, target=self.target, budget=budget)
        return self._told()

    def control(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Find the forces that take the cloth through keys, and play them."""
        self._free()
        keys = message.get("keys")
        if not isinstance(keys, list) or not keys:
            raise InvalidInput("control: `keys` is needed, a list as in a file of keyframes")
        from clothfit.control.keyframes import from_json

        scene, text = self.engine.scene.with_forces(None), json.dumps({"keys": keys})
        from_json(text, "keys", scene)
        budget = number(message, "budget", 0.1, 86400.0, 60.0)
        self.outcome = None
        self._start("control", scene=scene, keys=text, budget=budget)
        return self._told()

    def cancel(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """End a fit, or a search for forces, with the best so far."""
        if self.task is None or self.task.name == "record":
            raise InvalidInput("cancel: nothing is being computed")
        self.task.cancel()
        return self._told()

    # ---- how they do it

    def text_now(self) -> str:
        """The text of the scene as it is."""
        source = self.engine.scene.source
        return self.text().removeprefix(source.mark).decode(source.encoding)

    def _moment(self) -> Moment:
        return Moment(self.engine.scene, self.base, self.factors)

    def _remember(self, gesture: Any, before: Moment) -> None:
        """Note what `undo` goes back to: of one gesture, such as the drag of a slider, what was before all of it."""
        name = str(gesture)[:100] if gesture is not None else None
        if name is None or not self.history or self.history[-1][0] != name:
            self.history = [*self.history[-MOST_UNDO:], (name, before)]

    def _told(self) -> dict[str, Any]:
        """The status, which all get."""
        status = self.status()
        self.tell({"type": "status", **status})
        return status

    def _told_values(self) -> dict[str, Any]:
        values = self.values()
        self.tell({"type": "values", **values})
        return values | self._told()

    def _free(self) -> None:
        """Raise InvalidInput while something is computed; a record of the target gives way."""
        if self.task is not None and self.task.name != "record":
            raise InvalidInput(f"{self.task.name} is running; cancel it first")

    def _start(self, name: str, **arguments: Any) -> None:
        """Start a task."""
        if self.task is not None:
            self.task.kill()

        def heard(kind: str, content: dict[str, Any]) -> None:
            self._later(lambda: self._heard(task, kind, content))

        task = Task(name, heard, **arguments)
        self.task = task

    def _heard(self, task: Task, kind: str, content: dict[str, Any]) -> None:
        """Take what a task says; one that another has taken the place of is not heard."""
        if task is not self.task:
            return
        if content.get("values") is not None:
            self._take(content["values"])
        if kind == "progress":
            self.tell({"type": "progress", "of": task.name, **content["figures"]})
            return
        self.task = None
        if kind == "done" and "motion" in content:
            self.target = content["motion"]
            self.tell(self.target_packet())
        if "forces" in content:
            self.engine.reset(self.engine.scene.with_forces(content["forces"]))
            self.engine.start()
        if task.name != "record" or kind == "failed":
            own = content.get("summary") or {"status": "failed" if kind == "failed" else "cancelled"}
            self.outcome = {"of": task.name, "reason": content.get("reason"), **own}
            self.tell({"type": "ended", **self.outcome})
        self._told()

    def _take(self, values: dict[str, Any]) -> None:
        """Go on with values that a fit has found; they are the base of later factors."""
        self.engine.use(self.engine.scene.with_values(**values))
        self.base, self.factors = self.engine.scene, {}
        self.tell({"type": "values", **self.values()})

    def again(self) -> None:
        """Go back to the start where the target has ended, if that is wanted."""
        frame, target = self.engine.shared(), self.target
        if frame.mark != self.generation or target is None or not (self.loop and self.engine.running):
            return
        if frame.time > target.times[-1] + PAUSE:
            self.engine.reset()


DOES: dict[str, tuple[Callable[[Session, Mapping[str, Any]], dict[str, Any] | None], tuple[str, ...]]] = {
    "play": (Session.play, ("speed", "loop")),
    "pause": (Session.pause, ()),
    "step": (Session.step, ("n",)),
    "reset": (Session.reset, ()),
    "load": (Session.load, ("scene", "name")),
    "set": (Session.set, ("values", "factors", "object", "gesture")),
    "undo": (Session.undo, ()),
    "drag": (Session.drag, ("vertex", "place")),
    "estimate": (Session.estimate, ("fit", "frames", "budget")),
    "control": (Session.control, ("keys", "budget")),
    "cancel": (Session.cancel, ()),
    "status": (Session.status, ()),
}
"""Messages: what does them, and their fields."""
