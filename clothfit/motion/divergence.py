"""Where a simulation diverged, and the states before that.

A dump is an `.npz` of the cloth that diverged first, with n vertices and S springs: its last good states and the first
bad one, F in all. `positions` and `velocities` (F, n, 3), m and m/s; `steps` (F,), 0 at the start, and `times` (F,), s;
`springs` (S, 2), the vertices that each joins, and `stretch` (F, S), their length by rest length; `object`, the index
of the cloth, and `vertex`, the one that diverged first; `delta`, s. Only the last state has values that are not finite.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base import npz
from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import ClothfitError
from clothfit.base.writing import Data
from clothfit.engine.rollout import Rollout
from clothfit.engine.stability import NO_REST, advice
from clothfit.scene.kinds import REST
from clothfit.scene.scene import Scene

if TYPE_CHECKING:
    from clothfit.motion.motion import Motion

STATES_KEPT = 8
"""The most good states to keep."""

OVERSTRETCHED = 10.0
"""A spring this many times as long as at rest belongs to no believable cloth."""


class States(NamedTuple):
    """Successive states of a cloth with n vertices."""

    steps: Indices  # (F,), 0 at the start
    x: Array  # (F, n, 3), m
    v: Array  # (F, n, 3), m/s


class Fault(NamedTuple):
    """A divergence."""

    cloth: int  # its index
    states: States  # the last good ones and the first bad one

    @property
    def vertex(self) -> int:
        """The vertex that diverged first."""
        return worst(self.states.x[-1], self.states.v[-2])


def of_object(scene: Scene, fault: Fault) -> Fault:
    """A divergence of cloths that are simulated together as that of the one which diverged first."""
    cloth, vertex = scene.place_of(fault.cloth, fault.vertex)
    first, states = fault.vertex - vertex, fault.states
    part = slice(first, first + scene.vertex_counts[cloth])
    return Fault(cloth, states._replace(x=states.x[:, part], v=states.v[:, part]))


class Diverged(ClothfitError):
    """A simulation that diverged: a position is not finite, or 10¹² m away. Exit code 4.

    `step` is the first step that cannot be used (1 is the first; 0 where no single step is to blame). `motion` holds
    the frames before it and `fault` the last states of the cloth that diverged; both may be None.
    """

    exit_code = 4

    def __init__(self, message: str, step: int, motion: Motion | None = None, fault: Fault | None = None) -> None:
        self.step = step
        self.motion = motion
        self.fault = fault
        super().__init__(message)


def worst(x: Array, v: Array) -> int:
    """The vertex that is farthest off in a bad state x (n, 3). A linear solve spreads what is not finite over the whole
    cloth at once: of several such vertices, the one that was fastest before, v (n, 3).
    """
    size = np.abs(x).sum(axis=1)
    lost = ~np.isfinite(size)
    if not lost.any():
        return int(np.argmax(size))
    with np.errstate(over="ignore", invalid="ignore"):
        speed = np.abs(v).sum(axis=1)
    return int(np.argmax(np.where(lost, np.nan_to_num(speed, nan=0.0), -1.0)))


def last_states(part: Rollout, before: States | None) -> States:
    """The last states up to the end of a part of a simulation; `before` are those up to its beginning."""
    first = max(0, part.steps + 1 - STATES_KEPT)
    steps = np.arange(first, part.steps + 1, dtype=np.int32)
    after = np.maximum(steps, 1) - 1  # the steps that end there
    v = part.w[after, part.used[after] - 1] if part.steps else part.v[None].copy()
    v[steps == 0] = part.v
    own = States(part.first + steps, part.x[first:].copy(), v)
    if before is None or first > 0:
        return own
    kept = slice(max(0, len(own.steps) - 1 + len(before.steps) - STATES_KEPT), -1)  # its last state is the first of own
    return following(States(before.steps[kept], before.x[kept], before.v[kept]), own)


def following(one: States, other: States) -> States:
    """The states of both, one after the other."""
    return States(
        np.concatenate([one.steps, other.steps]), np.concatenate([one.x, other.x]), np.concatenate([one.v, other.v])
    )


def with_bad(states: States, x: Array, v: Array) -> States:
    """The states, and a bad one after them."""
    return following(states, States(states.steps[-1:] + np.int32(1), x[None], v[None]))


def outcome(scene: Scene, motion: Motion, fault: Fault) -> Diverged:
    """The error for a motion that has only its good frames; its message says what to do."""
    step, cloth = len(motion.times), fault.cloth
    if scene.method == REST:
        return Diverged(f"{scene.name}: objects[{cloth}]: {NO_REST}", step, motion, fault)
    place = f"objects[{cloth}], vertex {fault.vertex} of {scene.vertex_counts[cloth]}"
    begins, hint = overstretched_from(scene, cloth, motion.of(cloth)), advice(scene, cloth)
    more = hint if begins is None else f"{overstretched(begins)}; {hint}"
    message = f"{scene.name}: the simulation diverged at step {step} (t = {step * scene.delta:.4g} s), {place}; {more}"
    return Diverged(message, step, motion, fault)


def overstretched_from(scene: Scene, cloth: int, x: Array) -> int | None:
    """The first frame from which some spring stays overstretched to the end of positions x (frames, n, 3)."""
    ends, rest = scene.cloths[cloth].springs, scene.cloths[cloth].rest
    frame = len(x)
    while frame and (stretch(x[frame - 1], ends, rest) > OVERSTRETCHED).any():
        frame -= 1
    return frame if frame < len(x) else None


def overstretched(step: int) -> str:
    """The words for that in messages."""
    return f"from step {step} on springs are more than {OVERSTRETCHED:g} times as long as at rest"


def stretch(x: Array, ends: Indices, rest: Array) -> Array:
    """Length by rest length (…, S) of springs (S, 2) at positions x (…, n, 3)."""
    with np.errstate(over="ignore", invalid="ignore"):
        e = x[..., ends[:, 0], :] - x[..., ends[:, 1], :]
        return np.asarray(np.sqrt((e * e).sum(axis=-1)) / rest)


def dump(scene: Scene, fault: Fault) -> Data:
    """What writes the states of a fault to a file, as the module's docstring describes it."""
    states, cloth = fault.states, scene.cloths[fault.cloth]
    arrays: dict[str, NDArray[Any]] = {
        "positions": states.x,
        "velocities": states.v,
        "steps": states.steps,
        "times": scene.delta * states.steps,
        "springs": cloth.springs,
        "stretch": stretch(states.x, cloth.springs, cloth.rest),
        "object": np.array(fault.cloth),
        "vertex": np.array(fault.vertex),
        "delta": np.array(scene.delta),
    }
    return npz.archive(arrays)
