"""Fit many scenes, each from one or several starts; the start with the lowest cost gives the result.

The results do not depend on the number of processes, on the order in which they end, or on where they run, as long as
the machines round alike.

Run many jobs to their ends, in any order, on processes of this machine or on a cluster.

A job is made when there is room for it, so that not all files are in memory at once. A job whose process dies is tried
once more, alone, after all others are done, so that no other job can be the cause. After the first request to end
(Ctrl-C) running jobs end with their best so far; a second request ends them at once.
"""

from __future__ import annotations

import os
import queue
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias, Unpack

import numpy as np

from clothfit.base.errors import InvalidInput
from clothfit.base.interrupts import SAME_REQUEST, handled
from clothfit.base.memory import budget
from clothfit.fit.options import FitOptions, Keywords, options_of
from clothfit.many.job import (
    FAULT,
    INTERRUPTED,
    NOT_STARTED,
    PREPARATION,
    Died,
    File,
    Job,
    JobTarget,
    Lost,
    Outcome,
    failed,
    loaded,
    read,
)

if TYPE_CHECKING:
    from clothfit.base.arrays import Array
    from clothfit.fit.result import Fit
    from clothfit.many.cluster import Cluster
    from clothfit.many.processes import Processes
    from clothfit.scene.scene import Scene

Path = str | os.PathLike[str]


@dataclass(frozen=True)
class Result:
    """The result of one scene."""

    outcomes: list[Outcome]  # one per start
    best: int  # the start with the lowest cost; of several such, the first

    @property
    def outcome(self) -> Outcome:
        """The outcome of the best start."""
        return self.outcomes[self.best]

    @property
    def fit(self) -> Fit | None:
        """The fit of the best start, whose status may also be "diverged"; None where there is none."""
        return self.outcome.fit

    @property
    def error(self) -> str | None:
        """Why there is nothing to save; None where there is."""
        return self.outcome.error

    @property
    def exit_code(self) -> int:
        """The exit code of a command for this scene alone."""
        codes = [outcome.exit_code for outcome in self.outcomes]
        return INTERRUPTED if INTERRUPTED in codes else self.outcome.exit_code


def result(outcomes: list[Outcome]) -> Result:
    """The result of a scene from the outcomes of its starts."""
    costs = [o.fit.cost if o.fit is not None and o.usable else np.inf for o in outcomes]
    usable = [i for i, o in enumerate(outcomes) if o.usable]
    return Result(outcomes, min(usable, key=lambda i: (costs[i], i)) if usable else 0)


def fit_all(
    makers: Sequence[Callable[[int], Job]], starts: int, pool: Pool, done: Callable[[int, Result], None] | None = None,
    died: Callable[[int], None] | None = None,
) -> list[Result]:
    """Fit scenes, each from `starts` starts; returns their results in order.

    Each of `makers` makes the jobs of one scene by the number of the start. `done` is called with the index and result
    of each scene that is fitted, `died` with the index when a process has died and its job will be tried again. The
    pool is closed in the end.
    """
    found: list[dict[int, Outcome]] = [{} for _ in makers]
    results: dict[int, Result] = {}

    def report(number: int, outcome: Outcome | None) -> None:
        scene, start = divmod(number, starts)
        if outcome is None:
            if died:
                died(scene)
            return
        found[scene][start] = outcome
        if len(found[scene]) == starts:
            results[scene] = result([found[scene][i] for i in range(starts)])
            if done:
                done(scene, results[scene])

    jobs = [partial(make, start) for make in makers for start in range(starts)]
    killed = True
    try:
        Batch(pool, jobs, report).run()
        killed = False
    finally:
        pool.close(kill=killed)
    return [results[scene] for scene in range(len(makers))]


def chosen_pool(count: int, jobs: int | None, cluster: str | None) -> Pool:
    """The pool for `count` jobs: `jobs` processes (default: one per core), or a Dask cluster."""
    if cluster is not None:
        from clothfit.many.cluster import Cluster

        return Cluster(cluster)
    from clothfit.base.threads import usable_cores
    from clothfit.many.processes import Processes

    return Processes(max(1, min(count, jobs or usable_cores())))


