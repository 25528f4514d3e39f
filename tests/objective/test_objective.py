"""The whole gradient: Taylor ladder, central difference and dot products, over all forces, settings and schemes."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers import costs
from helpers.marks import FITS
from helpers.physics import METHODS, TIGHT, ball, scene, thing, xyz
from helpers.scenes import cloth, even, load_text

from clothfit.base.errors import InvalidInput, InvalidMotion
from clothfit.derivative.verify import DIFFERENCE, ORDER, PRODUCT, central_difference_error, check
from clothfit.engine.rollout import rollout
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import as_motion
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective, cost_and_gradient
from clothfit.scene.block import flagged
from clothfit.scene.fit_vector import parameters, with_parameters

pytestmark = FITS

VARIANTS = [("explicit", 1), ("symplectic", 1), ("implicit", 1), ("implicit", 2), ("implicit", 5)]
SETTINGS = ["nG", "nL", "Gn", "GG", "GL", "Ln", "LG", "LL"]
FRAMES = 16
UNIFORM = {"vertMass": [0.0625] * 9, "springStiffness": [32.0] * 16, "dragCoefficient": 0.4}


def sheet(nx=3, ny=3, settings="LL", **fields):
    mass = [0.05 + 0.005 * i for i in range(nx * ny)]
    made = {"vertMass": mass, "optimizationSettings": settings, "dragCoefficient": 0.0, "damping": 0.3}
    return cloth(nx, ny, **{**made, **fields})


WIND = {"windVel": xyz((4, -2, -3))}
SPHERE = {"colliders": [ball((1.0, -0.748, 1.0), 0.75)]}  # carries the middle vertex from the start
KINDS = {
    "springs": ([sheet()], {}),
    "undamped": ([sheet(damping=0.0)], {}),
    "drag": ([sheet(dragCoefficient=0.5)], {}),
    "wind": ([sheet(dragCoefficient=0.5)], WIND),
    "sphere": ([sheet()], SPHERE),
    "several": ([sheet(2, 3, "GL"), sheet(3, 2, "nn"), sheet(2, 2, "LG", dragCoefficient=0.3)], {**WIND, **SPHERE}),
}


def variant(objects, method, newton, **fields):
    delta, frames = (0.02, FRAMES) if method == "implicit" else (0.005, 3 * FRAMES)
    made = {
        "integrationMethod": METHODS[method],
        "forwardSubSteps": newton,
        "delta": delta,
        "optimizationIterations": frames,
    }
    return scene(*objects, **{**made, **fields})


def truth(made, factor=1.15):
    """The motion of other parameters: not a multiple of the scene's, so that every setting has a gradient."""
    p = parameters(made)
    rng = np.random.default_rng(12)
    return simulate(with_parameters(made, p * factor * np.exp(0.1 * rng.normal(size=p.shape))), tolerance=TIGHT)


def assert_right(objective, p):
    report = check(objective, p, seed=4)
    assert report.order > ORDER
    assert report.difference < DIFFERENCE  # rounding of the cost, 1e-13, over the step
    assert report.product < PRODUCT  # linear systems are solved to 1e-14


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
@pytest.mark.parametrize("kind", KINDS)
def test_the_gradient_with_every_force_and_integrator(kind, method, newton):
    objects, fields = KINDS[kind]
    made = variant(objects, method, newton, **fields)
    assert_right(Objective(made, truth(made)), parameters(made))


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
@pytest.mark.parametrize("settings", SETTINGS)
def test_the_gradient_with_every_setting(settings, method, newton):
    made = variant([sheet(settings=settings, dragCoefficient=0.4)], method, newton, **WIND, **SPHERE)
    # Far from the truth, so that the rounding of positions, 1e-16 m, is small against the distances that G sums.
    goal = truth(variant([sheet(dragCoefficient=0.4)], method, newton, **WIND, **SPHERE), 1.4)
    assert_right(Objective(made, goal), parameters(made))


@pytest.mark.parametrize("kind", ["sphere", "wind"])
def test_the_scenes_do_what_they_are_for(kind):
    objects, fields = KINDS[kind]
    made, without = (variant(objects, "implicit", 1, **extra) for extra in (fields, {}))
    assert np.abs(simulate(made).positions - simulate(without).positions).max() > 1e-2


