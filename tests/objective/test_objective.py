"""The gradient of what buckles; costs of what is flagged and of fewer frames, and the motions that are kept."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.derivatives import assert_right
from helpers.physics import METHODS, TIGHT, ball, scene, thing, xyz
from helpers.scenes import cloth, even, trial
from helpers.strangers import small

from clothfit import (
    Diverged,
    InvalidInput,
    Motion,
    as_motion,
    degrade,
    load,
    parameters,
    simulate,
    with_parameters,
)
from clothfit.engine.rollout import rollout
from clothfit.engine.tape import Tape
from clothfit.objective.objective import Objective, cost_and_gradient
from clothfit.objective.run import KEPT
from clothfit.scene.block import flagged

pytestmark = pytest.mark.slow

FRAMES = 16


def sheet(nx=3, ny=3, settings="LL", **fields):
    mass = [0.05 + 0.005 * i for i in range(nx * ny)]
    made = {"vertMass": mass, "optimizationSettings": settings, "dragCoefficient": 0.0, "damping": 0.3}
    return cloth(nx, ny, **{**made, **fields})


WIND = {"windVel": xyz((4, -2, -3))}
SPHERE = {"colliders": [ball((1.0, -0.748, 1.0), 0.75)]}  # carries the middle vertex from the start
SEVERAL = [sheet(2, 3, "GL"), sheet(3, 2, "nn"), sheet(2, 2, "LG", dragCoefficient=0.3)]


def variant(objects, method, newton, **fields):
    delta, frames = (0.02, FRAMES) if method == "implicit" else (0.005, 3 * FRAMES)
    made = {"integrationMethod": METHODS[method], "forwardSubSteps": newton, "delta": delta}
    return scene(*objects, **{**made, "optimizationIterations": frames, **fields})


def truth(made, factor=1.15):
    """The motion of other parameters: not a multiple of the scene's, so that every setting has a gradient."""
    p = parameters(made)
    rng = np.random.default_rng(12)
    return simulate(with_parameters(made, p * factor * np.exp(0.1 * rng.normal(size=p.shape))), tolerance=TIGHT)


# Few frames and chosen states: through matrices near singular a motion soon depends on its parameters so wildly that
# a step of a tenth is no small one, and Newton's iterations jump.


def test_the_position_error_knows_no_objective_no_weight_and_no_loss():
    made = scene(sheet(), optimizationIterations=FRAMES)
    x, seen = simulate(made, tolerance=TIGHT).positions, np.random.default_rng(1).random((FRAMES, 9)) < 0.7
    moved = as_motion(made, x + 0.1, observed=seen, weights=np.linspace(1, 2, 9))
    aim = Objective(made, moved, TIGHT, objective={"velocity": 3.0}, loss="huber")
    # every coordinate is 0.1 m off; rounding of the solves
    assert aim.position_rmse(parameters(made)) == pytest.approx(0.1 * np.sqrt(3), rel=1e-11)


COLUMN = thing([(1e-3 * (i % 2), 0.01 * i, 0) for i in range(8)], [(i, i + 1) for i in range(7)], mass=0.01,
               stiffness=200.0, fixed=[0], optimizationSettings="LL")  # fmt: skip
# nothing but damping and weight move this vertex at first: some steps need one iteration, some all
ONE = thing([(0, 0, 0), (0, -1, 0)], [(0, 1)], mass=0.5, stiffness=30.0, fixed=[0], optimizationSettings="LL")


@pytest.mark.parametrize(("own", "newton", "frames"), [(COLUMN, 1, 5), (COLUMN, 2, 6), (ONE, 2, FRAMES),
                                                       (ONE, 5, FRAMES)])  # fmt: skip
def test_the_gradient_of_a_column_that_buckles_and_of_newton_iterations_that_stop_early(own, newton, frames):
    made = variant([own], "implicit", newton, optimizationIterations=frames)
    objective, p = Objective(made, truth(made)), parameters(made)
    memory, _ = rollout(objective.runs[0].system, frames - 1, TIGHT)
    # conjugate gradients met negative curvature
    assert memory.clamped.any() if own is COLUMN else memory.used.min() < newton
    assert_right(objective, p)


def test_nothing_flagged_is_a_cost_of_nothing():
    made = variant([sheet(settings="nn")], "implicit", 1)
    objective = Objective(made, simulate(made))
    assert objective.runs == ()
    value, gradient = objective.cost_and_gradient(np.zeros(0))
    assert (value, gradient.shape, objective.frames, objective.observations) == (0, (0,), 0, 0)


def test_a_fit_simulates_only_what_it_fits():
    fields = {**WIND, **SPHERE}
    made = variant(SEVERAL, "implicit", 1, **fields)
    goal = truth(made)
    objective = Objective(made, goal)
    assert [run.cloth for run in objective.runs] == [0, 2]
    p = parameters(made)
    value, gradient = objective.cost_and_gradient(p)
    parts, start = [], 0
    for i in (0, 2):
        alone = variant([SEVERAL[i]], "implicit", 1, **fields)
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


DIVERGED = r"^scene: objects\[0\] diverged at step \d+ \(t = [\d.]+ s\); try a smaller delta$"


