"""All columns at once against one forward sweep for each, and against finite differences of the motion."""

import numpy as np
import pytest
from helpers.costs import simulate_all
from helpers.physics import METHODS, TIGHT, ball, dense_matrix, scene, sheet, xyz
from scipy.sparse import csc_array

from clothfit.derivative import block_cholesky, sensitivity
from clothfit.derivative.columns import columns
from clothfit.derivative.sensitivity import Solver, sweep, tangents
from clothfit.engine.step import implicit
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import parameters

pytestmark = pytest.mark.slow  # compiles a fit

VARIANTS = [("explicit", 1), ("symplectic", 1), ("implicit", 1), ("implicit", 3), ("bdf2", 1), ("bdf2", 3)]
FITS = {
    "mass L": ("Ln", {}),
    "mass G": ("Gn", {}),
    "stiffness L": ("nL", {}),
    "stiffness G": ("nG", {}),
    "both L": ("LL", {}),
    "rest L": ("nn", {"springRestLength": "L"}),
    "rest G": ("nn", {"springRestLength": "G"}),
    "damping": ("nn", {"damping": "G"}),
    "drag": ("nn", {"dragCoefficient": "G"}),
    "velocity L": ("nn", {"vertVel": "L"}),
    "velocity G": ("nn", {"vertVel": "G"}),
    "mass F": ("Fn", {}),
    "mass M": ("Mn", {}),
    "stiffness R": ("nR", {}),
    "both M, rest R": ("MM", {"springRestLength": "R"}),
    "mass R, stiffness F, rest M": ("RF", {"springRestLength": "M"}),
    "every kind": ("GL", {"damping": "G", "dragCoefficient": "G", "vertVel": "G", "springRestLength": "L"}),
}
WHOLE = {"wind": {"windVel": True}, "gravity": {"gravity": True}, "every kind": {"windVel": True, "gravity": True}}
ALL = [*FITS, *list(WHOLE)[:-1]]
STEPS = 5


def fitted(kind, method="implicit", newton=1, **fields):
    """An objective of one cloth on a sphere in the wind, and its parameters."""
    settings, fits = FITS.get(kind, ("nn", {}))
    made = scene(
        sheet(settings, fit=fits, **fields),
        integrationMethod=METHODS[method],
        forwardSubSteps=newton,
        delta=0.01,
        optimizationIterations=STEPS + 1,
        windVel=xyz((4, -2, -3)),
        gravity=xyz((1, -8, 0.5)),
        colliders=[ball((1.0, -0.748, 1.0), 0.75)],
        fit=WHOLE.get(kind, {}),
    )
    return Objective(made, simulate(made), TIGHT), parameters(made)


def simulated(objective, p):
    """The system, its motion, and a column for every parameter, with factors of different sizes."""
    system, memory = simulate_all(objective, objective.runs[0], p)
    factor = np.linspace(0.5, 2.0, len(p))
    column = np.random.default_rng(7).permutation(len(p)).astype(np.int32)  # in no order
    return system, memory, columns(system, objective.blocks, p, column, factor, len(p)), column, factor


def one_by_one(objective, p, column, factor):
    """The change of the free coordinates (T, 3 f, Q) along each parameter, by a tangent sweep for each."""
    free = objective.runs[0].system.vertex.free
    out = np.zeros((STEPS, 3 * free.sum(), len(p)))
    for i, q in enumerate(column):
        unit = np.zeros(len(p))
        unit[i] = factor[i]
        (change,) = objective.tangent(p, unit)
        out[:, :, q] = change[1:, free].reshape(STEPS, -1)
    return out


def together(found):
    """All steps (T, 3 f, Q) of a sweep, whose array is used again."""
    return np.array([step.copy() for step in found])


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
@pytest.mark.parametrize("kind", ALL)
def test_every_column_is_a_tangent(kind, method, newton):
    objective, p = fitted(kind, method, newton)
    system, memory, wanted, column, factor = simulated(objective, p)
    expected = one_by_one(objective, p, column, factor)
    size = np.abs(expected).max(axis=(0, 1))
    assert (size[column[objective.identifiable]] > 0).all()
    # linear systems are solved to 1e-14, of a condition below 100, a few in a row; each column by its own size
    for found in (sweep(system, memory, wanted), tangents(system, memory, wanted, TIGHT)):
        gap = np.abs(together(found) - expected).max(axis=(0, 1))
        assert (gap <= 1e-12 * np.maximum(size, 1e-3 * size.max())).all()


