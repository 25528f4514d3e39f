"""The gradient by every kind through whole motions: Taylor ladder, central difference, tangent against transpose."""

import numba
import numpy as np
import pytest
from helpers.physics import METHODS, TIGHT, ball, scene, sheet, xyz
from helpers.scenes import cloth

from clothfit.derivative.verify import DIFFERENCE, ORDER, PRODUCT, check
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective, cost_and_gradient
from clothfit.scene.fit_vector import parameters, with_parameters

pytestmark = [
    pytest.mark.slow,  # compiles a fit
    pytest.mark.skipif(numba.config.DISABLE_JIT, reason="hundreds of simulations are slow without compilation"),
]

VARIANTS = [("explicit", 1), ("symplectic", 1), ("implicit", 1), ("implicit", 3), ("bdf2", 1)]
OWN = {
    "damping": {"damping": "G"},
    "drag": {"dragCoefficient": "G"},
    "velocity": {"vertVel": "G"},
    "velocities": {"vertVel": "L"},
    "rest factor": {"springRestLength": "G"},
    "rest lengths": {"springRestLength": "L"},
    "rest one factor": {"springRestLength": "F"},
    "rest families": {"springRestLength": "R"},
    "rest map": {"springRestLength": "M"},
}
WHOLE = {"wind": {"windVel": True}, "gravity": {"gravity": True}}
EVERY = {"damping": "G", "dragCoefficient": "G", "vertVel": "L", "springRestLength": "L"}
FRAMES = 14


def variant(objects, method, newton, **fields):
    delta, frames = (0.02, FRAMES) if method == "implicit" else (0.005, 3 * FRAMES)
    made = {
        "integrationMethod": METHODS[method],
        "forwardSubSteps": newton,
        "delta": delta,
        "optimizationIterations": frames,
        "windVel": xyz((4, -2, -3)),
        "gravity": xyz((1, -8, 0.5)),
        "colliders": [ball((1.0, -0.748, 1.0), 0.75)],
    }
    return scene(*objects, **{**made, **fields})


def truth(made, seed=12):
    """The motion of other parameters, far enough that the rounding of positions is small against the distances."""
    p = parameters(made)
    moved = p * 1.15 * np.exp(0.1 * np.random.default_rng(seed).normal(size=p.shape))
    return simulate(with_parameters(made, moved), tolerance=TIGHT)


def assert_right(objective, p):
    report = check(objective, p, seed=4)
    assert report.order > ORDER
    assert report.difference < DIFFERENCE  # rounding of the cost, 1e-13, over the step
    assert report.product < PRODUCT  # linear systems are solved to 1e-14


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
@pytest.mark.parametrize("kind", [*OWN, *WHOLE])
def test_the_gradient_by_one_kind(kind, method, newton):
    made = variant([sheet(fit=OWN.get(kind, {}))], method, newton, fit=WHOLE.get(kind, {}))
    assert_right(Objective(made, truth(made)), parameters(made))


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
def test_the_gradient_by_all_kinds_of_several_cloths_that_share_the_wind(method, newton):
    objects = [sheet("LG", fit=EVERY), sheet("nn", 2, 3), sheet("GL", 2, 2, fit={"springRestLength": "G"})]
    made = variant(objects, method, newton, fit={"windVel": True, "gravity": True})
    assert_right(Objective(made, truth(made)), parameters(made))


def test_the_gradient_at_a_drag_of_0_and_at_rest():
    still = sheet(dragCoefficient=0.0, vertVel=[xyz((0, 0, 0))] * 9, fit={"dragCoefficient": True, "vertVel": "G"})
    made = variant([still], "implicit", 1)
    p = parameters(made)
    assert p.tolist() == [0, 0, 0, 0]
    goal = simulate(with_parameters(made, [0.3, 1.0, -0.5, 2.0]), tolerance=TIGHT)
    assert_right(Objective(made, goal), p)


def test_the_gradient_by_what_the_cloths_share_is_the_sum_of_theirs():
    one, other = sheet(), sheet("nn", 2, 3)
    fit = {"windVel": True, "gravity": True}
    both = variant([one, other], "implicit", 1, fit=fit)
    value, gradient = cost_and_gradient(both, moved := shifted(simulate(both, tolerance=TIGHT)))
    alone = [variant([single], "implicit", 1, fit=fit) for single in (one, other)]
    parts = [cost_and_gradient(made, moved.of(i)) for i, made in enumerate(alone)]
    # a sum of two
    np.testing.assert_allclose(value, parts[0][0] + parts[1][0], rtol=1e-15)
    np.testing.assert_allclose(gradient, parts[0][1] + parts[1][1], rtol=1e-15)


