"""One step of each scheme against the scene format written down with dense matrices; of BDF2 also how fast it
converges, and where it is an Euler step instead.
"""

import numpy as np
import pytest
from helpers import physics
from helpers.hard import crushed, energies
from helpers.physics import METHODS, STATES, TIGHT, dense_forces, full, relative

from clothfit.base.arrays import Elements
from clothfit.engine.rollout import rollout
from clothfit.engine.step import bdf2, explicit, guard, implicit
from clothfit.engine.system import BDF2, IMPLICIT, clamped, with_elements

FIXED = [0, 2]


def solved(system, x, v, y=None, u=None):
    """The velocity w of (M − h D − h² K) w = M v + h [f(y, u) + K (x − y) − D u], dense, K and D at (y, u), by default
    at (x, v), or 0 for explicit methods; and the least eigenvalue of the matrix.
    """
    y, u = (x, v) if y is None else (y, u)
    f, *both = dense_forces(system, y, u)
    h, (K, D) = system.h, (float(system.method == IMPLICIT) * each for each in both)
    M, free = np.kron(np.diag(system.vertex.mass), np.eye(3)), np.repeat(system.vertex.free, 3)
    A = (M - h * D - h * h * K)[np.ix_(free, free)]
    b = M @ v.ravel() + h * (f.ravel() + K @ (x - y).ravel() - D @ u.ravel())
    w = np.zeros(x.size)
    w[free] = np.linalg.solve(A, b[free])
    return w.reshape(x.shape), np.linalg.eigvalsh(A).min()


def system(method="implicit", newton=1, delta=0.02):
    return full(fixed=FIXED, integrationMethod=METHODS[method], forwardSubSteps=newton, delta=delta)


def start(system, name):
    """State whose fixed vertices are at rest."""
    at, free = physics.state(system, name), system.vertex.free[:, None]
    return at._replace(u=at.u * free, du=at.du * free)


def taken(system, x, v, tolerance=TIGHT, first=None):
    """Velocities of the iterations used (k, n, 3), CG iterations, direct solves."""
    w = np.zeros((system.newton_iterations, *x.shape))
    if system.method != IMPLICIT:
        explicit.step(system, x, v, w[0], np.empty_like(x))
        return w, 0, 0
    work = implicit.workspace(system)
    implicit.prepare(system, x, v, work)
    used, iterations, direct = implicit.step(system, x, v, v if first is None else first, tolerance, work, w)
    return w[:used], iterations, direct


def as_taken(system, at):
    """The system, clamped where a step from this state has to be."""
    return system if len(taken(system, at.y, at.u)[0]) else clamped(system)


@pytest.mark.parametrize("name", STATES)
@pytest.mark.parametrize("method", ["explicit", "symplectic", "implicit"])
def test_the_step_is_that_of_the_scene_format(method, name):
    one = system(method)
    at = start(one, name)
    one = as_taken(one, at)
    assert (one.springs.cap == 1.0) == (name == "compressed" and method == "implicit")
    w = taken(one, at.y, at.u)[0][-1]
    # explicit: sums of some tens of terms; implicit: condition number below 1e3, residual 1e-14
    assert relative(w, solved(one, at.y, at.u)[0]) < (1e-10 if method == "implicit" else 1e-13)
    assert np.abs(w[FIXED]).max() == 0.0


def test_a_compressed_cloth_has_an_indefinite_matrix_and_is_stepped_in_the_clamped_form():
    one = system()
    one = with_elements(one, Elements(one.vertex.mass, 40 * one.springs.stiffness))
    at, safe = start(one, "compressed"), clamped(one)
    expected, least = solved(safe, at.y, at.u)
    assert solved(one, at.y, at.u)[1] < 0 < 0.99 * one.vertex.mass.min() < least
    assert len(taken(one, at.y, at.u)[0]) == 0  # refused
    w, _, direct = taken(safe, at.y, at.u)
    assert (len(w), direct) == (1, 0)
    assert relative(w[0], expected) < 1e-10  # condition number below 1e4


def residual(system, x, v, w):
    """M (w − v) − h f(x + h w, w) of the free vertices, and the size of its terms."""
    f = system.h * dense_forces(system, x + system.h * w, w)[0]
    free = system.vertex.free
    return np.linalg.norm((system.vertex.mass[:, None] * (w - v) - f)[free]), np.linalg.norm(f[free])


@pytest.mark.parametrize("name", ["rest", "random", "stretched"])
def test_newton_starts_from_the_linearised_step_and_solves_backward_euler(name):
    # the Jacobians are not complete, so the convergence is linear: a small time step keeps it quick
    many = system(newton=60, delta=0.005)
    at = start(many, name)
    w, once = (taken(each, at.y, at.u, 1e-12)[0] for each in (many, system(delta=0.005)))
    np.testing.assert_array_equal(w[0], once[0])  # the same operations
    error, size = residual(many, at.y, at.u, w[-1])
    assert 2 < len(w) < 60  # the residual was within tolerance before the iterations ran out
    assert error < 1e-10 * size  # tolerance relative to a right-hand side that contains A u
    assert residual(many, at.y, at.u, w[0])[0] > 1e3 * error


def test_a_step_with_nothing_left_to_improve_stops_early():
    still = physics.system(physics.thing([(0, 0, 0)]), forwardSubSteps=5)  # free fall is linear
    assert len(taken(still, still.x0, np.zeros((1, 3)))[0]) == 1


# --- BDF2


def run(system, steps, tolerance=TIGHT):
    """The memory of a motion that stays finite."""
    memory, good = rollout(system, steps, tolerance)
    assert good == steps
    return memory


def written_down(system, steps):
    """The motion (steps + 1, n, 3), by its definition."""
    euler, inner = bdf2.forms(system)
    w, _ = solved(euler, system.x0, system.v0)
    x, v = [system.x0, system.x0 + euler.h * w], [system.v0, w]
    for t in range(1, steps):
        base, u = (4 * x[t] - x[t - 1]) / 3, 2 * v[t] - v[t - 1]
        w, _ = solved(inner, base, (4 * v[t] - v[t - 1]) / 3, base + inner.h * u, u)
        x.append(base + inner.h * w)
        v.append(w)
    return np.array(x)


@pytest.mark.slow
@pytest.mark.parametrize("fixed", [(), (0, 2)])
def test_the_motion_is_that_of_the_definition(fixed):
    system = full(fixed=fixed, integrationMethod=BDF2, delta=0.004)
    memory = run(system, 8)
    np.testing.assert_allclose(memory.x, written_down(system, 8), atol=1e-12)  # solves to 1e-14, of a condition of 100
    assert memory.euler.tolist() == [True] + [False] * 7


@pytest.mark.slow
def test_euler_steps_are_those_that_would_add_energy_and_the_ones_after_a_shortened_step():
    system = crushed(delta=0.2, integrationMethod=BDF2)
    memory = run(system, 60, 1e-8)
    assert memory.euler[1:].any()
    assert not memory.euler.all()
    inner, weight = energies(system, memory)
    assert (np.diff(inner + weight) <= guard.SLACK * inner[:-1] + guard.LEAST_RISE + 1e-13 * inner.max()).all()
    short = np.flatnonzero(memory.theta[:-1] < 1)
    assert len(short)
    assert memory.euler[short].all()
    assert memory.euler[short + 1].all()
