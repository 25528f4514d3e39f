"""A simulation that runs in a thread of its own and can be asked for positions at any moment.

`stepper` has the thread, and why nobody waits for it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.live.changes import changed
from clothfit.live.stepper import Frame, Stepper, Wishes, checked_speed
from clothfit.scene.scene import Scene, check_is_scene

PATIENCE = 2.0
"""Seconds that `stop` waits for a thread that is compiling; it then ends by itself."""


class Engine(Stepper):
    """The cloths of a scene in motion, in a thread of their own.

    `speed` is simulated by real time: 1 plays in real time, None as fast as the machine can. `on_frame` is called in
    the thread after each step and each change, and must not wait. Raises InvalidScene for inputs in files that cannot
    be read. Use it in a `with` block, or call `stop`.
    """

    def __init__(self, scene: Scene, *, speed: float | None = 1.0, on_frame: Callable[[], None] | None = None) -> None:
        check_is_scene(scene)
        super().__init__(scene, speed, on_frame)

    def __enter__(self) -> Engine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
        with self._change:
            self._speed, self._clock = checked_speed(speed), time.monotonic()
            self._change.notify_all()

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
        with self._change:
            self._running, self._clock = True, time.monotonic()
            self._change.notify_all()

    def pause(self) -> None:
        """Stand still after the step that is being taken."""
        with self._change:
            self._running = False
            self._change.notify_all()

    def step(self, n: int = 1, wait: bool = True) -> int:
        """Pause, and take n steps more; returns the number of the last frame. Raises its `error` where it cannot. With
        `wait` False it returns at once.
        """
        if isinstance(n, bool) or not isinstance(n, int) or n < 1:
            raise InvalidInput(f"step: a whole number from 1 on is needed; {n!r} was given")
        self._check()
        with self._change:
            self._running = False
            self._due += n
            self._change.notify_all()
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
        with self._change:
            made = self._scene if scene is None else scene
            self._asked_mark = self._asked_mark if mark is None else mark
            self._scene, self._due, self._error = made, 0, None
            self._wishes = Wishes(made, self._asked_mark, restart=True)
            self._change.notify_all()

    def set(self, *, of: int | None = None, **values: Any) -> None:
        """Give other values to what moves, before its next step.

        `mass`, kg, `stiffness`, N/m, `rest`, m, `damping` and `drag` are a number, or one item for each object, or for
        the one object `of` a number or array; `wind`, m/s, and `gravity`, m/s², are (3,); `friction` and `contact` a
        number, or one for each of the scene's `laws`; `pins` the numbers of the vertices that are fixed from now on,
        where they are; `colliders` by their numbers in the file other `pos`, m, `rot`, degrees, or `scale`, (3,) each.
        Raises InvalidInput with the reason, and changes nothing.
        """
        with self._change:
            made, rebuild = changed(self._scene, values, of)
            self._scene = made
            self._wishes.scene = made
            self._wishes.rebuild |= rebuild
            self._change.notify_all()

    def use(self, scene: Scene) -> None:
        """Go on in another version of the scene, with as many vertices and springs: other values, pins or obstacles."""
        check_is_scene(scene)
        if scene.vertex_counts != self._scene.vertex_counts:
            raise InvalidInput("use: the scene has other objects; reset to it")
        with self._change:
            same = all(np.array_equal(a.fixed, b.fixed) for a, b in zip(scene.cloths, self._scene.cloths, strict=True))
            still = scene.colliders is self._scene.colliders and scene.spheres is self._scene.spheres
            self._scene = self._wishes.scene = scene
            self._wishes.rebuild |= not (same and still)
            self._change.notify_all()

    def pull(self, vertex: int, place: Sequence[float] | Array) -> None:
        """Pull a vertex, counted over all objects, to a place (3,), m, as with a spring, until `release`."""
        index, own = self._owner(vertex)
        to = np.asarray(place, float)
        if to.shape != (3,) or not np.isfinite(to).all():
            raise InvalidInput("pull: a place of three numbers is needed")
        if not np.abs(to).max() < 1e6:
            raise InvalidInput("pull: the place is too far away")
        with self._change:
            self._wishes.grips[index] = own, to
            self._change.notify_all()

    def release(self) -> None:
        """Let go of all vertices."""
        with self._change:
            self._wishes.grips = dict.fromkeys(range(len(self._scene.cloths)))
            self._change.notify_all()

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
        ends = np.cumsum(counts)
        index = int(np.searchsorted(ends, vertex, side="right"))
        return index, int(vertex - ends[index] + counts[index])