def test_the_columns_are_the_derivative_of_the_motion():
    objective, p = fitted("every kind", newton=3)
    system, memory, wanted, column, factor = simulated(objective, p)
    last, free = together(sweep(system, memory, wanted))[-1], system.vertex.free
    for i in np.flatnonzero(objective.identifiable)[::5]:
        t = 1e-5 * np.maximum(abs(p[i]), 0.1)
        ends = []
        for sign in (1, -1):
            moved = p.copy()
            moved[i] += sign * t
            ends.append(simulate_all(objective, objective.runs[0], moved)[1].x[-1][free].reshape(-1))
        measured = factor[i] * (ends[0] - ends[1]) / (2 * t)
        # rounding of positions, 1e-15, over 1e-6, against changes of 1e-5 and more
        assert np.linalg.norm(last[:, column[i]] - measured) < 1e-5 * np.linalg.norm(measured) + 1e-9


@pytest.mark.parametrize("newton", [1, 3])
def test_a_large_cloth_is_factorised_as_a_sparse_matrix(newton, monkeypatch):
    objective, p = fitted("every kind", newton=newton)
    system, memory, wanted, *_ = simulated(objective, p)
    dense = together(sweep(system, memory, wanted))
    monkeypatch.setattr(sensitivity, "DENSE_UNKNOWNS", 5)
    found = together(sweep(system, memory, wanted))
    assert not np.array_equal(found, dense)  # another way …
    np.testing.assert_allclose(found, dense, atol=1e-12 * np.abs(dense).max())  # … to the same, but for rounding


def test_an_indefinite_matrix_is_inverted_as_well():
    objective, p = fitted("both L", springRestLength=[2.5] * 16, vertMass=[0.002] * 9)
    system, memory, wanted, column, factor = simulated(objective, p)
    assert memory.clamped.any()  # conjugate gradients met negative curvature
    expected = one_by_one(objective, p, column, factor)
    found = together(sweep(system, memory, wanted))
    # matrices near singular lose digits
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(("blocks", "limit"), [(True, 0), (False, 0), (False, 10**6)])
def test_the_factorisation_solves_for_many_right_hand_sides(blocks, limit, monkeypatch):
    monkeypatch.setattr(sensitivity, "DENSE_UNKNOWNS", limit)
    monkeypatch.setattr(block_cholesky, "is_cheaper", lambda *_: blocks)
    objective, p = fitted("both L")
    system, memory, *_ = simulated(objective, p)
    work, free = implicit.workspace(system), system.vertex.free
    work.b[:] = 0.0
    implicit.assemble(system, memory.x[2], memory.w[1, 0], False, work.A, work.b)
    right = np.random.default_rng(1).normal(size=(3 * free.sum(), 4))
    A = dense_matrix(work.A)[np.ix_(np.repeat(free, 3), np.repeat(free, 3))]
    np.testing.assert_allclose(A @ Solver(4)(work.A, right), right, atol=1e-12)  # a condition below 100


def test_parameters_without_a_column_are_held():
    objective, p = fitted("both L")
    system, memory, _, _, factor = simulated(objective, p)
    column = np.full(len(p), -1, np.int32)
    kept = [3, 12, 20]
    column[kept] = np.arange(3)
    some = together(sweep(system, memory, columns(system, objective.blocks, p, column, factor, 3)))
    every = one_by_one(objective, p, np.arange(len(p)), factor)
    np.testing.assert_allclose(some, every[:, :, kept], atol=1e-12 * np.abs(every).max())  # as above


@pytest.mark.parametrize("n", [2, sensitivity.DENSE_UNKNOWNS + 1])
def test_a_matrix_without_an_inverse_is_an_error_of_linear_algebra(n):
    with pytest.raises(np.linalg.LinAlgError, match=r"[Ss]ingular"):
        sensitivity.whole_solver(csc_array((n, n)))
