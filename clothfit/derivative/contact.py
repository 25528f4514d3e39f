"""The sweeps of `adjoint` and `sensitivity` through the steps of a cloth that touches itself: one by one, each with its
own pairs; what zones join at the end of a step stands between the step and the state after it.

In a step of `sensitivity` pairs are added one by one, in all columns together. A pair joins four vertices that no
spring may join, and which are others in each step: `step_jacobian` finds the derivative without pairs,
and each pair is probed for itself, for 12 × 12 numbers by its positions and as many by its velocities.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clothfit.base.arrays import Array, Elements, Indices
from clothfit.engine import contact_steps
from clothfit.engine.forces import contact as contacts
from clothfit.engine.forces.selfcontact import pairs, zones
from clothfit.engine.forces.selfcontact.zones import add_row
from clothfit.engine.rollout import Rollout, Taken, forms
from clothfit.engine.solve import linear
from clothfit.engine.step import implicit
from clothfit.engine.system import IMPLICIT, System
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import add, copy


class Columns:
    """The pairs of a cloth's steps in the columns of its sensitivity."""

    def __init__(self, system: System, place: Indices, row: Elements) -> None:
        """`place` (n,) of each vertex among the free ones, −1 of a fixed one; `row` is scratch."""
        self.place, self.row, self.scratch = place, row, np.zeros((3, len(place), 3))
        self.without = pairs.none(contact_steps.surface_of(system, 0, system.x0))

    def bare(self, system: System) -> System:
        """A system without its pairs."""
        return system._replace(contact=self.without)

    def add(
        self, system: System, work: implicit.Workspace, velocities: tuple[Array, Array, bool], dy: Array, du: Array,
        right: Array,
    ) -> None:  # fmt: skip
        """Write the whole matrix to the workspace, and add what the pairs have in the right-hand side; `velocities` are
        u, w and whether the iteration is a later one. The workspace has y and s.
        """
        assert system.contact is not None
        u, w, later = velocities
        if system.method == IMPLICIT:
            implicit.assemble(system, work.y, u, later, work.A, work.nothing)
        damped = later or system.method != IMPLICIT
        at = work.y, u, w, work.s
        add_pairs(system.contact, at, system.h, damped, self.scratch, self.row, self.place, (dy, du, right))


@kernel
def add_pairs(contact, at, h, damped, scratch, row, place, columns):
    """out += h (∂F/∂y dy + ∂F/∂u du) of all pairs, with y, u, w, s `at` (n, 3), and dy, du, out the `columns`
    (3 f, Q).
    """
    dy, du, out = columns
    by_y, by_u = np.zeros((12, 12)), np.zeros((12, 12))
    for k in range(len(contact.kind)):
        if not contact.on[contact.turn[0], k]:
            continue
        own = contact.vertices[k]
        differentiate(contact, k, at, h, damped, scratch, row, by_y, by_u)
        for e in range(12):
            to = place[own[e // 3]]
            if to < 0:
                continue
            sums = out[3 * to + e % 3]
            for g in range(12):
                j = place[own[g // 3]]
                if j < 0:
                    continue
                add_row(by_y[e, g], dy[3 * j + g % 3], sums)
                add_row(by_u[e, g], du[3 * j + g % 3], sums)


@kernel
def differentiate(contact, k, at, h, damped, scratch, row, by_y, by_u):
    """Fill by_y and by_u, h ∂F/∂y and h ∂F/∂u of pair k with a row for each component of the force, where `damped` with
    h D in by_u; `scratch` (3, n, 3) is 0 at first and at the end.
    """
    y, u, w, s = at
    lam, gy, gu = scratch[0], scratch[1], scratch[2]
    own = contact.vertices[k]
    for e in range(12):
        lam[own[e // 3], e % 3] = 1.0
        contacts.pull_row(contact, k, y, u, w, s, lam, h, row, gy, gu)
        if damped:
            contacts.damp_row(contact, k, y, u, h, lam, gu)
        lam[own[e // 3], e % 3] = 0.0
        for g in range(12):
            i, c = own[g // 3], g % 3
            by_y[e, g], by_u[e, g] = gy[i, c], gu[i, c]
            gy[i, c], gu[i, c] = 0.0, 0.0


def back(
    sweep: Callable[..., None], taken: Taken, chunk: Rollout, by_position: Array, tolerance: float,
    work: implicit.Workspace, after: int, state: tuple[Array, ...], grad: Elements,
) -> None:  # fmt: skip
    """Carry the gradient, `state`, from after a chunk to before it; see `adjoint.sweep_back`. `after` steps come from
    its beginning on.
    """
    nothing = np.zeros((2, *state[0].shape))
    for t in reversed(range(chunk.steps)):
        own = contact_steps.taken(taken.at(chunk, t), work, chunk, t)
        add(1.0, by_position[t + 1], state[0])
        if own.zones is not None:
            zones.pull(own.zones, own.system.vertex, own.system.h, state[0], state[1], grad)
        with linear.served(own.work.A, own.work.solver):
            sweep(*forms(own.system), own.part, nothing, 0, 1, tolerance, own.work, after - t - 1, *state, grad)


def forward(
    sweep: Callable[..., None], taken: Taken, chunk: Rollout, direction: Elements, tolerance: float,
    work: implicit.Workspace, state: tuple[Array, ...], change: Array,
) -> None:  # fmt: skip
    """Carry the change of a state from before a chunk to after it, all dx to `change`; see `adjoint.sweep_forward`."""
    for t in range(chunk.steps):
        own = contact_steps.taken(taken.at(chunk, t), work, chunk, t)
        with linear.served(own.work.A, own.work.solver):
            sweep(*forms(own.system), own.part, 0, 1, direction, tolerance, own.work, *state, change[t : t + 1])
        if own.zones is not None:
            zones.push(own.zones, own.system.vertex, own.system.h, direction, state[0], state[1])
            copy(state[0], change[t])