def squeezed(newton, mass, seed):
    """A crumpled cloth whose springs want to be 1.4 times as long as they are."""
    made = variant([sheet(damping=0.05, vertMass=[mass] * 9)], "implicit", newton, optimizationIterations=3)
    objective = Objective(made, simulate(made, tolerance=TIGHT))
    (run,) = objective.runs
    system = run.system
    x0 = system.x0 + 0.1 * np.random.default_rng(seed).normal(size=system.x0.shape)
    longer = system.springs._replace(rest=1.4 * system.springs.rest)
    objective.runs = (run._replace(system=system._replace(x0=x0, springs=longer)),)
    return objective, parameters(made)


# Few frames and chosen states: through matrices near singular a motion soon depends on its parameters so wildly that
# a step of a tenth is no small one, and Newton's iterations jump.


@pytest.mark.parametrize(("newton", "mass", "seed"), [(1, 0.01, 13), (2, 0.01, 13), (5, 0.02, 18)])
def test_the_gradient_through_indefinite_matrices(newton, mass, seed):
    objective, p = squeezed(newton, mass, seed)
    memory, good = rollout(objective.runs[0].system, 2, TIGHT)
    assert good == 2
    assert memory.clamped.any()  # conjugate gradients met negative curvature
    assert_right(objective, p)


def test_the_position_error_knows_no_objective_no_weight_and_no_loss():
    made = scene(sheet(), optimizationIterations=FRAMES)
    x, seen = simulate(made, tolerance=TIGHT).positions, np.random.default_rng(1).random((FRAMES, 9)) < 0.7
    moved = as_motion(made, x + 0.1, observed=seen, weights=np.linspace(1, 2, 9))
    aim = Objective(made, moved, TIGHT, objective={"velocity": 3.0}, loss="huber")
    # every coordinate is 0.1 m off; rounding of the solves
    assert aim.position_rmse(parameters(made)) == pytest.approx(0.1 * np.sqrt(3), rel=1e-11)


@pytest.mark.parametrize(("newton", "frames"), [(1, 5), (2, 6)])
def test_the_gradient_of_a_column_that_buckles(newton, frames):
    points = [(1e-3 * (i % 2), 0.01 * i, 0) for i in range(8)]
    links = [(i, i + 1) for i in range(7)]
    column = thing(points, links, mass=0.01, stiffness=200.0, fixed=[0], optimizationSettings="LL")
    made = variant([column], "implicit", newton, optimizationIterations=frames)
    objective, p = Objective(made, truth(made)), parameters(made)
    memory, _ = rollout(objective.runs[0].system, frames - 1, TIGHT)
    assert memory.clamped.any()  # conjugate gradients met negative curvature
    assert_right(objective, p)


@pytest.mark.parametrize("newton", [2, 5])
def test_the_gradient_of_newton_iterations_that_stop_early(newton):
    # nothing but damping and weight move this vertex at first: some steps need one iteration, some all
    one = thing([(0, 0, 0), (0, -1, 0)], [(0, 1)], mass=0.5, stiffness=30.0, fixed=[0], optimizationSettings="LL")
    made = variant([one], "implicit", newton)
    objective, p = Objective(made, truth(made)), parameters(made)
    memory, _ = rollout(objective.runs[0].system, FRAMES - 1, TIGHT)
    assert memory.used.min() < newton
    assert_right(objective, p)


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
def test_one_value_for_all_has_the_sum_of_the_gradients_of_each(method, newton):
    one, each = (variant([sheet(settings=s, **UNIFORM)], method, newton, **WIND, **SPHERE) for s in ("GG", "LL"))
    goal = truth(each)
    (value, gradient), (same, gradients) = (cost_and_gradient(made, goal) for made in (one, each))
    assert value == same  # the same motion
    # sums of 9 and 16 numbers
    np.testing.assert_allclose(gradient, [gradients[:9].sum(), gradients[9:].sum()], rtol=1e-13)


@pytest.mark.parametrize("settings", SETTINGS)
def test_what_is_not_flagged_has_no_gradient_and_the_rest_is_as_with_all(settings):
    made, every = (variant([sheet(settings=s, **UNIFORM)], "implicit", 1, **WIND) for s in (settings, "LL"))
    goal = truth(every)
    gradient, whole = (cost_and_gradient(scene, goal)[1] for scene in (made, every))
    parts = {"mass": whole[:9], "stiffness": whole[9:]}
    expected = [block.reduce(parts[block.name], parameters(made)) for block in made.blocks]
    np.testing.assert_array_equal(gradient, np.concatenate(expected))  # the same motion
    assert len(gradient) == sum({"n": 0, "G": 1, "L": n}[s] for s, n in zip(settings, (9, 16), strict=True))


