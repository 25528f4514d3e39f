"""The thread of an engine: it steps by the clock, does what is asked for between two steps, and puts each finished
frame where all can read it.

It makes a new array of positions after each step and puts it in place of the last one by one assignment, which no other
thread can see half of; nobody writes to an array that has been put there. So a reader never waits for a step, and never
sees parts of two. The steps are compiled code that lets other threads run meanwhile.

What is asked of the thread is noted under a lock and done between two steps: whole scenes with other values, a pull, a
return to the start.
"""

from __future__ import annotations

import atexit
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple
from weakref import WeakSet

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.engine.inputs.sampling import axes
from clothfit.live.moving import Grip, Moving
from clothfit.motion.divergence import Diverged, Fault, States, worst
from clothfit.scene.scene import Scene

LATE = 0.25
"""Seconds behind the clock from which on the clock waits: a slow machine plays slowly, and does not catch up."""


class Frame(NamedTuple):
    """What the thread has finished."""

    number: int  # steps since the start
    time: float  # s
    mark: int  # what `reset` gave with the scene; 0 at first
    positions: Array  # (n, 3), m, of all objects, in the scene's axes; never written to again


@dataclass
class Wishes:
    """What is asked of the thread, to be done before its next step."""

    scene: Scene | None = None  # to go on in
    mark: int = 0  # of its frames
    rebuild: bool = False  # whether its pins or obstacles differ
    restart: bool = False
    grips: dict[int, tuple[int, Array] | None] = field(default_factory=dict)  # by object: vertex and place, or let go

    def __bool__(self) -> bool:
        return self.scene is not None or self.restart or bool(self.grips)


def checked_speed(speed: float | None) -> float | None:
    """A speed. Raises InvalidInput when it is none."""
    known = isinstance(speed, (int, float)) and not isinstance(speed, bool)
    if speed is not None and not (known and 1e-3 <= speed <= 1e3):
        raise InvalidInput(f"speed: a number from 0.001 to 1000 is needed, or None; {speed!r} was given")
    return None if speed is None else float(speed)


def diverged(cloth: Moving) -> Diverged:
    """The error for a cloth whose next step is not good."""
    from clothfit.engine.stability import advice

    scene, (x, v), step = cloth.scene, cloth.bad, cloth.step + 1
    states = States(np.array([step - 1, step], np.int32), np.stack([cloth.x, x]), np.stack([cloth.v, v]))
    vertex, count = worst(x, cloth.v), len(cloth.x)
    place = f"objects[{cloth.index}], vertex {vertex} of {count}"
    at = f"at step {step} (t = {step * scene.delta:.4g} s)"
    message = f"{scene.name}: the simulation diverged {at}, {place}; {advice(scene, cloth.index)}"
    return Diverged(message, step, None, Fault(cloth.index, states))


class Stepper:
    """The cloths of a scene, and the thread that moves them. `Engine` asks it, under the lock `_change`."""

    def __init__(self, scene: Scene, speed: float | None, on_frame: Callable[[], None] | None) -> None:
        self._speed = checked_speed(speed)
        self._scene, self._on_frame = scene, on_frame
        self._cloths = [Moving(scene, i) for i in range(len(scene.cloths))]
        self._mark = self._asked_mark = 0  # of the frames, and of those after the last `reset`
        self._publish()
        self._wishes, self._running, self._due, self._stopping = Wishes(), False, 0, False
        self._busy = False  # whether the thread does what was asked for
        self._error: ClothfitError | None = None
        self._clock = 0.0  # when the next step is due, s of the monotonic clock
        self._change = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="clothfit engine", daemon=True)
        self._thread.start()
        LIVING.add(self)

    def end(self) -> None:
        """End the thread after the step that is being taken, without waiting for that."""
        with self._change:
            self._stopping = True
            self._change.notify_all()

    def _run(self) -> None:
        while True:
            with self._change:
                self._busy = False
                self._change.notify_all()
                while not (self._stopping or self._wishes or self._goes()):
                    self._change.wait(self._ahead())
                if self._stopping:
                    return
                wishes, self._wishes, self._busy = self._wishes, Wishes(), True
                stepping = self._error is None and self._goes()
            try:
                if wishes:
                    self._fulfil(wishes)
                if stepping and not (wishes.restart and not self._running):
                    self._advance()
            except ClothfitError as error:
                self._fail(error)
            except Exception as error:  # noqa: BLE001  # a fault of the program: to be seen, not lost with the thread
                self._fail(ClothfitError(f"the engine has failed: {error}"))
            if self._on_frame is not None:
                self._on_frame()

    def _goes(self) -> bool:
        """Whether a step is due now."""
        if self._error is not None:
            return False
        return self._due > 0 or (self._running and (self._speed is None or time.monotonic() >= self._clock))

    def _ahead(self) -> float | None:
        """Seconds until the next step is due; None: nobody knows."""
        return max(self._clock - time.monotonic(), 0.0) if self._running and self._speed is not None else None

    def _fail(self, error: ClothfitError) -> None:
        """Stand still with an error, unless a return to the start has been asked for since."""
        with self._change:
            if self._wishes.restart:
                return
            self._error, self._running, self._due = error, False, 0

    def _fulfil(self, wishes: Wishes) -> None:
        """Do what was asked for."""
        if wishes.restart and wishes.scene is not None:
            self._cloths = [Moving(wishes.scene, i) for i in range(len(wishes.scene.cloths))]
            self._mark = wishes.mark
            self._publish()
        elif wishes.scene is not None:
            for cloth in self._cloths:
                if wishes.rebuild:
                    cloth.rebuild(wishes.scene)
                else:
                    cloth.retune(wishes.scene)
        for index, asked in wishes.grips.items():
            if index < len(self._cloths):
                cloth = self._cloths[index]
                cloth.pull(None if asked is None else Grip(asked[0], self._world(asked[1])))

    def _advance(self) -> None:
        """Take one step."""
        for cloth in self._cloths:
            if not cloth.advance():
                raise diverged(cloth)
        with self._change:
            self._due = max(self._due - 1, 0)
            if self._speed is not None:
                now = time.monotonic()
                self._clock = max(self._clock + self._scene.delta / self._speed, now - LATE)
        self._publish()

    def _publish(self) -> None:
        first = self._cloths[0]
        self._latest = Frame(first.step, first.step * first.scene.delta, self._mark, self._positions())

    def _positions(self) -> Array:
        """Where all vertices are (n, 3), in a new array."""
        found: Array = np.concatenate([cloth.x for cloth in self._cloths])
        frame = self._cloths[0].scene.frame
        if frame is not None:
            time_now = self._cloths[0].step * self._cloths[0].scene.delta
            found = axes(frame, np.array([time_now])).own(found[None])[0]
        return found

    def _world(self, place: Array) -> Array:
        """A place (3,) in the scene's axes, in those of the world."""
        frame = self._scene.frame
        if frame is None:
            return place
        now = axes(frame, np.array([self._cloths[0].step * self._scene.delta]))
        return np.asarray(now.world(place[None, None])[0, 0])

    @property
    def lives(self) -> bool:
        """Whether the thread has not ended: it may be compiling, which cannot be broken off."""
        return self._thread.is_alive()


LIVING: WeakSet[Stepper] = WeakSet()
"""All that were made."""


@atexit.register
def end_all() -> None:
    """End all threads before the interpreter ends: one that compiles would fall with it."""
    for each in list(LIVING):
        each.end()
        each._thread.join()
