"""How a step's derivatives pass through pins whose paths are fitted.

A pin's velocity in a step is w_p = (P − x_p)/h, P its place after the step. In the tangent the free vertices get
−A_fp (dw_p − du_p) on the right, du_p where K acts on the velocity that an iteration starts from, and in the transpose
P and x_p get the gradient w̄_p − A_pf λ over h, with both signs. After an explicit Euler step it is w_p = (P′ − P)/h,
with P′ the place one step later. The changes of P and P′ stand in `fitted_paths.FittedPaths`.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array, Elements, Flags
from clothfit.engine.forces import springs
from clothfit.engine.inputs.fitted_paths import moves, pull_places, push_places
from clothfit.engine.inputs.tables import Inputs, add_coupling, lead_pins, send
from clothfit.engine.solve.joined import add_across
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, load3, store3


def led(inputs: Inputs | None, n: int) -> Flags:
    """Which of n vertices are pins whose paths are fitted."""
    found = np.zeros(n, bool)
    if inputs is not None and len(inputs.fitted.pin):
        found[inputs.pins[inputs.fitted.pin >= 0]] = True
    return found


def forget(inputs: Inputs | None) -> None:
    """Make all changes 0."""
    if inputs is not None:
        inputs.fitted.change[:] = inputs.fitted.change_later[:] = 0.0


def push_start(inputs: Inputs | None, h: float, direction: Elements, dx: Array, dv: Array) -> None:
    """Write the change of the pins at the start, along a direction, to dx and dv (n, 3)."""
    if inputs is None or not len(inputs.fitted.pin):
        return
    now, then = np.zeros_like(inputs.fitted.change), np.zeros_like(inputs.fitted.change)
    push_places(inputs.fitted, 0, direction, now)
    push_places(inputs.fitted, 1, direction, then)
    dx[inputs.pins], dv[inputs.pins] = now, (then - now) / h


def pull_start(inputs: Inputs | None, h: float, x_bar: Array, v_bar: Array, grad: Elements) -> None:
    """Add to `grad` what the gradient by the state at the start, (n, 3) each, makes of it."""
    if inputs is None or not len(inputs.fitted.pin):
        return
    by_velocity = v_bar[inputs.pins] / h
    pull_places(inputs.fitted, 0, x_bar[inputs.pins] - by_velocity, grad)
    pull_places(inputs.fitted, 1, by_velocity, grad)


def moves_of(inputs: Inputs, row: int, directions: list[Elements]) -> Array:
    """Changes (P, 3, Q) of the places of the pins at a row of the tables along Q directions."""
    keys = [each.path if len(each.path) else np.zeros_like(inputs.fitted.keys) for each in directions]
    offsets = [each.shift if len(each.shift) else np.zeros(3) for each in directions]
    return moves(inputs.fitted, row, np.stack(keys, axis=-1), np.stack(offsets, axis=-1))


@kernel(absent=None, apart=None)
def push_pins(inputs, system, y, dx, du, later, scratch, A, b):
    """b −= A_fp (dw_p − du_p) of an iteration at y, du_p of a `later` one alone; `scratch` (n, 3) is overwritten."""
    if len(inputs.fitted.pin) == 0:
        return
    scratch[:] = 0.0
    for p in range(len(inputs.pins)):
        i = inputs.pins[p]
        for c in range(3):
            scratch[i, c] = (inputs.fitted.change[p, c] - dx[i, c]) / system.h
            if later:
                scratch[i, c] -= du[i, c]
    add_coupling(inputs, system, y, scratch, b)
    add_across(A.joined, -1.0, scratch, False, b)


@kernel(absent=None)
def move_pins(inputs, system, dx, dw):
    """Write the change of the pins' velocities in a step to dw, for the change dx of where it begins, (n, 3) each."""
    lead_pins(inputs.pins, inputs.fitted.change, dx, system.h, dw)


@kernel(absent=None)
def send_changes(inputs, system, dw):
    """The same for the velocities after an explicit Euler step."""
    send(inputs.pins, inputs.fitted.change_later, inputs.fitted.change, system.h, dw)


@kernel(absent=None, apart=None)
def pull_pins(inputs, system, y, lam, A, w_bar, x_bar, coupled):
    """Turn w_bar at the pins, the gradient by their velocity in an iteration at y, into that by their places before the
    step, in x_bar, and after it; leaves A_pf λ in `coupled`, (n, 3) each.
    """
    if len(inputs.fitted.pin) == 0:
        return
    coupled[:] = 0.0
    for c in range(len(inputs.coupled)):
        i = inputs.coupled[c]
        for end in range(2):
            pin, other = system.springs.ends[i, end], system.springs.ends[i, 1 - end]
            if not system.vertex.free[pin]:
                pull = springs.pull_of(system.springs, y, i, system.h, load3(lam, other))
                store3(add(load3(coupled, pin), pull), coupled, pin)
    add_across(A.joined, -1.0, lam, True, coupled)
    for p in range(len(inputs.pins)):
        i = inputs.pins[p]
        for c in range(3):
            rest = (w_bar[i, c] + coupled[i, c]) / system.h
            coupled[i, c] = -coupled[i, c]
            inputs.fitted.change[p, c] += rest
            x_bar[i, c] -= rest


@kernel(absent=None)
def pull_through(inputs, coupled, w_bar):
    """Add A_pf λ to the gradient by the velocity that a later iteration starts from."""
    for p in range(len(inputs.fitted.pin)):
        i = inputs.pins[p]
        for c in range(3):
            w_bar[i, c] += coupled[i, c]


@kernel(absent=None, apart=None)
def pull_sent(inputs, system, x_bar, v_bar, explicit):
    """What an explicit Euler step does with the gradient by the state of the pins after it; without `explicit` a
    symplectic one. x_bar, v_bar (n, 3) get h x_bar added to v_bar later.
    """
    h, fitted = system.h, inputs.fitted
    for p in range(len(fitted.pin)):
        i = inputs.pins[p]
        for c in range(3):
            if explicit:
                fitted.change_later[p, c] += v_bar[i, c] / h
                fitted.change[p, c] -= v_bar[i, c] / h
                v_bar[i, c] = 0.0
            else:
                fitted.change[p, c] += v_bar[i, c] / h + x_bar[i, c]
                x_bar[i, c] = -v_bar[i, c] / h