def limited(options: FitOptions, pool: Pool) -> FitOptions:
    """Options of a fit, where the processes of this machine share the memory that one fit would allow itself."""
    from clothfit.many.processes import Processes

    if options.memory is None and isinstance(pool, Processes):
        return replace(options, memory=budget(None) // pool.width)
    return options


def check_numbers(starts: int, seed: int, jobs: int | None) -> None:
    """Raise InvalidInput on impossible numbers."""
    for name, value, least in (("starts", starts, 1), ("seed", seed, 0), ("jobs", jobs, 1)):
        if value is not None and value < least:
            raise InvalidInput(f"{name} must be at least {least}; {value} was given")


def estimate_many(
    scenes: Sequence[Path | Scene], targets: Sequence[Any] | None = None,
    start: float | Array | Path | Scene | None = None, *, starts: int = 1, seed: int = 0, jobs: int | None = None,
    cluster: str | None = None, done: Callable[[int, Result], None] | None = None, **options: Unpack[Keywords],
) -> list[Result]:
    """Fit several scenes, each in a process of its own; returns a `Result` for each, in their order.

    `targets` has one item per scene, as `estimate` takes it, or a path (default: the scenes' own motions). Each scene
    is fitted from `starts` starting points, drawn with `seed`; the one with the lowest cost is its result. The fits run
    on `jobs` processes (default: one per core), or on a Dask `cluster`, "tcp://host:port". `done` is called with index
    and result when a scene is fitted. `options` are those of `estimate`. A scene that fails has the error in its result
    and does not stop the others. Raises InvalidInput when there is no such cluster, or an argument is impossible.
    """
    check_numbers(starts, seed, jobs)
    asked = options_of("estimate_many", options)
    given = [None] * len(scenes) if targets is None else list(targets)
    if len(given) != len(scenes):
        raise InvalidInput(f"targets: {len(given)} are given for {len(scenes)} scenes; give one item for each")
    first = start if start is None or isinstance(start, (int, float, np.ndarray)) else packed(start)

    pool = chosen_pool(len(scenes) * starts, jobs, cluster)
    each = limited(asked, pool)

    def make(index: int, number: int) -> Job:
        return Job(packed(scenes[index]), packed_targets(given[index], scenes[index]), first, number, seed, each)

    makers = [partial(make, index) for index in range(len(scenes))]
    return fit_all(makers, starts, pool, done)


def packed(scene: Path | Scene) -> File:
    """A scene as it travels. Raises InvalidInput when it cannot be read."""
    if isinstance(scene, (str, os.PathLike)):
        return read(scene)
    from clothfit.scene.scene import dumps

    return File(dumps(scene), scene.name, scene.folder)


def packed_targets(targets: Any, main: Path | Scene) -> tuple[JobTarget, ...]:
    """Targets of a scene as they travel. Raises InvalidInput when one cannot be read."""
    listed = [] if targets is None else targets if isinstance(targets, list) else [targets]
    pairs = [item if isinstance(item, tuple) else (item, None) for item in listed]
    return tuple(
        (packed_motion(motion, main if scene is None else scene), None if scene is None else packed(scene))
        for motion, scene in pairs
    )


def packed_motion(motion: Any, scene: Path | Scene) -> Any:
    """A motion as it travels: another program's may be many files, and is read here. Raises InvalidInput."""
    from clothfit.formats.registry import foreign
    from clothfit.motion.files import load_motion

    if not isinstance(motion, (str, os.PathLike)):
        return motion
    return read(motion) if foreign(motion) is None else load_motion(motion, loaded(packed(scene)))


TICK = 0.25  # s between checks whether the pool still exists

REQUEST, NO_EVENT = -2, -3
"""Events other than the end of a job, which is its number, or of what precedes them all."""

CUT_SHORT = Outcome(None, INTERRUPTED, "ended at once, by a second request; nothing is written")


Pool: TypeAlias = "Processes | Cluster"
"""Where jobs run, `width` at a time. Each has a number; `done` is called with it from another thread when the job ends.
Where `retried_alone`, a job whose process died is tried again.
"""


class Batch:
    """Runs many jobs on a pool."""

    def __init__(
        self, pool: Pool, jobs: Sequence[Callable[[], Job]], report: Callable[[int, Outcome | None], None]
    ) -> None:
        """`jobs` make each job when its turn comes, and may raise.

        `report` is called once with each number and its outcome. Where a process died and its job will be tried again,
        it is called with None before that.
        """
        self.pool, self.jobs, self.report = pool, jobs, report
        self.waiting = deque(range(len(jobs)))
        self.alone: deque[int] = deque()
        self.running: set[int] = set()
        self.died: set[int] = set()
        self.stopping = False
        self._last_request = -SAME_REQUEST
        self._events: queue.SimpleQueue[int] = queue.SimpleQueue()

    def run(self) -> None:
        """Run all jobs."""
        with handled(lambda _: lambda number, frame: self._events.put(REQUEST)):
            if len(self.jobs) > 1 and self.pool.prepare(self._events.put):
                self.running.add(PREPARATION)
            while self.waiting or self.alone or self.running:
                self._begin()
                if self.running:
                    self._handle_event()

    def _begin(self) -> None:
        """Begin as many jobs as there is room for."""
        if PREPARATION in self.running:
            return
        while self.waiting and len(self.running) < self.pool.width:
            self._submit(self.waiting.popleft())
        if self.alone and not self.running:
            self._submit(self.alone.popleft())

    def _submit(self, number: int) -> None:
        try:
            job = self.jobs[number]()
        except Exception as error:  # noqa: BLE001  an unreadable file ends this job, not the others
            self.report(number, failed(error))
            return
        self.running.add(number)
        self.pool.submit(number, job, self._events.put)

    def _handle_event(self) -> None:
        """Wait for an event, and handle it."""
        try:
            event = self._events.get(timeout=TICK)
        except queue.Empty:
            event = NO_EVENT
        if event == REQUEST:
            self._request()
        elif event == NO_EVENT:
            self._check_pool()
        elif event in self.running:
            self.running.discard(event)
            self._end(event)

    def _end(self, number: int) -> None:
        """Report the outcome of a job that has ended, or keep it for another try."""
        try:
            outcome = self.pool.outcome(number)
        except Lost as error:
            self.running.add(number)
            self._give_up(Outcome(None, InvalidInput.exit_code, str(error)))
            return
        except Died as error:
            again = number in self.died
            self.died.add(number)
            if self.pool.retried_alone and not again and not self.stopping and number != PREPARATION:
                self.alone.append(number)
                self.report(number, None)
                return
            code = INTERRUPTED if self.stopping else FAULT
            outcome = Outcome(None, code, f"{error}{', and again when it was alone' if again else ''}")
        if number != PREPARATION:
            self.report(number, outcome)

    def _check_pool(self) -> None:
        """Give up if the pool is gone."""
        try:
            self.pool.check()
        except Lost as error:
            self._give_up(Outcome(None, InvalidInput.exit_code, str(error)))

    def _request(self) -> None:
        """Handle a request to end: the first lets running jobs end, the second ends them at once."""
        before, self._last_request = self._last_request, time.monotonic()
        if self._last_request - before <= SAME_REQUEST:
            return
        if self.stopping or PREPARATION in self.running:
            self.pool.close(kill=True)
            self._give_up(CUT_SHORT)
            return
        self.stopping = True
        self._drop(NOT_STARTED)
        self.pool.interrupt()

    def _drop(self, outcome: Outcome) -> None:
        """Report `outcome` for all waiting jobs and do not begin them."""
        while self.waiting:
            self.report(self.waiting.popleft(), outcome)
        while self.alone:
            self.report(self.alone.popleft(), Outcome(None, INTERRUPTED, "its process died; there was no second try"))

    def _give_up(self, outcome: Outcome) -> None:
        """Report `outcome` for all running and waiting jobs."""
        for number in sorted(self.running - {PREPARATION}):
            self.report(number, outcome)
        self.running.clear()
        self._drop(NOT_STARTED if outcome == CUT_SHORT else outcome)
