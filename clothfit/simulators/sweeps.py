"""A whole motion of a model of XPBD: its positions, their change, and the gradient of a cost of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.base.limits import FARTHEST
from clothfit.base.memory import check_memory
from clothfit.kernels.kernel import kernel
from clothfit.simulators.substep import (
    History,
    Model,
    Values,
    history,
    pullback,
    pushforward,
    step,
    workspace,
    zeros,
)  # fmt: skip


def simulate(model: Model, frames: int) -> tuple[Array, int]:
    """Positions (frames, n, 3), m, and how many of them are good: fewer where the motion runs away."""
    check_memory(frames, len(model.x0), 0)
    positions, none, work = np.empty((frames, *model.x0.shape)), nothing(), workspace(model)
    x, v = model.x0.copy(), model.v0.copy()
    positions[0] = x
    for t in range(frames - 1):
        advance(model, t, x, v, work, none)
        interrupts.check()
        if not np.abs(x).max(initial=0.0) < FARTHEST:
            return positions, t + 1
        positions[t + 1] = x
    return positions, frames


def tangent(model: Model, direction: Values, frames: int) -> Array:
    """The change (frames, n, 3) of the positions along a direction in the values."""
    changes, work = np.zeros((frames, *model.x0.shape)), workspace(model)
    x, v = model.x0.copy(), model.v0.copy()
    dx, dv = np.zeros_like(x), np.zeros_like(v)
    for t in range(frames - 1):
        push(model, direction, t, x, v, dx, dv, work)
        interrupts.check()
        changes[t + 1] = dx
    return changes


def gradient(model: Model, frames: int, by_positions: Callable[[Array], Array]) -> Values:
    """The gradient by all values of a cost, of which `by_positions` gives the derivative (frames, n, 3) by the
    positions (frames, n, 3).
    """
    check_memory(frames, len(model.x0), 1)
    states, work, past = np.empty((frames, 2, *model.x0.shape)), workspace(model), history(model)
    states[0] = model.x0, model.v0
    none = nothing()
    for t in range(frames - 1):
        states[t + 1] = states[t]
        advance(model, t, states[t + 1, 0], states[t + 1, 1], work, none)
        interrupts.check()
    bars, grad = by_positions(states[:, 0]), zeros(model)
    x_bar, v_bar = np.zeros_like(model.x0), np.zeros_like(model.x0)
    starts = np.empty((model.substeps, 2, *model.x0.shape))
    for t in range(frames - 2, -1, -1):
        x_bar += bars[t + 1]
        starts[0] = states[t]
        pull(model, t, starts, x_bar, v_bar, grad, work, past)
        interrupts.check()
    grad.inverse[~model.free] = 0.0
    return grad


def nothing() -> History:
    """A history that keeps nothing."""
    return History(np.zeros((0, 0, 4, 3)), np.zeros((0, 0)), np.zeros((0, 0, 0, 4)))


@kernel
def advance(model, t, x, v, work, none):
    """Take step t."""
    for s in range(model.substeps):
        step(model, t, s, x, v, work, none)


@kernel
def push(model, direction, t, x, v, dx, dv, work):
    """Take step t, and turn the change of the state before it into that after it."""
    for s in range(model.substeps):
        pushforward(model, direction, t, s, x, v, dx, dv, work)


@kernel
def pull(model, t, starts, x_bar, v_bar, grad, work, past):
    """Turn the gradient by the state after step t into that before it, which is the first of `starts`, (substeps, 2, n,
    3); the others are overwritten. Adds to `grad`.
    """
    for s in range(model.substeps - 1):
        starts[s + 1] = starts[s]
        step(model, t, s, starts[s + 1, 0], starts[s + 1, 1], work, past)
    for s in range(model.substeps - 1, -1, -1):
        pullback(model, t, s, starts[s, 0], starts[s, 1], x_bar, v_bar, grad, work, past)
