"""Derivatives by every kind through whole motions: Taylor ladder, central difference, tangent against transpose, all
columns at once against one forward sweep for each; and what the fields of the kinds mean.
"""

import numpy as np
import pytest
from helpers.costs import simulate_all
from helpers.derivatives import assert_right
from helpers.physics import METHODS, TIGHT, VARIANTS, ball, cloth, scene, sheet, xyz
from scipy.sparse import csc_array

from clothfit.derivative import sensitivity
from clothfit.derivative.sensitivity import columns, sweep, tangents
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective, cost_and_gradient
from clothfit.scene.fit_vector import acting, parameters, with_parameters

pytestmark = pytest.mark.slow  # compiles a fit

OWN = {"damping": "G", "dragCoefficient": "G", "vertVel": "L", "springRestLength": "L"}
ALL = {"windVel": True, "gravity": True}
LETTERS = ["Ln", "Gn", "nL", "nG", "LL", "Fn", "nF", "FF", "Rn", "nR", "RM", "Mn", "nM", "MM", "FL", "MG"]
FITS = {
    **{letters: (letters, {}, {}) for letters in LETTERS},
    **{f"rest {mode}": ("nn", {"springRestLength": mode}, {}) for mode in "LGFRM"},
    **{f"velocity {mode}": ("nn", {"vertVel": mode}, {}) for mode in "LG"},
    "damping": ("nn", {"damping": "G"}, {}),
    "drag": ("nn", {"dragCoefficient": "G"}, {}),
    "wind": ("nn", {}, {"windVel": True}),
    "gravity": ("nn", {}, {"gravity": True}),
    "MM, rest R": ("MM", {"springRestLength": "R"}, {}),
    "RF, rest M": ("RF", {"springRestLength": "M"}, {}),
    "every kind": ("GL", {**OWN, "vertVel": "G"}, ALL),
    "each value": ("LG", OWN, ALL),
}
"""Letters of masses and stiffnesses, fields of the object, fields of the scene."""

CASES = [*((kind, "implicit", 3) for kind in FITS), *(("every kind", *variant) for variant in VARIANTS)]
VALUES = {"vertMass": np.linspace(0.05, 0.4, 9).tolist(), "springStiffness": np.linspace(4.0, 60.0, 16).tolist()}


def made(kind="LL", method="implicit", newton=1, delta=0.01, frames=6, others=(), **fields):
    """A scene of a sheet on a sphere in the wind, of which a kind is fitted; fields of the scene in `whole`."""
    settings, own, fit = FITS[kind]
    return scene(
        sheet(settings, fit=own, **fields), *others, integrationMethod=METHODS[method], forwardSubSteps=newton,
        delta=delta, optimizationIterations=frames, windVel=xyz((4, -2, -3)), gravity=xyz((1, -8, 0.5)), fit=fit,
        colliders=[ball((1.0, -0.748, 1.0), 0.75)],
    )  # fmt: skip


def long(kind, method="implicit", newton=1, **fields):
    """The same until it lies on the sphere, its values all different; others need shorter steps than implicit ones."""
    delta, frames = (0.02, 14) if method == "implicit" else (0.005, 42)
    return made(kind, method, newton, delta, frames, **{**VALUES, **fields})


def truth(given, seed=12):
    """The motion of other parameters, far enough that the rounding of positions is small against the distances."""
    p = parameters(given)
    moved = p * 1.15 * np.exp(0.1 * np.random.default_rng(seed).normal(size=p.shape))
    return simulate(with_parameters(given, moved), tolerance=TIGHT)


@pytest.mark.parametrize(("kind", "method", "newton"), CASES)
def test_the_gradient_is_the_derivative_of_the_cost(kind, method, newton):
    given = long(kind, method, newton)
    p = parameters(given)
    moved = p * np.exp(0.1 * np.random.default_rng(5).normal(size=p.shape))
    for at in (p, moved)[: 1 + (kind in LETTERS)]:  # where factors are not 1
        assert_right(Objective(given, truth(given)), at)


@pytest.mark.parametrize(("method", "newton"), VARIANTS[:-1])
def test_the_gradient_by_all_kinds_of_several_cloths_that_share_the_wind(method, newton):
    others = sheet("nn", 2, 3), sheet("GL", 2, 2, fit={"springRestLength": "G"})
    given = long("each value", method, newton, others=others)
    assert_right(Objective(given, truth(given)), parameters(given))


def test_the_gradient_at_a_drag_of_0_and_at_rest():
    still = sheet(dragCoefficient=0.0, vertVel=[xyz((0, 0, 0))] * 9, fit={"dragCoefficient": True, "vertVel": "G"})
    given = scene(still, delta=0.02, optimizationIterations=14, windVel=xyz((4, -2, -3)))
    p = parameters(given)
    assert p.tolist() == [0, 0, 0, 0]
    goal = simulate(with_parameters(given, [0.3, 1.0, -0.5, 2.0]), tolerance=TIGHT)
    assert_right(Objective(given, goal), p)


