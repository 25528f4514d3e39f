"""The sweeps of textbooks, to compare with the exact ones: they drop how a step's matrix changes with the state.

The fully implicit step solves M (v⁺ − v) = h f(x⁺, v⁺) with x⁺ = x + h v⁺. Its transpose, with the gradients x̄⁺, v̄⁺ by
the state after a step known, is

    (M − h ∂f/∂v − h² ∂f/∂x)ᵀ λ = v̄⁺ + h x̄⁺,      v̄ = M λ,      x̄ = x̄⁺ + h (∂f/∂x)ᵀ λ

with each cost's own ∂φ/∂x, ∂φ/∂v added to x̄⁺, v̄⁺. For costs of positions these are the equations of T. Stuyck, Cloth
Simulation for Computer Graphics, chapter 8, with v̂ = λ. The Jacobians are those at hand, K and D of the system that the
step was solved with. The exact transpose of that step (`implicit`) has the same matrix and differs in x̄, v̄ by

- how K and D change with the state: O(h²) a step, O(h) over a motion; nothing where forces are linear, or where
  Newton's iterations have converged;
- what K leaves out of ∂f/∂x: how drag and the damping of springs turn with the cloth, how a sphere's push does. This
  part stays for h → 0.

The gradient by parameters is λᵀ ∂r/∂p, as there. A motion of another integrator is swept as if its steps were implicit.
"""

from __future__ import annotations

from collections.abc import Collection

from clothfit.base.arrays import Array, Elements
from clothfit.derivative import adjoint
from clothfit.engine.forces import contact, total
from clothfit.engine.inputs.tables import pull_pins, set_direction, set_inputs, share_gradient
from clothfit.engine.solve import guess, linear, sparse
from clothfit.engine.step import implicit
from clothfit.engine.step.states import velocities, velocity
from clothfit.engine.system import IMPLICIT, System
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import add, add_mass, add_rows_dot, combine, copy, hold_fixed


def gradient(
    system: System,
    memory: adjoint.TrajectoryMemory,
    by_position: Array | adjoint.CostDerivative,
    tolerance: float,
    kinds: Collection[str] = (),
) -> Elements:
    """What `adjoint.gradient` returns, approximately."""
    return adjoint.gradient(system._replace(method=IMPLICIT), memory, by_position, tolerance, kinds, sweep_back)


def tangent(system: System, memory: adjoint.TrajectoryMemory, direction: Elements, tolerance: float) -> Array:
    """What `adjoint.tangent` returns, approximately: the transpose of `gradient`. Paths of pins do not change."""
    return adjoint.tangent(system._replace(method=IMPLICIT), memory, direction, tolerance, sweep_forward)


@kernel
def sweep_back(system, chunk, by_position, begin, end, tolerance, work, before, x_bar, v_bar, grad):
    """What `adjoint.sweep_back` does, approximately."""
    for t in range(end - 1, begin - 1, -1):
        add(1.0, by_position[t + 1], x_bar)
        v, w, k = velocity(chunk, t), velocities(chunk, t), chunk.used[t] - 1
        guess.next_guess(work.past, before + end - 1 - t, work.solution)
        set_inputs(system.inputs, system, chunk.first + t)
        contact.load_active(system.colliders, chunk, t)
        contact.turn_to(system.colliders, k)
        theta = chunk.theta[t]
        combine(theta, v_bar, theta * system.h, x_bar, work.w_bar)
        pullback(system, chunk.x[t], v, w[k], w[k - 1] if k > 0 else v, k > 0, tolerance, work, x_bar, v_bar, grad)
        share_gradient(system.inputs, system, t + chunk.first, grad)


@kernel
def pullback(system, x, v, w, u, later, tolerance, work, x_bar, v_bar, grad):
    """Carry work.w_bar (n, 3), the gradient by the velocity w after a step, whose last iteration begins at u, back: add
    to x_bar and `grad`, and overwrite v_bar.
    """
    h, mass, free = system.h, system.vertex.mass, system.vertex.free
    A, b, y, s, lam, stiff = work.A, work.b, work.y, work.s, work.solution, work.gy
    implicit.linearise(system, x, w, u, later, A, work.nothing, y, s)
    copy(work.w_bar, b)
    hold_fixed(free, b)
    linear.solve(A, b, tolerance, work.solver, lam, True)
    total.add_pullback(system, y, u, w, s, lam, h, grad, work.gy, work.gu)  # for `grad` alone
    add_rows_dot(-1.0, lam, w, grad.mass)
    add_rows_dot(1.0, lam, v, grad.mass)
    v_bar[:] = 0.0
    add_mass(mass, 1.0, lam, v_bar)
    # −h² K λ = A λ − M λ + h D λ
    sparse.multiply(A, lam, stiff)
    pull_pins(system.inputs, system, y, lam, A, work.w_bar, x_bar, b)
    add_pins(system.inputs, b, stiff)
    add_mass(mass, -1.0, lam, stiff)
    total.add_damping(system, y, u, h, lam, stiff)
    add(-1.0 / h, stiff, x_bar)


@kernel(absent=None)
def add_pins(inputs, coupled, out):
    """Add A_pf λ, which `pull_pins` left, to A λ at the pins."""
    if len(inputs.fitted.pin) == 0:
        return
    for i in inputs.pins:
        for c in range(3):
            out[i, c] += coupled[i, c]


@kernel
def sweep_forward(system, chunk, begin, end, direction, tolerance, work, dx, dv, change):
    """What `adjoint.sweep_forward` does, approximately."""
    for t in range(begin, end):
        v, w, k = velocity(chunk, t), velocities(chunk, t), chunk.used[t] - 1
        guess.next_guess(work.past, chunk.first + t, work.solution)
        set_inputs(system.inputs, system, chunk.first + t)
        contact.load_active(system.colliders, chunk, t)
        contact.turn_to(system.colliders, k)
        set_direction(system.inputs, system, chunk.first + t, direction)
        pushforward(system, chunk.x[t], v, w[k], w[k - 1] if k > 0 else v, k > 0, tolerance, work, dx, dv, direction)
        combine(chunk.theta[t], work.solution, 0.0, work.solution, dv)
        add(system.h, dv, dx)
        copy(dx, change[t])


@kernel
def pushforward(system, x, v, w, u, later, tolerance, work, dx, dv, direction):
    """Write dw, the change of the velocity after a step whose last iteration begins at u, to work.solution, a first
    guess of it before: A dw = M dv + h K dx + h ∂f/∂p dp.
    """
    h, mass = system.h, system.vertex.mass
    A, b, y, s, zero = work.A, work.b, work.y, work.s, work.gy
    implicit.linearise(system, x, w, u, later, A, work.nothing, y, s)
    sparse.multiply(A, dx, b)
    add_mass(mass, -1.0, dx, b)
    total.add_damping(system, y, u, h, dx, b)
    combine(-1.0 / h, b, 0.0, b, b)
    add_mass(mass, 1.0, dv, b)
    add_mass(direction.mass, 1.0, v, b)
    add_mass(direction.mass, -1.0, w, b)
    zero[:] = 0.0
    total.add_pushforward(system, y, u, w, s, zero, zero, direction, h, b)
    hold_fixed(system.vertex.free, b)
    linear.solve(A, b, tolerance, work.solver, work.solution, True)