def test_a_cost_that_overflows_is_a_divergence():
    stiff = thing([(0, 0, 0), (0, -1, 0)], [(0, 1)], mass=0.5, stiffness=20.0, fixed=[0], optimizationSettings="nL")
    made = variant([stiff], "explicit", 1, delta=0.1, optimizationIterations=60)
    objective = Objective(made, simulate(made))
    for evaluate in (objective.cost, objective.cost_and_gradient, lambda p: objective.tangent(p, p)):
        with pytest.raises(Diverged, match=DIVERGED) as caught:
            evaluate(np.array([1e4]))
        assert 1 < caught.value.step < 60


def test_a_vector_of_another_length_is_refused():
    made = variant([sheet()], "implicit", 1)
    with pytest.raises(InvalidInput, match=r"shape \(3,\) given, scene has \(25,\)"):
        Objective(made, simulate(made)).cost_and_gradient(np.ones(3))


def test_the_scene_makes_its_blocks_once(monkeypatch):
    made = variant([sheet()], "implicit", 1)
    motion, calls = truth(made), []
    monkeypatch.setattr("clothfit.scene.scene.flagged", lambda *of: calls.append(of) or flagged(*of))
    made = replace(made)
    Objective(made, motion).cost_and_gradient(parameters(made))
    assert len(calls) == 1


# --- the motions that an objective keeps: simulated once, the same as anew, and few


def objective(**options):
    scene = small("nL", method=3)
    return Objective(scene, simulate(scene, tolerance=1e-12), 1e-10, **options)


def test_a_cost_and_its_derivatives_need_one_motion(monkeypatch):
    aim, begun, tape = objective(), [], Tape.__init__
    p = 1.1 * parameters(aim.scene)
    monkeypatch.setattr(Tape, "__init__", lambda *given: begun.append(1) or tape(*given))
    assert not aim.remembers(p)
    cost, (again, gradient) = aim.cost(p), aim.cost_and_gradient(p)
    change = aim.tangent(p, np.ones(len(p)))[0]
    assert len(begun) == 1
    assert aim.remembers(p.copy())
    fresh = objective()
    assert (cost, again) == (fresh.cost(p), cost)
    np.testing.assert_array_equal(gradient, objective().cost_and_gradient(p)[1])
    np.testing.assert_array_equal(change, objective().tangent(p, np.ones(len(p)))[0])


def test_few_motions_are_kept():
    aim = objective()
    points = [parameters(aim.scene) * factor for factor in 1.0 + 0.1 * np.arange(KEPT + 1)]
    for p in points:
        aim.cost(p)
    assert [aim.remembers(p) for p in points] == [False] + KEPT * [True]


def test_little_memory_keeps_none():
    aim = objective(memory=10_000_000)  # a twentieth of which is less than 24 steps of 16 vertices, twice
    p = parameters(aim.scene)
    aim.cost(p)
    assert aim.remembers(p)
    aim = objective(memory=500_000)
    aim.cost(p)
    assert not aim.remembers(p)


# --- fewer frames, and what an objective says of how far its target moves


SCENE = load(trial("nL", 12, 3, 3))
P = 1.3 * parameters(SCENE)


@cache
def recorded():
    return simulate(SCENE, tolerance=TIGHT)


@pytest.mark.parametrize("frames", [1, 2, 5, 12, 99])
def test_fewer_frames_cost_what_these_cost(frames):
    aim = Objective(SCENE, recorded(), TIGHT)
    part = aim.until(frames)
    x = simulate(load(trial("nL", 12, 3, 3, springStiffness=P.tolist())), tolerance=TIGHT).positions
    expected = ((x - recorded().positions)[:frames] ** 2).sum()
    assert part.cost(P) == pytest.approx(expected, rel=1e-9, abs=1e-25)  # solves to 1e-14; nothing at the start
    assert part.frames == min(frames, 12)
    assert part.steps == min(frames, 12) - 1
    assert part.tolerance == aim.tolerance


def test_the_rest_of_what_was_asked_stays():
    options = {"objective": {"position": 1.0, "velocity": 0.01}, "loss": "huber", "loss_scale": 0.02}
    part = Objective(SCENE, degrade(recorded(), observed=0.7), TIGHT, 9, **options).until(6, 1e-6)
    same = Objective(SCENE, degrade(recorded(), observed=0.7), 1e-6, 6, **options)
    assert part.tolerance == 1e-6
    assert part.cost(P) == same.cost(P)
    assert Objective(SCENE, recorded(), TIGHT, 5).until(8).steps == 4  # no more than there was


def test_each_experiment_has_its_own_end():
    longer = load(trial("nL", 20, 3, 3))
    aim = Objective(SCENE, [recorded(), (simulate(longer), longer)], TIGHT, [6, 20])
    assert aim.steps == 19
    assert [run.comparison.last_step for run in aim.until(10).runs] == [5, 9]


def test_still_is_the_cost_of_a_cloth_that_does_not_move():
    aim = Objective(SCENE, recorded(), TIGHT)
    assert aim.cost_at_rest == pytest.approx(((recorded().positions - SCENE.cloths[0].positions) ** 2).sum(), rel=1e-12)
    resting = Motion(np.array([SCENE.cloths[0].positions] * 12), recorded().times, recorded().vertex_counts)
    assert Objective(SCENE, resting).cost_at_rest == 0.0


def test_the_first_step_is_the_first_at_which_anything_is_seen():
    made = load(even("nG", 20))
    motion = simulate(made)
    assert Objective(made, motion).first_step == 1
    late = Motion(motion.positions[7:], motion.times[7:] + 0.005, motion.vertex_counts)
    assert Objective(made, late).first_step == 8  # between the steps 7 and 8
    assert Objective(made, motion).until(1).first_step == 0