def test_nothing_flagged_is_a_cost_of_nothing():
    made = variant([sheet(settings="nn")], "implicit", 1)
    objective = Objective(made, simulate(made))
    assert objective.runs == ()
    value, gradient = objective.cost_and_gradient(np.zeros(0))
    assert (value, gradient.shape, objective.frames, objective.observations) == (0, (0,), 0, 0)


def test_a_fit_simulates_only_what_it_fits():
    objects, fields = KINDS["several"]
    made = variant(objects, "implicit", 1, **fields)
    goal = truth(made)
    objective = Objective(made, goal)
    assert [run.cloth for run in objective.runs] == [0, 2]
    p = parameters(made)
    value, gradient = objective.cost_and_gradient(p)
    parts, start = [], 0
    for i in (0, 2):
        alone = variant([objects[i]], "implicit", 1, **fields)
        single = cost_and_gradient(alone, part(goal, i))
        parts.append(single[0])
        np.testing.assert_array_equal(gradient[start : start + len(single[1])], single[1])
        start += len(single[1])
    assert value == sum(parts)


def part(motion, cloth):
    """The motion of one object as a motion of its own."""
    return type(motion)(motion.of(cloth), motion.times, (motion.vertex_counts[cloth],))


def test_the_cost_is_that_of_the_gradient_and_of_the_definition():
    made = variant([sheet(dragCoefficient=0.4)], "implicit", 1, **WIND)
    goal = truth(made)
    objective, p = Objective(made, goal), parameters(made)
    value, _ = objective.cost_and_gradient(p)
    assert objective.cost(p) == value == cost_and_gradient(made, goal)[0]
    gap = simulate(made, tolerance=TIGHT).positions - goal.positions
    assert abs(value - (gap**2).sum()) < 1e-13 * value  # a rounding per term
    count = FRAMES * 9
    assert objective.observations == count
    assert abs(objective.rmse(value) - np.sqrt((gap**2).sum() / count)) < 1e-15
    assert objective.frames == FRAMES


def test_the_truth_has_no_cost_and_no_gradient():
    made = variant([sheet()], "implicit", 2)
    value, gradient = cost_and_gradient(made, simulate(made, tolerance=TIGHT))
    assert value == 0.0
    assert np.abs(gradient).max() == 0.0


def test_the_tangent_is_the_change_of_the_motion():
    made = variant([sheet(dragCoefficient=0.4)], "implicit", 1, **WIND, **SPHERE)
    objective, p = Objective(made, truth(made)), parameters(made)
    direction, t = p * np.random.default_rng(14).normal(size=p.shape), 1e-6
    (change,) = objective.tangent(p, direction)
    ends = [simulate(with_parameters(made, p + s * direction), tolerance=TIGHT).positions for s in (t, -t)]
    # rounding of positions 1e-14 / 1e-6 against changes of 1e-2
    np.testing.assert_allclose(change, (ends[0] - ends[1]) / (2 * t), atol=1e-6 * np.abs(change).max())


@pytest.mark.parametrize("kind", ["partly seen", "skipped", "shorter"])
def test_the_gradient_with_targets_as_captures_have_them(kind):
    made = variant([sheet(dragCoefficient=0.4)], "implicit", 1, **WIND)
    goal = truth(made)
    seen = np.random.default_rng(15).random(goal.positions.shape[:2]) < 0.4
    hidden = np.where(seen[:, :, None], goal.positions, np.nan)
    variants = {
        "partly seen": (type(goal)(hidden, goal.times, goal.vertex_counts, seen), None),
        "skipped": (type(goal)(goal.positions[3::4], goal.times[3::4], goal.vertex_counts), None),
        "shorter": (goal, 6),
    }
    objective = Objective(made, variants[kind][0], frames=variants[kind][1])
    counts = {"partly seen": seen.sum(), "skipped": 4 * 9, "shorter": 6 * 9}
    assert objective.observations == counts[kind]
    assert_right(objective, parameters(made))


