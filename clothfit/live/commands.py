"""What each message does, one function each; `answer` finds it. One thread at a time calls them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from numbers import Real
from typing import Any

from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.live import changes, wire
from clothfit.live.session import SOON, Session, elements_of
from clothfit.live.task import Loading
from clothfit.live.wire import fitted_fields, flag, number, whole
from clothfit.live.worker import FIELDS, check_load
from clothfit.scene.scene import load as read


def answer(session: Session, message: Mapping[str, Any]) -> dict[str, Any] | Loading:
    """Do what a message asks for: an answer, or a refusal with its reason; of a loaded scene, what will have it."""
    kind, head = str(message["type"]), head_of(message)
    try:
        if kind not in DOES:
            raise InvalidInput(f"there is no message {kind[:40]!r}; there are {', '.join(DOES)}")
        act, fields = DOES[kind]
        wire.check_fields(message, fields)
        more = act(session, message)
    except ClothfitError as error:
        return {"type": "refused", **head, "reason": str(error)}
    if isinstance(more, Loading):
        return more
    return {"type": "done", **head, **(session.send_status() if more is None else more)}


def answer_long(session: Session, text: str) -> dict[str, Any] | Loading:
    """The same for a message that is too long to be parsed here: it can only load a scene."""
    try:
        return session.open({"of": "load"}, text)
    except ClothfitError as error:
        return {"type": "refused", "of": "load", "reason": str(error)}


def head_of(message: Mapping[str, Any]) -> dict[str, Any]:
    """What an answer has of the message."""
    return {"of": str(message["type"])[:40]} | ({"id": message["id"]} if message.get("id") is not None else {})


def play(session: Session, message: Mapping[str, Any]) -> None:
    """Go on, at a speed and with a return to the start after the target's end where that is asked for."""
    loop = flag(message, "loop") if "loop" in message else session.loop
    if "speed" in message:
        session.engine.speed = message["speed"]
    session.loop = loop
    session.engine.start()


def pause(session: Session, message: Mapping[str, Any]) -> None:
    """Stand still."""
    session.engine.pause()


def take_steps(session: Session, message: Mapping[str, Any]) -> None:
    """Take steps."""
    session.engine.step(whole(message, "n", 1, 1000, 1), wait=False)


def reset(session: Session, message: Mapping[str, Any]) -> None:
    """Go back to the start."""
    session.engine.reset()
    session.engine.wait(SOON)


def load_scene(session: Session, message: Mapping[str, Any]) -> Loading:
    """Begin with another scene, when it has been read and tried."""
    check_load(message)
    return session.open(head_of(message), message)


def set_values(session: Session, message: Mapping[str, Any]) -> dict[str, Any]:
    """Give other values, or factors on those of the base."""
    session.check_not_loading()
    values, asked = message.get("values", {}), message.get("factors", {})
    index = whole(message, "object", 0, len(session.base.cloths) - 1, None)
    if not isinstance(values, dict) or not isinstance(asked, dict) or not (values or asked):
        raise InvalidInput("set: `values` or `factors` is needed, an object")
    if "of" in values:
        raise InvalidInput("set: `of` is no value; `object` says whose they are")
    if {"mass", "stiffness"} & values.keys() and asked:
        raise InvalidInput("set: either masses and stiffnesses, or factors on them")
    before, own = session.undo_state(), dict(values)
    factors = changes.with_changes(session.base, session.factors, asked, index) if asked else session.factors
    made: dict[str, Any] = {kind: changes.multiplied(session.base, factors, kind) for kind in asked}
    if made:
        session.engine.set(**made)
    if own:
        try:
            session.engine.set(of=index, **own)
        except ClothfitError:
            session.engine.use(before.scene)
            raise
    if {"mass", "stiffness"} & own.keys():
        session.base, factors = session.scene, {}
    session.factors = factors
    session.history.save(message.get("gesture"), before)
    if {"pins", "colliders"} & own.keys():
        session.send(session.scenery())
    return session.send_values()


def undo(session: Session, message: Mapping[str, Any]) -> dict[str, Any]:
    """Go back to the values before the last change."""
    session.check_not_loading()
    if not session.history:
        raise InvalidInput("undo: there is nothing to undo")
    if session.task is not None and session.task.name == "estimate":
        raise InvalidInput("undo: a fit is running; cancel it first")
    scene, session.base, session.factors = session.history.last()
    session.engine.use(scene)
    session.send(session.scenery())
    return session.send_values()


def drag(session: Session, message: Mapping[str, Any]) -> dict[str, Any]:
    """Pull a vertex by hand, or let go."""
    vertex = message.get("vertex")
    if vertex is None:
        session.engine.release()
        return {}
    place = message.get("place")
    if not isinstance(place, list) or not all(isinstance(x, Real) and not isinstance(x, bool) for x in place):
        raise InvalidInput("drag: `place` is needed, three numbers in m")
    session.engine.pull(vertex, place)
    return {}


def estimate(session: Session, message: Mapping[str, Any]) -> None:
    """Fit what is chosen to the target, from the values of now."""
    session.free()
    if session.target is None:
        raise InvalidInput("estimate: there is no target yet; its motion is being computed")
    document = fitted_fields(json.loads(session.text_now()), message.get("fit"))
    if "frames" in message:
        document["optimizationIterations"] = whole(message, "frames", 2, len(session.target.times), 2)
    document["optimizationIterations"] = min(document.get("optimizationIterations", 100), len(session.target.times))
    scene = read(document, folder=session.scene.folder)
    budget = number(message, "budget", 0.1, 86400.0, None)
    session.history.save(None, session.undo_state())
    session.start_task("estimate", scene=scene, target=session.target, budget=budget)


def control(session: Session, message: Mapping[str, Any]) -> None:
    """Find the forces that take the cloth through keys, and play them."""
    session.free()
    keys = message.get("keys")
    if not isinstance(keys, list) or not keys:
        raise InvalidInput("control: `keys` is needed, a list as in a file of keyframes")
    from clothfit.control.keyframes import from_json

    scene, text = session.scene.with_forces(None), json.dumps({"keys": keys})
    from_json(text, "keys", scene)
    budget = number(message, "budget", 0.1, 86400.0, 60.0)
    session.start_task("control", scene=scene, keys=text, budget=budget)


def cancel(session: Session, message: Mapping[str, Any]) -> None:
    """End a fit, or a search for forces, with the best so far; give up a scene that is being loaded."""
    if session.loading is not None:
        session.end_loading(session.loading.refused("the load was cancelled"))
    elif session.task is not None and session.task.name != "record":
        session.task.cancel()
    else:
        raise InvalidInput("cancel: nothing is being computed")


DOES: dict[str, tuple[Callable[[Session, Mapping[str, Any]], dict[str, Any] | Loading | None], tuple[str, ...]]] = {
    "play": (play, ("speed", "loop")),
    "pause": (pause, ()),
    "step": (take_steps, ("n",)),
    "reset": (reset, ()),
    "load": (load_scene, FIELDS),
    "set": (set_values, ("values", "factors", "object", "gesture")),
    "undo": (undo, ()),
    "drag": (drag, ("vertex", "place")),
    "estimate": (estimate, ("fit", "frames", "budget")),
    "control": (control, ("keys", "budget")),
    "elements": (lambda session, _: elements_of(session.scene), ()),
    "cancel": (cancel, ()),
    "status": (lambda session, _: session.status(), ()),
}
"""Messages: what does them, and their fields. Where it returns nothing, the answer is the status, which all get."""
