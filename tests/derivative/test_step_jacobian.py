"""The matrices of one step against its tangent and against central differences of what it solves."""

import numpy as np
import pytest
from helpers import physics
from helpers.physics import METHODS, TIGHT, gentle, relative

from clothfit.derivative.stencil import stencil
from clothfit.derivative.step_jacobian import differentiate, differentiate_globally, jacobian
from clothfit.engine.march import velocity
from clothfit.engine.rollout import rollout
from clothfit.engine.step import explicit, implicit
from clothfit.engine.system import EXPLICIT, IMPLICIT, zeros

pytestmark = pytest.mark.slow  # compiles a fit

VARIANTS = [("explicit", 1), ("symplectic", 1), ("implicit", 1), ("implicit", 3)]
STEP = 4  # of which the matrices are taken: the cloth is moving by then


def moving(method, newton=1):
    """A system, its motion, and the state before step STEP."""
    system = gentle(method, newton)
    memory, good = rollout(system, STEP + 1, TIGHT)
    assert good == STEP + 1
    return system, memory, memory.x[STEP], velocity(memory, STEP)


def blocks_times(near, blocks, d):
    """B d (n, 3) for blocks (E, 3, 3) on the stencil."""
    out = np.zeros_like(d)
    for i in range(len(d)):
        for e in range(near.start[i], near.start[i + 1]):
            out[i] += blocks[e] @ d[near.neighbour[e]]
    return out


def elements_times(system, step, change):
    """C dp (n, 3) of masses, stiffnesses and rest lengths."""
    out = step.by_mass * change.mass[:, None]
    for values, by_element in ((change.stiffness, step.by_stiffness), (change.rest, step.by_rest)):
        for value, rows, ends in zip(values, by_element, system.springs.ends, strict=True):
            out[ends] += value * rows
    return out


def only(system, *kinds):
    """A random change of some kinds, 0 or none for the others."""
    full, none = physics.direction(system), zeros(system, ["rest"])
    return none._replace(**{kind: getattr(full, kind) for kind in kinds})


def assembled(system, memory, dx, dv, change):
    """What `differentiate` says of the step: its velocity's change (n, 3)."""
    x, v, h = memory.x[STEP], velocity(memory, STEP), system.h
    near, work, step = stencil(system, 2), implicit.workspace(system), jacobian(system, stencil(system, 2), True)
    free, dw = np.repeat(system.vertex.free, 3), dv
    for k in range(memory.used[STEP]):
        w = memory.w[STEP, k]
        u = v if k == 0 else memory.w[STEP, k - 1]
        differentiate(system, near, x, v, w, u, k, work, step)
        du = dw
        dy = dx if k == 0 else dx + h * du
        right = blocks_times(near, step.by_y, dy) + blocks_times(near, step.by_u, du)
        right += system.vertex.mass[:, None] * dv + elements_times(system, step, change)
        A = physics.dense_matrix(work.A)[np.ix_(free, free)]
        dw = np.zeros(3 * len(x))
        dw[free] = np.linalg.solve(A, right.reshape(-1)[free])
        dw = dw.reshape(-1, 3)
    return dw


def swept(system, memory, dx, dv, change):
    """The change of the velocity by the tangent of the step."""
    work, dx, dv = implicit.workspace(system), dx.copy(), dv.copy()
    x, v = memory.x[STEP], velocity(memory, STEP)
    if system.method == IMPLICIT:
        implicit.pushforward(system, x, v, memory.w[STEP], memory.used[STEP], 1.0, TIGHT, work, dx, dv, change)
    else:
        explicit.pushforward(system, x, v, memory.w[STEP, 0], work, dx, dv, change)
    return dv


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
@pytest.mark.parametrize("what", ["x", "v", "mass", "stiffness", "rest", "all"])
def test_the_matrices_give_the_tangent_of_the_step(what, method, newton):
    system, memory, x, _ = moving(method, newton)
    dx, dv = np.random.default_rng(3).normal(size=(2, *x.shape)) * system.vertex.free[:, None]
    dx, dv = dx * (what in ("x", "all")), dv * (what in ("v", "all"))
    kinds = ("mass", "stiffness", "rest") if what == "all" else {"x": (), "v": ()}.get(what, (what,))
    change = only(system, *kinds)
    found = assembled(system, memory, dx, dv, change)
    # linear systems are solved to 1e-14, of a condition below 100, up to three in a row
    assert relative(found, swept(system, memory, dx, dv, change)) < 1e-11


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
@pytest.mark.parametrize("kind", ["damping", "drag", "wind", "gravity"])
def test_kinds_that_act_everywhere_give_the_tangent_of_the_step(kind, method, newton):
    system, memory, x, v = moving(method, newton)
    change, nothing = only(system, kind), np.zeros_like(x)
    work, out, dw, free = implicit.workspace(system), np.zeros_like(x), nothing, np.repeat(system.vertex.free, 3)
    near, step = stencil(system, 2), jacobian(system, stencil(system, 2))
    for k in range(memory.used[STEP]):
        w, u = memory.w[STEP, k], v if k == 0 else memory.w[STEP, k - 1]
        differentiate(system, near, x, v, w, u, k, work, step)
        differentiate_globally(system, x, v, w, u, k, work, change, out)
        right = out + blocks_times(near, step.by_y, (k > 0) * system.h * dw) + blocks_times(near, step.by_u, dw)
        A, dw = physics.dense_matrix(work.A)[np.ix_(free, free)], np.zeros(free.size)
        dw[free] = np.linalg.solve(A, right.reshape(-1)[free])
        dw = dw.reshape(-1, 3)
    assert relative(dw, swept(system, memory, nothing, nothing, change)) < 1e-11  # as above


@pytest.mark.parametrize("method", METHODS)
def test_fixed_vertices_have_no_rows_of_their_own(method):
    system, memory, x, v = moving(method)
    near, work = stencil(system, 2), implicit.workspace(system)
    step = jacobian(system, near, True)
    differentiate(system, near, x, v, memory.w[STEP, 0], v, 0, work, step)
    held = np.flatnonzero(~system.vertex.free)
    assert held.tolist() == [0, 2]
    assert (step.by_mass[held] == 0).all()
    for i in held:
        assert (step.by_y[near.start[i] : near.start[i + 1]] == 0).all()
        assert (step.by_u[near.start[i] : near.start[i + 1]] == 0).all()
    at_held = np.isin(system.springs.ends, held)
    assert (step.by_stiffness[at_held] == 0).all()
    assert (step.by_rest[at_held] == 0).all()
    assert (step.by_stiffness[~at_held] != 0).any(axis=-1).all()


def test_rest_lengths_cost_nothing_where_nobody_asks():
    system, memory, x, v = moving("implicit")
    near = stencil(system, 2)
    work, step = implicit.workspace(system), jacobian(system, near)
    differentiate(system, near, x, v, memory.w[STEP, 0], v, 0, work, step)
    assert step.by_rest.shape == (0, 2, 3)
    assert np.abs(step.by_stiffness).max() > 0


def test_the_explicit_matrix_is_the_mass():
    system, memory, x, v = moving("explicit")
    near = stencil(system, 2)
    work, step = implicit.workspace(system), jacobian(system, near)
    differentiate(system, near, x, v, memory.w[STEP, 0], v, 0, work, step)
    assert system.method == EXPLICIT
    mass = np.where(system.vertex.free, system.vertex.mass, 0.0)  # fixed vertices have no rows
    np.testing.assert_array_equal(physics.dense_matrix(work.A), np.diag(np.repeat(mass, 3)))
