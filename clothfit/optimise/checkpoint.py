"""What a fit keeps to go on from after it was killed (`base.checkpoint` has the file).

A fit that is resumed does not repeat its way: it restarts the stage that it was in (`fit.routes`), the first model
of the hierarchy that it had not finished, or the optimiser, from the best values, with the prior that it had learned.
It counts evaluations and seconds from its first beginning. So it comes to the same minimum, not to the same last bits.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from clothfit.base import checkpoint as files
from clothfit.base.arrays import Array
from clothfit.base.checkpoint import digest
from clothfit.base.errors import InvalidInput
from clothfit.engine.inputs.sampling import arrays_from_files
from clothfit.objective.experiment import Experiment
from clothfit.optimise.status import ModelFit, Status
from clothfit.scene.factors import FACTOR_MODES
from clothfit.scene.kinds import INTEGRATORS, KIND
from clothfit.scene.scene import Scene, dumps

FIT = "fit"
"""The kind of file."""


class State(NamedTuple):
    """What a fit goes on from; P parameters, of which Q are fitted."""

    start: Array  # (P,), where the fit began
    best: Array  # (P,)
    cost: float  # of the best point
    gradient: Array  # (P,), of that, as far as it is known
    centre: Array  # (Q,), coordinates around which the prior scatters; (0,) without one
    tau: tuple[float, ...]  # its widths
    y: Array  # (Q,), from where Gauss–Newton goes on; (0,) where it is not under way, as `before`
    radius: float  # of its trust region; 0: not chosen yet
    window: int  # frames that it compares
    before: Array  # (P,), the best point before it
    before_cost: float
    history: Sequence[float]  # best cost at each evaluation
    beside: int  # further simulations
    seconds: float  # that the fit has taken
    warnings: Sequence[str]
    status: Status | None = None  # None while it runs
    model: str = ""  # that was chosen for the fit, a letter; none was where it is empty
    substeps: int = 0  # that were chosen, steps to a frame of the target; 0: the scene's own step
    integrator: int = 0  # their method
    rungs: Sequence[ModelFit] = ()  # the models that were fitted from coarse to fine, to their end
    best_centre: Array = np.zeros(0)  # as `centre`, of the prior that the best point was found with
    best_tau: tuple[float, ...] = ()
    left_out: Sequence[str] = ()  # kinds that the fit has chosen not to fit


class Checkpoint(files.Checkpoint):
    """Where a fit keeps what it needs to go on."""

    kind = FIT

    def save(self, state: Callable[[], State], now: bool = False) -> None:
        """Write the state, if not `now`, then only where it is time; a fault is a warning, for the fit goes on."""
        self.keep(lambda: state()._asdict(), now)

    def read(self, count: int) -> State:
        """The state of a fit of so many parameters. Raises InvalidInput when the file is not there, is damaged or
        belongs to another fit.
        """
        state = understood(self.state(), self.name)
        if not (state.model or state.left_out) and len(state.best) != count:
            raise InvalidInput(files.impossible(FIT, self.name))
        return state


def opened(
    checkpoint: str | os.PathLike[str] | Checkpoint | None, resume: bool, identity: Mapping[str, str], count: int
) -> tuple[Checkpoint | None, State | None]:
    """The checkpoint of a fit of so many parameters, and the state to go on from where it is resumed.

    Raises InvalidInput.
    """
    if checkpoint is None:
        if resume:
            raise InvalidInput("resume: a checkpoint is needed, the file to resume from")
        return None, None
    file = checkpoint if isinstance(checkpoint, Checkpoint) else Checkpoint(checkpoint)
    file.check()
    file.identity = dict(identity)
    return file, file.read(count) if resume else None


def decoded(data: bytes, name: str) -> tuple[dict[str, str], State]:
    """Identity and state in the bytes of a file, called `name` in messages. Raises InvalidInput."""
    identity, state, _ = files.decoded(FIT, data, name)
    return identity, understood(state, name)


def understood(values: Mapping[str, Any], name: str) -> State:
    """The state of a fit in a file, called `name` in messages. Raises InvalidInput where no fit can have come to it."""
    try:
        state = State(**{name: read(values[name]) for name, read in READ.items()})
        possible = is_possible(state)
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError, OverflowError):  # not by `encoded`
        possible = False
    if not possible:
        raise InvalidInput(files.impossible(FIT, name))
    return state


ARRAYS = ("start", "best", "gradient", "centre", "y", "before", "best_centre")

READ: dict[str, Callable[[Any], Any]] = {
    **dict.fromkeys(ARRAYS, lambda values: np.array(values, float)),
    **dict.fromkeys(("cost", "before_cost", "radius", "seconds"), float),
    **dict.fromkeys(("tau", "best_tau", "history"), lambda values: tuple(map(float, values))),
    **dict.fromkeys(("window", "beside", "substeps", "integrator"), int),
    "warnings": lambda texts: [str(text) for text in texts],
    "left_out": lambda names: tuple(map(str, names)),
    "status": lambda status: None if status is None else Status(status),
    "model": str,
    "rungs": lambda rows: [ModelFit(str(m), int(n), float(e), np.array(p, float), float(s)) for m, n, e, p, s in rows],
}
"""Each field of a state from what a file has. Raises one of several errors where that is of another type."""


def is_possible(state: State) -> bool:
    """Whether a fit can have come to a state."""
    arrays: list[Array] = [getattr(state, name) for name in ARRAYS]
    return (
        all(array.ndim == 1 and bool(np.isfinite(array).all()) for array in arrays)
        and len(state.start) == len(state.best) == len(state.gradient)
        and len(state.before) in (0, len(state.best))
        and len(state.y) in (0, len(state.centre))
        and all(0 <= number < math.inf for number in (state.cost, state.radius, state.seconds))
        and state.before_cost >= 0
        and all(width > 0 for width in (*state.tau, *state.best_tau))
        and not any(math.isnan(cost) for cost in state.history)
        and all(text.isprintable() for text in state.warnings)
        and min(state.window, state.beside, state.substeps) >= 0
        and state.integrator in range(len(INTEGRATORS))
        and state.model in ("", *FACTOR_MODES, "L")
        and all(name in KIND for name in state.left_out)
        and all(is_possible_level(level, len(state.best)) for level in state.rungs)
    )


def is_possible_level(level: ModelFit, count: int) -> bool:
    """Whether a model of a fit of so many parameters can have come to this."""
    return (
        level.model in (*FACTOR_MODES, "G", "L")
        and level.values >= 0
        and min(level.rmse, level.seconds) >= 0
        and math.isfinite(level.seconds)
        and level.p.shape == (count,)
        and bool(np.isfinite(level.p).all())
    )


def identity(scene: Scene, targets: Sequence[Experiment] | None, start: object, **options: object) -> dict[str, str]:
    """What must be the same for a fit to go on: a text for each thing, a digest where it is large.

    `targets` None: the scene's own motion; `start` as `fit.estimate` takes it; `options`: whatever else changes the
    way of a fit.
    """
    compared = "the scene's own motion"
    if targets is not None:
        parts: list[bytes | Array] = []
        for target in targets:
            motion = target.motion
            given = (motion.positions, motion.times, motion.observed, motion.weights, motion.radii)
            parts += [np.zeros(0) if array is None else np.asarray(array, float) for array in given]
            parts.append(b"" if target.scene is scene else dumps(target.scene))
            parts += [] if target.scene is scene else arrays_from_files(target.scene)
        compared = digest(*parts)
    first = dumps(start) if isinstance(start, Scene) else start
    if isinstance(first, (bytes, np.ndarray, list, tuple)):
        first = digest(first if isinstance(first, bytes) else np.asarray(first, float))
    texts = {name.replace("_", " "): plainly(value) for name, value in options.items()}
    own = {"scene": digest(dumps(scene)), "target": compared, "start": plainly(first)}
    files = arrays_from_files(scene)
    inputs = {"input files": digest(*files)} if files else {}
    return {**own, **inputs, **texts}


def plainly(value: object) -> str:
    """A text for a value of an option; numbers that are equal have the same."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name}={plainly(each)}" for name, each in value.items())
    if callable(value):
        function = getattr(value, "function", value)
        return f"{function.__module__}.{getattr(function, '__qualname__', type(function).__qualname__)}"
    return repr(float(value)) if isinstance(value, (int, float)) else str(value)
