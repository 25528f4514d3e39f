"""One fit as data, which any process or machine can do, and its outcome.

A job holds the contents of its files instead of paths, so that another machine can do it. A fit that fails raises
nothing: its outcome holds the exit code and the message of a command that failed in this way.
"""

from __future__ import annotations

import io
import os
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.base.messages import unreadable
from clothfit.base.reading import unchanged
from clothfit.base.version import __version__
from clothfit.fit.options import Request
from clothfit.optimise.status import Status
from clothfit.scene.text import name_of

if TYPE_CHECKING:
    import numpy as np

    from clothfit.base.arrays import Array
    from clothfit.fit.result import Fit
    from clothfit.objective.experiment import Recorded, Targets
    from clothfit.optimise.checkpoint import Checkpoint
    from clothfit.scene.scene import Scene

EXIT_CODES = {Status.CONVERGED: 0, Status.STALLED: 5, Status.LIMIT: 5, Status.INTERRUPTED: 130, Status.DIVERGED: 4}
"""Exit codes by the status of a fit."""

NEVER_FINITE = "no values that were tried gave a simulation that stays finite; nothing is written"
FAULT, INTERRUPTED = 1, 130
"""Exit codes where there is no fit."""

PREPARATION = -1
"""The number of what precedes all jobs."""


class Died(Exception):
    """A worker process ended during a job; the message is a sentence for the user."""


class Lost(Exception):
    """All workers are out of reach; the message is a sentence for the user."""


class File(NamedTuple):
    """The content of a file, and its name for messages."""

    data: bytes
    name: str
    folder: str | None = None  # that paths in it are relative to; None: the current one


JobTarget: TypeAlias = "tuple[File | Recorded, File | None]"
"""A target, and the scene it was recorded in if that is another one."""


@dataclass(frozen=True)
class Job:
    """One fit."""

    scene: File
    targets: tuple[JobTarget, ...] = ()  # none: the scene's own motion
    start: float | Array | File | None = None
    number: int = 0  # of the start (`numbered`)
    seed: int = 0
    options: Request = field(default_factory=Request)
    checkpoint: Checkpoint | None = None
    resume: bool = False
    version: str = __version__  # of the program that made the job


@dataclass(frozen=True)
class Outcome:
    """How a job ended."""

    fit: Fit | None  # None where it failed
    exit_code: int  # of a command that ends so
    error: str | None = None  # a sentence why there is nothing to write; None if a result can be written
    checkpointed: bool = False  # whether its checkpoint was written

    @property
    def usable(self) -> bool:
        """Whether there is a result to write."""
        return self.fit is not None and self.error is None

    @property
    def status(self) -> str:
        """That of the fit; where there is none: "failed", "diverged", "interrupted", "written" before."""
        if self.fit is not None:
            return self.fit.status
        if self.exit_code == 0:
            return "written"
        if self.exit_code == INTERRUPTED:
            return "not started" if self == NOT_STARTED else "interrupted"
        return "diverged" if self.exit_code == EXIT_CODES[Status.DIVERGED] else "failed"


NOT_STARTED = Outcome(None, INTERRUPTED, "not started")


def read_file(path: str | os.PathLike[str]) -> File:
    """A file as a job carries it. Raises InvalidInput."""
    from clothfit.base.npz import content

    try:
        with unchanged(path) as file:
            return File(content(file), name_of(path), os.path.dirname(os.path.abspath(os.fspath(path))))
    except (OSError, ValueError) as error:
        raise InvalidInput(f"{name_of(path)}: {unreadable(error)}") from None


def run(job: Job) -> Outcome:
    """Do a job. KeyboardInterrupt ends it with the best so far; nothing is ever raised."""
    try:
        return finished(job, fitted(job))
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001  other jobs go on
        return failed(error)


def finished(job: Job, fit: Fit) -> Outcome:
    """The outcome of a job whose fit returned."""
    error = f"{fit.scene.name}: {NEVER_FINITE}" if fit.status == Status.DIVERGED else None
    return Outcome(fit, EXIT_CODES[fit.status], error, job.checkpoint is not None and job.checkpoint.written)


