"""The sweeps of `adjoint` through the steps of a cloth that touches itself: one by one, each with its own pairs.

What zones join at the end of a step stands between the step and the state after it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clothfit.base.arrays import Array, Elements
from clothfit.engine import touching
from clothfit.engine.forces.selfcontact import zones
from clothfit.engine.rollout import Rollout, Taken, forms
from clothfit.engine.step import implicit
from clothfit.kernels.vectors import add, copy


def back(
    sweep: Callable[..., None], taken: Taken, chunk: Rollout, by_position: Array, tolerance: float,
    work: implicit.Workspace, after: int, state: tuple[Array, ...], grad: Elements,
) -> None:  # fmt: skip
    """Carry the gradient, `state`, from after a chunk to before it; see `adjoint.sweep_back`. `after` steps come from
    its beginning on.
    """
    nothing = np.zeros((2, *state[0].shape))
    for t in reversed(range(chunk.steps)):
        own = touching.taken(taken.at(chunk, t), work, chunk, t)
        add(1.0, by_position[t + 1], state[0])
        if own.zones is not None:
            zones.pull(own.zones, own.system.vertex, own.system.h, state[0], state[1], grad)
        sweep(*forms(own.system), own.part, nothing, 0, 1, tolerance, own.work, after - t - 1, *state, grad)


def forward(
    sweep: Callable[..., None], taken: Taken, chunk: Rollout, direction: Elements, tolerance: float,
    work: implicit.Workspace, state: tuple[Array, ...], change: Array,
) -> None:  # fmt: skip
    """Carry the change of a state from before a chunk to after it, all dx to `change`; see `adjoint.sweep_forward`."""
    for t in range(chunk.steps):
        own = touching.taken(taken.at(chunk, t), work, chunk, t)
        sweep(*forms(own.system), own.part, 0, 1, direction, tolerance, own.work, *state, change[t : t + 1])
        if own.zones is not None:
            zones.push(own.zones, own.system.vertex, own.system.h, direction, state[0], state[1])
            copy(state[0], change[t])