def shifted(motion):
    """The motion with a shift that grows with time."""
    motion.positions[:] += 0.1 * motion.times[:, None, None]
    return motion


def test_one_value_has_the_gradient_of_all_in_proportion():
    lengths = scene(sheet()).cloths[0].lengths
    same = {"vertVel": [xyz((1, 0, 0.5))] * 9, "springRestLength": (0.9 * lengths).tolist()}
    one, each = (
        variant([sheet(fit={"vertVel": m, "springRestLength": m}, **same)], "implicit", 1) for m in ("G", "L")
    )
    goal = truth(each)
    (value, gradient), (equal, gradients) = (cost_and_gradient(made, goal) for made in (one, each))
    assert value == equal  # the same motion
    expected = [*gradients[:27].reshape(9, 3).sum(axis=0), gradients[27:] @ lengths]
    np.testing.assert_allclose(gradient, expected, rtol=1e-12)  # sums of 9 and 16 numbers that may cancel


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
def test_masses_and_stiffnesses_have_the_same_gradient_to_the_bit_whatever_else_is_fitted(method, newton):
    plain, every = (
        variant([sheet("LL", fit=fit)], method, newton, fit=whole)
        for fit, whole in (({}, {}), (EVERY, {"windVel": True, "gravity": True}))
    )
    goal = truth(plain)
    (value, gradient), (same, whole) = (cost_and_gradient(made, goal) for made in (plain, every))
    assert value == same
    assert [block.name for block in every.blocks[:2]] == ["mass", "stiffness"]
    np.testing.assert_array_equal(whole[: len(gradient)], gradient)


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
def test_defaults_written_out_are_the_same_motion_to_the_bit(method, newton):
    plain = cloth(3, 3)
    lengths = scene(plain).cloths[0].lengths.tolist()
    zero = [xyz((0, 0, 0))] * 9
    bare = scene(plain, integrationMethod=METHODS[method], forwardSubSteps=newton, delta=0.005)
    spelled = scene(
        {**plain, "vertVel": zero, "springRestLength": lengths, "fit": {"damping": "n", "vertVel": False}},
        integrationMethod=METHODS[method], forwardSubSteps=newton, delta=0.005, gravity=xyz((0, -9.81, 0)), fit={},
    )  # fmt: skip
    np.testing.assert_array_equal(simulate(bare, 20).positions, simulate(spelled, 20).positions)


# What the fields mean -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["explicit", "symplectic", "implicit"])
def test_a_free_cloth_with_a_common_velocity_is_a_projectile(method):
    n, h, v, g = 4, 0.01, np.array([1.0, 2.0, -3.0]), np.array([0.5, -2.0, 1.0])
    thrown = cloth(
        2, 2, vertIsFixed=[False] * n, damping=0.0, dragCoefficient=0.0, vertVel=[xyz(v)] * n
    )
    made = scene(thrown, integrationMethod=METHODS[method], delta=h, gravity=xyz(g))
    motion = simulate(made, 31, TIGHT).positions
    t = np.arange(31)[:, None]
    # v_t = v + g h t; the positions move with the velocity before the step, or after it
    path = h * v * t + g * h * h * t * (t - 1 if method == "explicit" else t + 1) / 2
    # a rounding per step
    np.testing.assert_allclose(motion - motion[0], np.broadcast_to(path[:, None], motion.shape), atol=1e-13)


def test_fixed_vertices_ignore_their_velocity():
    made = scene(cloth(2, 2, vertVel=[xyz((1, 1, 1))] * 4))
    held = simulate(made, 5).positions[:, made.cloths[0].fixed]
    np.testing.assert_array_equal(held, np.broadcast_to(held[0], held.shape))


def test_a_spring_swings_about_its_given_rest_length():
    # no weight, no damping: the implicit step keeps the centre of mass, and the pair settles at its rest length
    points = [(0, 0, 0), (1, 0, 0)]
    pair = {"vertPos": [xyz(p) for p in points], "vertIsFixed": [False] * 2, "vertMass": [0.1] * 2}
    links = {"springs": [0, 1], "springStiffness": [20.0], "triangles": [], "springRestLength": [1.5]}
    made = scene(cloth(2, 1, **pair, **links, damping=1.0), gravity=xyz((0, 0, 0)), delta=0.05)
    last = simulate(made, 400, TIGHT).positions[-1]
    np.testing.assert_allclose(last[1] - last[0], [1.5, 0, 0], atol=1e-12)  # the swing has died down
    np.testing.assert_allclose(last.mean(axis=0), [0.5, 0, 0], atol=1e-12)
