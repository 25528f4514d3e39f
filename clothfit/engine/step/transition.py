"""One time step by the method that the scene names; its transpose and its tangent.

Here, and only here, the three integration methods part. The velocities of a step's iterations are w (N, n, 3), of which
`used` count; the explicit methods have one.
"""

from __future__ import annotations

from clothfit.engine.inputs.tables import send_pins, set_pins
from clothfit.engine.step import explicit, implicit
from clothfit.engine.system import EXPLICIT, IMPLICIT
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import combine


@kernel
def prepare(system, x, v, work):
    """What a step from this state begins with; of an implicit one, returns what `guard` needs to know of the state."""
    return implicit.prepare(system, x, v, work) if system.method == IMPLICIT else (0.0, 0.0)


@kernel
def step(system, x, v, first, tolerance, work, w, x_new):
    """Write w and the new positions, from a first guess of the velocity, once prepared.

    Returns the iterations used, 0 where the step is to be taken with the clamped system; the CG iterations and the
    direct solves.
    """
    used, iterations, direct = 1, 0, 0
    if system.method == IMPLICIT:
        used, iterations, direct = implicit.step(system, x, v, first, tolerance, work, w)
    else:
        explicit.step(system, x, v, w[0])
        if system.method == EXPLICIT:
            send_pins(system.inputs, system, w[0])
        else:
            set_pins(system.inputs, system, x, w[0])
    moving = v if system.method == EXPLICIT else w[used - 1]
    combine(1.0, x, system.h, moving, x_new)
    return used, iterations, direct


@kernel
def pullback(system, x, v, w, used, theta, tolerance, work, x_bar, v_bar, grad):
    """Turn x_bar, v_bar (n, 3), the gradient by the state after the step, into that before it; add to `grad`."""
    if system.method == IMPLICIT:
        implicit.pullback(system, x, v, w, used, theta, tolerance, work, x_bar, v_bar, grad)
    else:
        explicit.pullback(system, x, v, w[0], work, x_bar, v_bar, grad)


@kernel
def pushforward(system, x, v, w, used, theta, tolerance, work, dx, dv, direction):
    """Turn dx, dv (n, 3), the change of the state before the step, into that after it, for the change `direction`."""
    if system.method == IMPLICIT:
        implicit.pushforward(system, x, v, w, used, theta, tolerance, work, dx, dv, direction)
    else:
        explicit.pushforward(system, x, v, w[0], work, dx, dv, direction)
