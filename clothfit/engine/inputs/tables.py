"""Inputs at every step of a motion, and how a step reads them.

The forces read wind, gravity and the places of spheres from arrays of the System; `set_inputs` writes their values for
a step into these arrays, before the step and before each of its derivatives. A pinned vertex p goes to its place x_p in
a step that begins at x: its velocity in the step's equation is w_p = (x_p − x)/h, the derivative of the path as the
integrator takes derivatives. In A w = b the rows of the free vertices get −A_fp w_p on the right; the derivatives need
nothing else, as they are taken force by force, at velocities that those of the pins belong to.

Where the paths of pins are fitted, the free vertices get −A_fp (dw_p − du_p) on the right in the tangent, du_p where K
acts on the velocity that an iteration starts from, and in the transpose P, the place after the step, and x_p get the
gradient w̄_p − A_pf λ over h, with both signs. After an explicit Euler step it is w_p = (P′ − P)/h, with P′ the place
one step later. The changes of P and P′ stand in `fitted_paths.FittedPaths`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import NO_NUMBERS, NO_TABLE, NO_VECTORS, Array, Elements, Flags, Indices
from clothfit.engine.forces import springs
from clothfit.engine.forces.collider_rows import PLACE, STATE, let_go
from clothfit.engine.inputs import fitted_paths
from clothfit.engine.inputs.fitted_paths import FittedPaths, moves, pull_places, push_places
from clothfit.engine.inputs.poses import Poses, pose
from clothfit.engine.solve.sparse import add_across
from clothfit.kernels.kernel import kernel, record
from clothfit.kernels.lanes.operations import add, load3, store3
from clothfit.kernels.vectors import combine, copy

NOBODY, NO_ROWS = np.zeros(0, np.int32), np.zeros((0, 0))


@record
class Inputs(NamedTuple):
    """Row r of a table holds at time r h; a table without rows does not change anything. A scene in which nothing
    changes, and without colliders, has None in place of it, so that nothing of this module is compiled for it.
    """

    wind: Array = NO_VECTORS  # (R, 3), m/s, what is added to the scene's
    gravity: Array = NO_VECTORS  # (R, 3), m/s², the same
    centre: Array = NO_TABLE  # (R, C + 8 D, 3), m, of C spheres, then the states (8, 3) of D other colliders
    path: Array = NO_TABLE  # (R, P, 3), m, of the pins
    pins: Indices = NOBODY  # (P,), their vertices
    coupled: Indices = NOBODY  # the springs of which one end is such a vertex and the other is free
    wind_base: Array = NO_NUMBERS  # (3,), m/s, of the scene
    gravity_base: Array = NO_NUMBERS  # (3,), m/s²
    fitted: FittedPaths = FittedPaths()  # pins whose paths are fitted
    gusts: Array = NO_VECTORS  # (K, 3), m/s, the values of the wind's keys where they are fitted; else none
    share: Array = NO_ROWS  # (R, K), of each of them in a row of `wind`
    counted: Array = NO_NUMBERS  # (3,), the gradient by the wind up to the step that was swept last
    place: Array = NO_VECTORS  # (P, 3), m, where the pins are after the step that is computed
    later: Array = NO_VECTORS  # (P, 3), m, where they are one step after that
    drift: Array = NO_VECTORS  # (n, 3), m/s, of the scene's axes where each vertex starts; none where they are still
    force: Array = NO_TABLE  # (T, n, 3), N, applied in each step; none where there are none
    gain: Array = NO_ROWS  # (T, n), N/m, of springs that pull the vertices; none where there are none
    target: Array = NO_TABLE  # (T, n, 3), m, to where, after each step
    lead: int = 1  # rows by which the forces of a step are ahead of it: 1 for the implicit methods, else 0
    steps: int = 0  # that the tables have rows for
    poses: Poses = Poses()  # of the meshes that change
    energetic: bool = True  # whether anything else than the applied forces may bring energy


def check_steps(inputs: Inputs | None, steps: int) -> None:
    """Raise IndexError where a motion has more steps than the tables."""
    if inputs is not None and steps > inputs.steps:
        raise IndexError(f"{steps} steps, with inputs for {inputs.steps}")


def pushed_and_pulled(inputs: Inputs) -> tuple[int, int]:
    """How many vertices forces are applied to, and how many are pulled to given places: all or none."""
    return inputs.force.shape[1], inputs.gain.shape[1]


def later(inputs: Inputs | None, steps: int) -> Inputs | None:
    """The inputs of a motion that begins so many steps later."""
    if inputs is None:
        return None
    tables = ("wind", "gravity", "centre", "path", "share", "force", "gain", "target")
    parts = {name: getattr(inputs, name)[steps:] for name in tables}
    own = inputs.poses
    poses = own._replace(first=own.first[steps:], weight=own.weight[steps:])
    fitted = fitted_paths.later(inputs.fitted, steps)
    return inputs._replace(**parts, fitted=fitted, steps=inputs.steps - steps, poses=poses)


def with_offset(inputs: Inputs | None, spheres: int, offset: Array) -> Inputs | None:
    """The inputs with all of so many spheres, and all other colliders, moved by an offset (3,), m."""
    if inputs is None or not len(inputs.centre):
        return inputs
    centre = inputs.centre.copy()
    centre[:, :spheres] += offset
    centre[:, spheres + PLACE :: STATE] += offset
    return inputs._replace(centre=centre)


@kernel(absent=None, apart=None)
def set_inputs(inputs, system, t):
    """Write the inputs of step t of a motion to where the forces read them, and where the pins are after it."""
    late = t + inputs.lead
    if len(inputs.wind) > 0:
        add_row(inputs.wind, late, inputs.wind_base, system.faces.wind)
    if len(inputs.gravity) > 0:
        add_row(inputs.gravity, late, inputs.gravity_base, system.vertex.gravity)
    if len(inputs.centre) > 0:
        copy(inputs.centre[late], system.spheres.centre)
        states = inputs.centre[late, len(system.spheres.centre) :]
        for c in range(len(system.colliders.rows)):
            copy(states[c * STATE :], system.colliders.rows[c, :STATE])
    pose(inputs.poses, system.colliders, late, inputs.lead, system.h)
    let_go(system.colliders, late * system.h)
    if len(inputs.path) > 0:
        copy(inputs.path[t + 1], inputs.place)
        copy(inputs.path[t + 1 if inputs.lead else t + 2], inputs.later)
    if len(inputs.force) > 0:
        copy(inputs.force[t], system.applied.force)
    if len(inputs.gain) > 0:
        for i in range(inputs.gain.shape[1]):  # see `copy`
            system.applied.gain[i] = inputs.gain[t, i]
        copy(inputs.target[t], system.applied.place)


@kernel(absent=None, apart=None)
def share_gradient(inputs, system, t, grad):
    """Give what step t added to the gradient by the wind to the keys of the wind, that by the pins' places to the keys
    of their paths, and that by the applied forces to its row of their table.
    """
    if len(grad.force) > 0:
        copy(system.applied.bar, grad.force[t])
        system.applied.bar[:] = 0.0
    if len(grad.gusts) > 0:
        row = inputs.share[t + inputs.lead]
        for c in range(3):
            more = grad.wind[c] - inputs.counted[c]
            inputs.counted[c] = grad.wind[c]
            for k in range(len(row)):
                grad.gusts[k, c] += row[k] * more
    if len(inputs.fitted.pin) > 0:
        pull_places(inputs.fitted, t + 1, inputs.fitted.change, grad)
        if not inputs.lead:
            pull_places(inputs.fitted, t + 2, inputs.fitted.change_later, grad)


@kernel(absent=None, apart=None)
def set_direction(inputs, system, t, direction):
    """Write the change of the wind in step t: that of its keys, the first K rows of `gusts`, and in the last row what
    is the same all the time; and that of the places of the pins and of the applied forces.
    """
    if len(direction.force) > 0:
        copy(direction.force[t], system.applied.change)
    if len(direction.gusts) > 0:
        row = inputs.share[t + inputs.lead]
        for c in range(3):
            change = direction.gusts[len(row), c]
            for k in range(len(row)):
                change += row[k] * direction.gusts[k, c]
            direction.wind[c] = change
    if len(inputs.fitted.pin) > 0:
        push_places(inputs.fitted, t + 1, direction, inputs.fitted.change)
        push_places(inputs.fitted, t + 1 if inputs.lead else t + 2, direction, inputs.fitted.change_later)


def with_constant(direction: Elements) -> Elements:
    """A direction as `set_direction` wants it, its own arrays for what that writes."""
    if not len(direction.gusts):
        return direction
    constant = direction.wind if len(direction.wind) else np.zeros(3)
    return direction._replace(gusts=np.vstack([direction.gusts, constant]), wind=np.zeros(3))


@kernel(absent=False)
def energetic(inputs):
    """Whether anything that changes may bring energy, applied forces apart."""
    return inputs.energetic


@kernel(absent=False)
def draws(inputs, applied):
    """Whether paths of pins are fitted, or vertices are pulled to places, by the tables or, as long as it holds one, by
    a hand.
    """
    return len(inputs.fitted.pin) > 0 or inputs.gain.shape[1] > 0 or (applied.gain > 0.0).any()


@kernel(absent=0.0)
def power(inputs, t, v):
    """What the forces that are applied in step t do at velocities v (n, 3), W."""
    if len(inputs.force) == 0:
        return 0.0
    total = 0.0
    for i in range(len(v)):
        for c in range(3):
            total += inputs.force[t, i, c] * v[i, c]
    return total


@kernel
def work(inputs, t, x, x_new):
    """What they do on the way from x to x_new, (n, 3), J."""
    return power(inputs, t, x_new) - power(inputs, t, x)


@kernel(absent=None)
def set_frame(inputs, system, t):
    """The same for the state before step t of a motion."""
    set_inputs(inputs, system, t - inputs.lead)


@kernel
def add_row(table, row, base, out):
    """out (3,) = base + a row of the table."""
    for c in range(3):
        out[c] = base[c] + table[row, c]


@kernel(absent=None)
def set_pins(inputs, system, x, w):
    """The velocities w (n, 3) of the pins in a step that begins at x, by the h of the system."""
    lead_pins(inputs.pins, inputs.place, x, system.h, w)


@kernel
def lead_pins(pins, places, x, h, w):
    """w = (places − x)/h of the pins that have places (P, 3), x and w (n, 3)."""
    for p in range(len(places)):
        i = pins[p]
        for c in range(3):
            w[i, c] = (places[p, c] - x[i, c]) / h


@kernel
def send(pins, later, now, h, w):
    """w = (later − now)/h of the pins that have places (P, 3), w (n, 3)."""
    for p in range(len(later)):
        for c in range(3):
            w[pins[p], c] = (later[p, c] - now[p, c]) / h


@kernel(absent=None)
def send_pins(inputs, system, w):
    """The velocities w (n, 3) of the pins after an explicit Euler step: those with which the next one moves them."""
    send(inputs.pins, inputs.later, inputs.place, system.h, w)


@kernel(absent=None)
def place_pins(inputs, system, x):
    """Put the pins where they are after the step: no rounding adds up."""
    for p in range(len(inputs.pins)):
        i = inputs.pins[p]
        for c in range(3):
            x[i, c] = inputs.place[p, c]


@kernel(absent=None)
def add_coupling(inputs, system, y, w, to_pins, b):
    """b −= A_fp w_p for the velocities of the pins in w, with A linearised at y, (n, 3) each; `to_pins`, b −= A_pf w_f.
    """
    coupled = inputs.coupled
    for c in range(len(coupled)):
        i = coupled[c]
        for end in range(2):
            pin, other = system.springs.ends[i, end], system.springs.ends[i, 1 - end]
            if not system.vertex.free[pin]:
                source, to = (other, pin) if to_pins else (pin, other)
                pull = springs.pull_of(system.springs, y, i, system.h, load3(w, source))
                store3(add(load3(b, to), pull), b, to)


@kernel(absent=None, apart=None)
def couple(inputs, system, x, y, scratch, A, b):
    """The same for a step that begins at x, contacts included; `scratch` (n, 3) is overwritten."""
    if len(inputs.pins) > 0:
        scratch[:] = 0.0
        set_pins(inputs, system, x, scratch)
        add_coupling(inputs, system, y, scratch, False, b)
        add_across(A, scratch, False, b)


@kernel(absent=None, apart=None)
def couple_change(inputs, system, w, u, later, y, scratch, b):
    """The same for velocities w, of a `later` iteration for their change from u."""
    if len(inputs.pins) > 0:
        combine(1.0, w, -1.0 if later else 0.0, u, scratch)
        add_coupling(inputs, system, y, scratch, False, b)


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
    add_coupling(inputs, system, y, scratch, False, b)
    add_across(A, scratch, False, b)


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
    add_coupling(inputs, system, y, lam, True, coupled)
    add_across(A, lam, True, coupled)
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
