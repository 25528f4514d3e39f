"""The explicit and the symplectic Euler steps.

    explicit:    x⁺ = x + h v,    v⁺ = v + h M⁻¹ f(x, v)
    symplectic:  v⁺ = v + h M⁻¹ f(x, v),    x⁺ = x + h v⁺

Both solve r = M (v⁺ − v) − h f(x, v) = 0, the implicit step with A = M: their derivatives are those of −λᵀ r with
λ = M⁻¹ v̄⁺ (explicit) or M⁻¹ (v̄⁺ + h x̄⁺) (symplectic). The functions of the forces serve here as well, at y = x,
u = w = v, s = 0: their gu is the derivative of the step's model by u, ∂f/∂u − D, and `add_damping` puts D back.
Arrays are (n, 3); fixed vertices stay.
"""

from __future__ import annotations

from clothfit.engine.forces import total
from clothfit.engine.inputs.tables import move_pins, pull_sent, send_changes, send_pins, set_pins
from clothfit.engine.system import SYMPLECTIC
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import add, add_mass, add_rows_dot, combine, copy, hold_fixed


@kernel
def divide_by_mass(vertex, a):
    """a ← M⁻¹ a, and 0 at fixed vertices."""
    for i in range(len(a)):
        scale = 1.0 / vertex.mass[i] if vertex.free[i] else 0.0
        for c in range(3):
            a[i, c] *= scale


@kernel
def step(system, x, v, v_new, x_new):
    """Write the new velocity and positions."""
    v_new[:] = 0.0
    total.add_force(system, x, v, v_new)
    divide_by_mass(system.vertex, v_new)
    combine(system.h, v_new, 1.0, v, v_new)
    if system.method == SYMPLECTIC:
        set_pins(system.inputs, system, x, v_new)
        combine(1.0, x, system.h, v_new, x_new)
    else:
        send_pins(system.inputs, system, v_new)
        combine(1.0, x, system.h, v, x_new)


@kernel
def pullback(system, x, v, v_new, work, x_bar, v_bar, grad):
    """Turn x_bar, v_bar, the gradient by the state after the step, into that before it; add to `grad`."""
    h, lam, s, gy, gu = system.h, work.solution, work.s, work.gy, work.gu
    copy(v_bar, lam)
    if system.method == SYMPLECTIC:
        add(h, x_bar, lam)
    divide_by_mass(system.vertex, lam)
    s[:] = 0.0
    gy[:] = 0.0
    gu[:] = 0.0
    total.add_pullback(system, x, v, v, s, lam, h, grad, gy, gu)
    total.add_damping(system, x, v, h, lam, gu)
    add_rows_dot(-1.0, lam, v_new, grad.mass)
    add_rows_dot(1.0, lam, v, grad.mass)
    pull_sent(system.inputs, system, x_bar, v_bar, system.method != SYMPLECTIC)
    add(h, x_bar, v_bar)
    add(1.0, gu, v_bar)
    add(1.0, gy, x_bar)


@kernel
def pushforward(system, x, v, v_new, work, dx, dv, direction):
    """Turn dx, dv, the change of the state before the step, into that after it, for the change `direction`."""
    h, dw, s = system.h, work.solution, work.s
    s[:] = 0.0
    dw[:] = 0.0
    add_mass(direction.mass, 1.0, v, dw)
    add_mass(direction.mass, -1.0, v_new, dw)
    total.add_pushforward(system, x, v, v, s, dx, dv, direction, h, dw)
    total.add_damping(system, x, v, h, dv, dw)
    divide_by_mass(system.vertex, dw)
    add(1.0, dv, dw)
    hold_fixed(system.vertex.free, dw)
    if system.method == SYMPLECTIC:
        move_pins(system.inputs, system, dx, dw)
        add(h, dw, dx)
    else:
        send_changes(system.inputs, system, dw)
        add(h, dv, dx)
    copy(dw, dv)