def failed(error: BaseException) -> Outcome:
    """The outcome of a job that raised."""
    if isinstance(error, ClothfitError):
        return Outcome(None, error.exit_code, str(error))
    if isinstance(error, KeyboardInterrupt):
        return Outcome(None, INTERRUPTED, "interrupted before there was a result")
    if isinstance(error, MemoryError):
        return Outcome(None, FAULT, "out of memory; try fewer frames (optimizationIterations)")
    return Outcome(None, FAULT, f"a fault of the program: {type(error).__name__}: {error}")


def fitted(job: Job) -> Fit:
    """Do the fit of a job."""
    from clothfit.base import threads
    from clothfit.fit.estimate import by_request
    from clothfit.scene.bounds import from_user

    if job.version != __version__:
        raise InvalidInput(f"this worker has clothfit {__version__}, the job comes from {job.version}; install one")
    with threads.single():
        scene = loaded(job.scene).with_bounds(from_user(job.options.bounds or {}))
        targets = [target_of(item, scene) for item in job.targets] or None
        first = loaded(job.start) if isinstance(job.start, File) else job.start
        start = numbered(scene, targets, first, job.number, job.seed, job.options.tolerance)
        return by_request(scene, targets, start, replace(job.options, checkpoint=job.checkpoint, resume=job.resume))


def target_of(item: JobTarget, scene: Scene) -> Recorded | tuple[Recorded, Scene]:
    """A target as `estimate` takes it."""
    from clothfit.motion.motion import load_motion

    motion, other = item
    own = scene if other is None else loaded(other)
    recorded = load_motion(io.BytesIO(motion.data), own, motion.name) if isinstance(motion, File) else motion
    return recorded if other is None else (recorded, own)


class Named(io.BytesIO):
    """An open file in memory that has a name."""

    name = ""


def loaded(file: File) -> Scene:
    """The scene in a file."""
    from clothfit.scene.scene import load

    opened = Named(file.data)
    opened.name = file.name
    return load(opened, folder=file.folder)


# ---- Several starts for one fit: where one ends in a poor minimum, another may not.
#
# Start number 0 is the one that a fit takes anyway. Each other start multiplies the masses, stiffnesses and lengths of
# a cloth by one factor per kind, drawn log-uniformly between 1/10 and 10, and shifts values that may be negative by up
# to their typical size. A start depends only on the seed and its number, so the fifth of eight is also the fifth of a
# hundred. Values that are not identifiable stay as they are.

FACTOR = 10.0


def numbered(
    scene: Scene, target: Targets | None, start: float | Array | Scene | None, number: int, seed: int,
    tolerance: float | None = None,
) -> float | Array | Scene | None:
    """The start with that number: `start` itself for 0, else a scene with drawn values.

    They are drawn around `start`. Without one they are drawn around the scene's values, or, where these are the hidden
    truth (`target` is None), around the best values of a coarse search. `tolerance` is that of the fit.
    """
    if number == 0:
        return start
    import numpy as np

    from clothfit.base.limits import FIT_TOLERANCE, checked_tolerance
    from clothfit.fit.start import choose_start
    from clothfit.motion.simulate import simulate_cloths
    from clothfit.objective.objective import Objective
    from clothfit.scene.fit_vector import fitted_cloths, with_parameters

    twin = target is None
    if target is None:
        target = simulate_cloths(scene, fitted_cloths(scene), tolerance=checked_tolerance(tolerance, FIT_TOLERANCE))
    middle = choose_start(Objective(scene, target), start, twin)
    return with_parameters(scene, drawn(scene, middle, np.random.default_rng([seed, number])))


def drawn(scene: Scene, middle: Array, draw: np.random.Generator) -> Array:
    """Draw values (P,) around `middle` (P,), within the bounds."""
    import numpy as np

    from clothfit.objective.identifiability import identifiable
    from clothfit.scene.fit_vector import bounds, parameters

    p = middle.copy()
    lower, upper = bounds(scene)
    for block in scene.blocks:
        kind, part = block.kind, block.part
        if kind.log:
            p[part] *= np.where(block.constant, FACTOR ** draw.uniform(-1.0, 1.0), 1.0)
        else:
            steps = draw.uniform(-1.0, 1.0, kind.components)
            p[part] += np.resize(steps, block.count) * max(kind.scale, float(np.abs(middle[part]).max()))
    return np.where(identifiable(scene), np.clip(p, lower, upper), parameters(scene))
