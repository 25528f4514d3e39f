"""A simulation that runs in a thread of its own and can be asked for positions at any moment.

The thread steps by the clock, does what is asked for between two steps, and puts each finished frame where all can read
it. It makes a new array of positions after each step and puts it in place of the last one by one assignment, which no
other thread can see half of; nobody writes to an array that has been put there. So a reader never waits for a step, and
never sees parts of two. The steps are compiled code that lets other threads run meanwhile.

What is asked of the thread is noted under a lock and done between two steps: whole scenes with other values, a pull, a
return to the start.
"""

from __future__ import annotations

import atexit
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple
from weakref import WeakSet

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.engine.inputs.sampling import axes
from clothfit.live.changes import changed
from clothfit.live.moving import Grip, Moving
from clothfit.motion.divergence import Diverged, Fault, States, worst
from clothfit.scene.scene import Scene, check_is_scene, owner

LATE = 0.25
"""Seconds behind the clock from which on the clock waits: a slow machine plays slowly, and does not catch up."""

PATIENCE = 2.0
"""Seconds that `stop` waits for a thread that is compiling; it then ends by itself."""


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


class Engine:
    """The cloths of a scene in motion, in a thread of their own.

    `speed` is simulated by real time: 1 plays in real time, None as fast as the machine can. `on_frame` is called in
    the thread after each step and each change, and must not wait. Raises InvalidScene for inputs in files that cannot
    be read. Use it in a `with` block, or call `stop`.
    """

    def __init__(self, scene: Scene, *, speed: float | None = 1.0, on_frame: Callable[[], None] | None = None) -> None:
        check_is_scene(scene)
        scene.check_apart("the live engine")
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

    def __enter__(self) -> Engine:
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    def __repr__(self) -> str:
        doing = "stopped" if self._stopping else "running" if self.running else "paused"
        return f"<Engine of {self._scene.name}: frame {self.frame}, {doing}>"

    @property
    def error(self) -> ClothfitError | None:
        """Why the engine does not go on: `Diverged`, or another error; None while all is well. `reset` clears it."""
        return self._error

    @property
    def running(self) -> bool:
        """Whether it goes on by itself."""
        return self._running and self._error is None

    @property
    def frame(self) -> int:
        """The number of the last finished frame; 0 is the start."""
        return self._latest.number

    @property
    def scene(self) -> Scene:
        """The scene with the values that were set last."""
        return self._scene

    @property
    def speed(self) -> float | None:
        """Simulated by real time; None: as fast as possible."""
        return self._speed

    @speed.setter
    def speed(self, speed: float | None) -> None:
        with self._changing():
            self._speed, self._clock = checked_speed(speed), time.monotonic()

    def latest(self) -> tuple[int, Array]:
        """The number of the last finished frame, and a copy of its positions (n, 3), m, of all objects in file order.

        Never waits for a step.
        """
        frame = self._latest
        return frame.number, frame.positions.copy()

    def shared(self) -> Frame:
        """The same without a copy; nobody may write to it."""
        return self._latest

    def start(self) -> None:
        """Go on by itself from now on. Raises its `error` where it cannot."""
        self._check()
        with self._changing():
            self._running, self._clock = True, time.monotonic()

    def pause(self) -> None:
        """Stand still after the step that is being taken."""
        with self._changing():
            self._running = False

    def step(self, n: int = 1, wait: bool = True) -> int:
        """Pause, and take n steps more; returns the number of the last frame. Raises its `error` where it cannot. With
        `wait` False it returns at once.
        """
        if isinstance(n, bool) or not isinstance(n, int) or n < 1:
            raise InvalidInput(f"step: a whole number from 1 on is needed; {n!r} was given")
        self._check()
        with self._changing():
            self._running = False
            self._due += n
        if wait:
            self.wait()
            self._check()
        return self.frame

    def reset(self, scene: Scene | None = None, mark: int | None = None) -> None:
        """Go back to the start, of another scene where one is given; the values that were set stay. Frames from then on
        bear the `mark` where one is given, so that nobody takes one of before for one of them.
        """
        if scene is not None:
            check_is_scene(scene)
        with self._changing():
            made = self._scene if scene is None else scene
            self._asked_mark = self._asked_mark if mark is None else mark
            self._scene, self._due, self._error = made, 0, None
            self._wishes = Wishes(made, self._asked_mark, restart=True)

    def set(self, *, of: int | None = None, **values: Any) -> None:
        """Give other values to what moves, before its next step.

        `mass`, kg, `stiffness`, N/m, `rest`, m, `damping` and `drag` are a number, or one item for each object, or for
        the one object `of` a number or array; `wind`, m/s, and `gravity`, m/s², are (3,); `friction` and `contact` a
        number, or one for each of the scene's `laws`; `pins` the numbers of the vertices that are fixed from now on,
        where they are; `colliders` by their numbers in the file other `pos`, m, `rot`, degrees, or `scale`, (3,) each.
        Raises InvalidInput with the reason, and changes nothing.
        """
        with self._changing():
            made, rebuild = changed(self._scene, values, of)
            self._scene = made
            self._wishes.scene = made
            self._wishes.rebuild |= rebuild

    def use(self, scene: Scene) -> None:
        """Go on in another version of the scene, with as many vertices and springs: other values, pins or obstacles."""
        check_is_scene(scene)
        if scene.vertex_counts != self._scene.vertex_counts:
            raise InvalidInput("use: the scene has other objects; reset to it")
        with self._changing():
            same = all(np.array_equal(a.fixed, b.fixed) for a, b in zip(scene.cloths, self._scene.cloths, strict=True))
            still = scene.colliders is self._scene.colliders and scene.spheres is self._scene.spheres
            self._scene = self._wishes.scene = scene
            self._wishes.rebuild |= not (same and still)

    def pull(self, vertex: int, place: Sequence[float] | Array) -> None:
        """Pull a vertex, counted over all objects, to a place (3,), m, as with a spring, until `release`."""
        index, own = self._owner(vertex)
        to = np.asarray(place, float)
        if to.shape != (3,) or not np.isfinite(to).all():
            raise InvalidInput("pull: a place of three numbers is needed")
        if not np.abs(to).max() < 1e6:
            raise InvalidInput("pull: the place is too far away")
        with self._changing():
            self._wishes.grips[index] = own, to

    def release(self) -> None:
        """Let go of all vertices."""
        with self._changing():
            self._wishes.grips = dict.fromkeys(range(len(self._scene.cloths)))

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until what was asked for is done, at most so long; returns whether it is."""

        def done() -> bool:
            return self._stopping or self._error is not None or not (self._wishes or self._due or self._busy)

        with self._change:
            return self._change.wait_for(done, seconds)

    def stop(self) -> None:
        """End the thread after the step that is being taken; `latest` still answers."""
        self.end()
        if self._thread is not threading.current_thread():
            self._thread.join(PATIENCE)

    def end(self) -> None:
        """End the thread after the step that is being taken, without waiting for that."""
        with self._changing():
            self._stopping = True

    @property
    def lives(self) -> bool:
        """Whether the thread has not ended: it may be compiling, which cannot be broken off."""
        return self._thread.is_alive()

    @contextmanager
    def _changing(self) -> Iterator[None]:
        """Change what the thread looks at, and wake it."""
        with self._change:
            yield
            self._change.notify_all()

    def _check(self) -> None:
        if self._error is not None:
            raise self._error
        if self._stopping:
            raise InvalidInput("the engine has been stopped; make another")

    def _owner(self, vertex: int) -> tuple[int, int]:
        """The object that has a vertex, and its number there."""
        counts = self._scene.vertex_counts
        if isinstance(vertex, bool) or not isinstance(vertex, (int, np.integer)) or not 0 <= vertex < sum(counts):
            raise InvalidInput(f"there is no vertex {vertex!r}; the scene has {sum(counts)}")
        return owner(int(vertex), counts)

    # ---- the thread

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
                (cloth.rebuild if wishes.rebuild else cloth.retune)(wishes.scene)
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
        """Put where all vertices are into a new frame."""
        first, x = self._cloths[0], np.concatenate([cloth.x for cloth in self._cloths])
        now = first.step * first.scene.delta
        if first.scene.frame is not None:
            x = axes(first.scene.frame, np.array([now])).own(x[None])[0]
        self._latest = Frame(first.step, now, self._mark, x)

    def _world(self, place: Array) -> Array:
        """A place (3,) in the scene's axes, in those of the world."""
        frame = self._scene.frame
        if frame is None:
            return place
        now = axes(frame, np.array([self._cloths[0].step * self._scene.delta]))
        return np.asarray(now.world(place[None, None])[0, 0])


LIVING: WeakSet[Engine] = WeakSet()
"""All that were made."""


@atexit.register
def end_all() -> None:
    """End all threads before the interpreter ends: one that compiles would fall with it."""
    for each in list(LIVING):
        each.end()
        each._thread.join()
