"""The sweeps of `adjoint` and `sensitivity` through the steps of a cloth that touches itself: one by one, each with its
own pairs; what zones join at the end of a step stands between the step and the state after it.

In a step of `sensitivity` pairs are added one by one, in all columns together. A pair joins four vertices that no
spring may join, and which are others in each step: `step_jacobian` finds the derivative without pairs,
and each pair is probed for itself, for 12 × 12 numbers by its positions and as many by its velocities.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Elements, Indices
from clothfit.engine import touching
from clothfit.engine.forces.selfcontact import force, pairs, zones
from clothfit.engine.forces.selfcontact.zones import centre, masses
from clothfit.engine.rollout import Rollout, Taken, forms
from clothfit.engine.step import implicit
from clothfit.engine.system import IMPLICIT, System
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import add, copy


class Local(NamedTuple):
    """Memory for one pair, its vertices numbered 0 to 3; (4, 3) where nothing else is said."""

    contact: force.Contact  # of the pair alone
    y: Array
    u: Array
    w: Array
    s: Array
    lam: Array
    gy: Array
    gu: Array
    by_y: Array  # (12, 12), h ∂F/∂y: a row for each component of the force
    by_u: Array  # (12, 12), h ∂F/∂u


def local() -> Local:
    """Memory for a pair."""
    own = np.arange(4, dtype=np.int32).reshape(1, 4)
    one = force.Contact(own, np.zeros(1, np.int32), np.zeros(1), np.zeros(1), np.ones(4), 0.0, 0.0)
    y, u, w, s, lam, gy, gu = np.zeros((7, 4, 3))
    return Local(one, y, u, w, s, lam, gy, gu, np.zeros((12, 12)), np.zeros((12, 12)))


class Columns:
    """The pairs of a cloth's steps in the columns of its sensitivity."""

    def __init__(self, system: System, place: Indices, row: Elements) -> None:
        """`place` (n,) of each vertex among the free ones, −1 of a fixed one; `row` is scratch."""
        self.place, self.row, self.local = place, row, local()
        self.without = pairs.none(touching.surface_of(system))

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
        law = system.contact
        one = self.local.contact._replace(stiffness=law.stiffness, friction=law.friction)
        if system.method == IMPLICIT:
            implicit.assemble(system, work.y, u, later, work.A, work.nothing)
        damped = later or system.method != IMPLICIT
        at = work.y, u, w, work.s
        add_pairs(law, at, system.h, damped, self.local._replace(contact=one), self.row, self.place, (dy, du, right))


@kernel
def add_pairs(contact, at, h, damped, local, row, place, columns):
    """out += h (∂F/∂y dy + ∂F/∂u du) of all pairs, with y, u, w, s `at` (n, 3), and dy, du, out the `columns`
    (3 f, Q).
    """
    dy, du, out = columns
    for k in range(len(contact.kind)):
        own = contact.vertices[k]
        gather(contact, k, at, local)
        differentiate(h, damped, local, row)
        for e in range(12):
            to = place[own[e // 3]]
            if to < 0:
                continue
            sums = out[3 * to + e % 3]
            for g in range(12):
                j = place[own[g // 3]]
                if j < 0:
                    continue
                add_row(local.by_y[e, g], dy[3 * j + g % 3], sums)
                add_row(local.by_u[e, g], du[3 * j + g % 3], sums)


@kernel
def add_row(factor, row, out):
    """out += factor · row."""
    if factor != 0.0:
        for q in range(len(out)):
            out[q] += factor * row[q]


@kernel
def gather(contact, k, at, local):
    """Write pair k to the memory for one."""
    y, u, w, s = at
    one = local.contact
    one.kind[0], one.thickness[0], one.side[0] = contact.kind[k], contact.thickness[k], contact.side[k]
    for e in range(4):
        i = contact.vertices[k, e]
        for c in range(3):
            local.y[e, c], local.u[e, c], local.w[e, c], local.s[e, c] = y[i, c], u[i, c], w[i, c], s[i, c]


@kernel
def differentiate(h, damped, local, row):
    """Fill by_y and by_u of the pair, where `damped` with h D in by_u."""
    one, y, u, w, s, lam, gy, gu, by_y, by_u = local
    for e in range(12):
        lam[:] = 0.0
        lam[e // 3, e % 3] = 1.0
        gy[:] = 0.0
        gu[:] = 0.0
        force.add_pullback(one, y, u, w, s, lam, h, row, gy, gu)
        if damped:
            force.add_damping(one, y, u, h, lam, gu)
        for g in range(12):
            by_y[e, g], by_u[e, g] = gy[g // 3, g % 3], gu[g // 3, g % 3]


@kernel
def join(zones, vertex, place, h, share, dx, dv):
    """What `zones.push` does, for all columns (3 f, Q); `share` has those of the masses."""
    mean, change = np.zeros(3), np.zeros((3, dx.shape[1]))
    for z in range(len(zones.first) - 1):
        mass, fixed = masses(zones, vertex, z)
        centre(zones, vertex, z, mean)
        change[:] = 0.0
        for e in range(zones.first[z], zones.first[z + 1]):
            i = zones.member[e]
            if vertex.free[i] and fixed == 0:
                for c in range(3):
                    add_row(vertex.mass[i] / mass, dv[3 * place[i] + c], change[c])
                    for entry in range(share.start[i], share.start[i + 1]):
                        if share.column[entry] >= 0:
                            more = share.factor[entry] * (zones.found[e, c] - mean[c]) / mass
                            change[c, share.column[entry]] += more
        for e in range(zones.first[z], zones.first[z + 1]):
            i = zones.member[e]
            if vertex.free[i]:
                for c in range(3):
                    add_row(h, change[c], dx[3 * place[i] + c])
                    add_row(-h, dv[3 * place[i] + c], dx[3 * place[i] + c])
                    dv[3 * place[i] + c] = change[c]


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
