"""Fit many scenes, each from one or several starts; the start with the lowest cost gives the result.

The results do not depend on the number of processes, on the order in which they end, or on where they run, as long as
the machines round alike.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from clothfit.base.errors import InvalidInput
from clothfit.base.memory import budget
from clothfit.fit.options import FitOptions, Request, requested
from clothfit.many.batch import Batch, Pool
from clothfit.many.job import INTERRUPTED, File, Job, JobTarget, Outcome, loaded, read_file

if TYPE_CHECKING:
    from clothfit.base.arrays import Array
    from clothfit.fit.result import Fit
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


def limited(options: Request, pool: Pool) -> Request:
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
    cluster: str | None = None, done: Callable[[int, Result], None] | None = None, method: str = "auto",
    model: str | None = None, time_limit: str | float | None = None,
    options: FitOptions = FitOptions(),  # noqa: B008 (it is frozen)
) -> list[Result]:
    """Fit several scenes, each in a process of its own; returns a `Result` for each, in their order.

    `targets` has one item per scene, as `estimate` takes it, or a path (default: the scenes' own motions). Each scene
    is fitted from `starts` starting points, drawn with `seed`; the one with the lowest cost is its result. The fits run
    on `jobs` processes (default: one per core), or on a Dask `cluster`, "tcp://host:port". `done` is called with index
    and result when a scene is fitted. All else is that of `estimate`. A scene that fails has the error in its result
    and does not stop the others. Raises InvalidInput when there is no such cluster, or an argument is impossible.
    """
    check_numbers(starts, seed, jobs)
    if options.checkpoint is not None or options.resume:
        raise InvalidInput("checkpoint: is for one fit, not for many")
    asked = requested(options, method=method, model=model, time_limit=time_limit)
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
        return read_file(scene)
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
    return read_file(motion) if foreign(motion) is None else load_motion(motion, loaded(packed(scene)))