def test_of_two_experiments_the_factors_are_on_the_values_of_the_main_scene():
    main = long("RM")
    other = scene({**sheet("nn"), **VALUES}, gravity=xyz((0, -5, 1)), optimizationIterations=14)
    changed = with_parameters(main, parameters(main) * 1.3)
    other = other.with_values([changed.cloths[0].mass], [changed.cloths[0].stiffness])
    p = np.exp(0.1 * np.random.default_rng(6).normal(size=len(parameters(main))))
    wanted = with_parameters(main, p).cloths[0]
    goal = simulate(other.with_values([wanted.mass], [wanted.stiffness]), 14, TIGHT)
    assert Objective(main, [(goal, other)], TIGHT).cost(p) == 0.0


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
def test_masses_and_stiffnesses_have_the_same_gradient_to_the_bit_whatever_else_is_fitted(method, newton):
    plain, every = (
        scene(sheet("LL", fit=fit), integrationMethod=METHODS[method], forwardSubSteps=newton, delta=0.005, fit=whole,
              optimizationIterations=14, windVel=xyz((4, -2, -3)), colliders=[ball((1.0, -0.748, 1.0), 0.75)])
        for fit, whole in (({}, {}), (OWN, ALL))
    )  # fmt: skip
    goal = truth(plain)
    (value, gradient), (same, whole) = (cost_and_gradient(given, goal) for given in (plain, every))
    assert value == same
    assert [block.name for block in every.blocks[:2]] == ["mass", "stiffness"]
    np.testing.assert_array_equal(whole[: len(gradient)], gradient)


# --- all columns at once


def fitted(kind, method="implicit", newton=1, **fields):
    """An objective, its parameters and its motion: system, memory, a column for every parameter, with factors of
    different sizes, and these.
    """
    given = made(kind, method, newton, **fields)
    objective, p = Objective(given, simulate(given), TIGHT), parameters(given)
    system, memory = simulate_all(objective, objective.runs[0], p)
    factor = np.linspace(0.5, 2.0, len(p))
    column = np.random.default_rng(7).permutation(len(p)).astype(np.int32)  # in no order
    wanted = columns(system, acting(objective.scene, 0), p, column, factor, len(p))
    return objective, p, system, memory, wanted, column, factor


def one_by_one(objective, p, column, factor):
    """The change of the free coordinates (T, 3 f, Q) along each parameter, by a tangent sweep for each."""
    free = objective.runs[0].system.vertex.free
    units = np.diag(factor)[np.argsort(column)]
    changes = [objective.tangent(p, unit)[0][1:, free] for unit in units]
    return np.stack([change.reshape(len(change), -1) for change in changes], axis=2)


def together(found):
    """All steps (T, 3 f, Q) of a sweep, whose array is used again."""
    return np.array([step.copy() for step in found])


@pytest.mark.parametrize(("kind", "method", "newton"), CASES)
def test_every_column_is_a_tangent(kind, method, newton):
    objective, p, system, memory, wanted, column, factor = fitted(kind, method, newton)
    expected = one_by_one(objective, p, column, factor)
    size = np.abs(expected).max(axis=(0, 1))
    assert (size[column[objective.identifiable]] > 0).all()
    # linear systems are solved to 1e-14, of a condition below 100, a few in a row; each column by its own size
    for found in (sweep(system, memory, wanted), tangents(system, memory, wanted, TIGHT)):
        gap = np.abs(together(found) - expected).max(axis=(0, 1))
        assert (gap <= 1e-12 * np.maximum(size, 1e-3 * size.max())).all()


@pytest.mark.parametrize("newton", [1, 3])
def test_what_has_no_factor_is_solved_by_sparse_lu(newton, monkeypatch):
    *_, system, memory, wanted, _, _ = fitted("every kind", newton=newton)
    factorised = together(sweep(system, memory, wanted))
    monkeypatch.setattr(sensitivity, "factorise", lambda *_: None)
    found = together(sweep(system, memory, wanted))
    assert not np.array_equal(found, factorised)  # another way …
    np.testing.assert_allclose(found, factorised, atol=1e-12 * np.abs(found).max())  # … to the same, but for rounding


def test_an_indefinite_matrix_is_inverted_as_well():
    hard = {"springRestLength": [2.5] * 16, "vertMass": [0.002] * 9}
    objective, p, system, memory, wanted, column, factor = fitted("LL", **hard)
    assert memory.clamped.any()  # conjugate gradients met negative curvature
    expected, found = one_by_one(objective, p, column, factor), together(sweep(system, memory, wanted))
    # matrices near singular lose digits
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_parameters_without_a_column_are_held():
    objective, p, system, memory, _, _, factor = fitted("LL")
    column = np.full(len(p), -1, np.int32)
    kept = [3, 12, 20]
    column[kept] = np.arange(3)
    some = together(sweep(system, memory, columns(system, acting(objective.scene, 0), p, column, factor, 3)))
    every = one_by_one(objective, p, np.arange(len(p)), factor)
    np.testing.assert_allclose(some, every[:, :, kept], atol=1e-12 * np.abs(every).max())  # as above


def test_a_matrix_without_an_inverse_is_an_error_of_linear_algebra():
    with pytest.raises(np.linalg.LinAlgError, match=r"[Ss]ingular"):
        sensitivity.solve_whole(csc_array((2, 2)), np.ones((2, 1)))


# --- what the fields mean


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
def test_defaults_written_out_are_the_same_motion_to_the_bit(method, newton):
    plain, whole = cloth(3, 3), {"integrationMethod": METHODS[method], "forwardSubSteps": newton, "delta": 0.005}
    zero, lengths = [xyz((0, 0, 0))] * 9, scene(plain).cloths[0].lengths.tolist()
    own = {"vertVel": zero, "springRestLength": lengths, "fit": {"damping": "n", "vertVel": False}}
    bare, spelled = scene(plain, **whole), scene({**plain, **own}, gravity=xyz((0, -9.81, 0)), fit={}, **whole)
    np.testing.assert_array_equal(simulate(bare, 20).positions, simulate(spelled, 20).positions)
