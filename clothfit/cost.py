"""How far a motion is from the target: G = Σ_frames Σ_vertices |x − x*|² over what was observed, and ∂G/∂x.

Reported error (independent of the number of frames and vertices): RMSE = sqrt(G / number of observed positions), m.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.arrays import Array, Flags, Indices
from clothfit.errors import InvalidMotion
from clothfit.kernel import kernel
from clothfit.motion import Motion

TIME_SLACK = 1e-3
"""How far from a multiple of the time step a target's frame may be, in steps: time steps are float32 in many files."""

MOST_STEPS = 2**31 - 1
"""Steps are counted in 32 bits."""


class Target(NamedTuple):
    """What one cloth should do: F frames of n vertices."""

    step: Indices  # (F,), the step each frame is compared with; 0 is the initial state
    positions: Array  # x*, (F, n, 3), m; 0 where not observed
    observed: Flags  # (F, n)


def frame_steps(motion: Motion, delta: float) -> Indices:
    """The step of each frame of a motion, for time step `delta`. Raises InvalidMotion for times between steps."""
    steps = motion.times / delta
    whole = np.rint(steps)
    if whole[-1] > MOST_STEPS:
        raise InvalidMotion(f"{motion.name}: times[{len(whole) - 1}]: {motion.times[-1]:.6g} s is too many steps away")
    wrong = ~((np.abs(steps - whole) <= TIME_SLACK) & (whole >= 0))
    if wrong.any():
        frame = int(np.argmax(wrong))
        raise InvalidMotion(
            f"{motion.name}: times[{frame}]: {motion.times[frame]:.6g} s is not 0 or a multiple of "
            f"the scene's delta, {delta:.6g} s"
        )
    if (np.diff(whole) <= 0).any():
        raise InvalidMotion(f"{motion.name}: times: several frames fall on one step of {delta:.6g} s")
    return whole.astype(np.int32)


def target(motion: Motion, cloth: int, delta: float, last_step: int | None = None) -> Target:
    """The part of a motion that concerns one cloth, up to step `last_step`."""
    steps = frame_steps(motion, delta)
    kept = slice(None) if last_step is None else slice(int(np.searchsorted(steps, last_step, side="right")))
    observed = np.ascontiguousarray(motion.seen(cloth)[kept])
    positions = np.where(observed[:, :, None], motion.of(cloth)[kept], 0.0)
    return Target(steps[kept], positions, observed)


def cost(x: Array, goal: Target) -> float:
    """G of positions x (T + 1, n, 3)."""
    return float(accumulate(x, goal, np.empty((0, 0, 0))))


def cost_and_derivative(x: Array, goal: Target) -> tuple[float, Array]:
    """G of positions x (T + 1, n, 3), and ∂G/∂x of the same shape."""
    derivative = np.zeros_like(x)
    return float(accumulate(x, goal, derivative)), derivative


@kernel
def accumulate(x, goal, derivative):
    """G; writes ∂G/∂x unless `derivative` is empty."""
    total = 0.0
    for frame in range(len(goal.step)):
        t = goal.step[frame]
        for i in range(x.shape[1]):
            if goal.observed[frame, i]:
                for c in range(3):
                    gap = x[t, i, c] - goal.positions[frame, i, c]
                    total += gap * gap
                    if len(derivative) > 0:
                        derivative[t, i, c] = 2.0 * gap
    return total