def test_the_tolerance_enters_the_gradient():
    made = variant([sheet(dragCoefficient=0.4)], "implicit", 1, **WIND)
    goal, p = truth(made), parameters(made)
    objective = Objective(made, goal)
    rough = Objective(made, goal, tolerance=1e-3).cost_and_gradient(p)[1]
    direction = p * np.random.default_rng(16).normal(size=p.shape)
    fine = objective.cost_and_gradient(p)[1]
    assert central_difference_error(objective.cost, fine, p, direction) < DIFFERENCE
    assert 1e-6 < np.abs(rough - fine).max() / np.abs(fine).max() < 0.5


DIVERGED = r"^scene: objects\[0\] diverged at step \d+ \(t = [\d.]+ s\); try a smaller delta$"


def test_a_cost_that_overflows_is_a_divergence():
    stiff = thing(
        [(0, 0, 0), (0, -1, 0)], [(0, 1)], mass=0.5, stiffness=20.0, fixed=[0], optimizationSettings="nL"
    )  # fmt: skip
    made = variant([stiff], "explicit", 1, delta=0.1, optimizationIterations=60)
    objective = Objective(made, simulate(made))
    for evaluate in (objective.cost, objective.cost_and_gradient, lambda p: objective.tangent(p, p)):
        with pytest.raises(Diverged, match=DIVERGED) as caught:
            evaluate(np.array([1e4]))
        assert 1 < caught.value.step < 60


def test_a_motion_of_another_scene_is_refused():
    made, other = variant([sheet()], "implicit", 1), variant([sheet(2, 2)], "implicit", 1)
    with pytest.raises(InvalidMotion, match=r"its objects have 4 vertices, those of scene 9$"):
        Objective(made, simulate(other))


def test_a_vector_of_another_length_is_refused():
    made = variant([sheet()], "implicit", 1)
    with pytest.raises(InvalidInput, match=r"shape \(3,\) given, scene has \(25,\)"):
        Objective(made, simulate(made)).cost_and_gradient(np.ones(3))


def test_the_derivative_by_position_is_what_the_gradient_pulls_back():
    made = variant([sheet()], "implicit", 1)
    objective, p = Objective(made, truth(made)), parameters(made)
    memory, _ = rollout(objective.runs[0].system, FRAMES - 1, TIGHT)
    by_position = costs.cost_and_derivative(objective.runs[0].comparison, memory.x)[1]
    direction = p * np.random.default_rng(17).normal(size=p.shape)
    (change,) = objective.tangent(p, direction)
    forward, back = np.vdot(by_position, change), objective.cost_and_gradient(p)[1] @ direction
    assert abs(forward - back) < 1e-12 * abs(back)  # linear systems are solved to 1e-14


def test_the_scene_makes_its_blocks_once(monkeypatch):
    made = variant([sheet()], "implicit", 1)
    motion, calls = truth(made), []
    monkeypatch.setattr("clothfit.scene.scene.flagged", lambda *of: calls.append(of) or flagged(*of))
    made = replace(made)
    Objective(made, motion).cost_and_gradient(parameters(made))
    assert len(calls) == 1


def test_a_growing_cost_grows_to_the_cost():
    truth = load_text(json.dumps(even("nG", 40)))
    objective = Objective(truth, simulate(truth), 1e-10)
    p = 2.0 * parameters(truth)
    grown = list(objective.growing_cost(p))
    assert grown[-1].cost == objective.cost(p)
    assert (np.diff([0.0, *(each.cost for each in grown)]) > 0).all()
    assert [each.ahead for each in grown] == list(range(objective.steps - 8, -1, -8)) + [0] * (objective.steps % 8 > 0)
    assert sum(each.steps for each in grown) == objective.steps


@pytest.mark.parametrize("how", [{"loss": "huber", "loss_scale": 0.1}, {"objective": "velocity"}])
def test_other_costs_than_squares_are_known_at_their_end(how):
    truth = load_text(json.dumps(even("nG", 20)))
    objective = Objective(truth, simulate(truth), 1e-10, **how)
    p = 2.0 * parameters(truth)
    *before, last = objective.growing_cost(p)
    assert {each.cost for each in before} == {0.0}
    assert last.cost == objective.cost(p)


def test_the_growing_cost_of_a_motion_that_diverges_is_infinite():
    truth = load_text(json.dumps(even("nG", 40, integrationMethod=0)))
    objective = Objective(truth, simulate(load_text(json.dumps(even("nG", 40)))), 1e-10)
    assert list(objective.growing_cost(np.array([1e4])))[-1].cost == np.inf
