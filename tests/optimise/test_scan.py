"""The scan finds the global minimum of one or two values, against brute force."""

import numpy as np
import pytest
from helpers.physics import TIGHT, scene, xyz
from helpers.scenes import cloth, even

from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise.scan import POINTS, PartialCost, brackets, grid, is_minimum, minima, scan, scannable
from clothfit.scene.fit_vector import LOWER, UPPER, parameters
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow


def flag(settings="nG", frames=80, nx=4, ny=3, stiffness=30.0, mass=0.01, **fields):
    """A small cloth in a strong wind."""
    values = {"vertMass": [mass] * (nx * ny), "springStiffness": [stiffness] * len(cloth(nx, ny)["springStiffness"])}
    own = cloth(nx, ny, 0.3, optimizationSettings=settings, **values, dragCoefficient=1.5, damping=0.02)
    return scene(own, optimizationIterations=frames, windVel=xyz((9, 0.5, 4)), **fields)


@pytest.mark.parametrize("settings", ["nG", "Gn"])
def test_it_finds_the_best_of_400_values(settings):
    made = flag(settings)
    other = flag(settings, stiffness=47.0, mass=0.013)
    aim = Objective(made, simulate(other, tolerance=1e-10), 1e-6)
    axis = np.geomspace(LOWER, UPPER, POINTS[1])
    costs = np.array([aim.cost_or_infinity(np.array([value])) for value in axis])
    lowest = np.flatnonzero((costs[1:-1] < costs[:-2]) & (costs[1:-1] < costs[2:])) + 1
    assert len(lowest) > 1  # more minima than one: where a descent ends depends on where it starts
    ((bracket,), *_) = scan(aim, 0, parameters(made))
    best = int(costs.argmin())
    assert bracket == brackets(axis, best)


def test_it_finds_the_best_of_a_grid():
    made = flag("GG", 20, 3, 3)
    aim = Objective(made, simulate(made, tolerance=1e-10), 1e-6)
    axis = np.geomspace(LOWER, UPPER, POINTS[2])
    costs = np.array([[aim.cost_or_infinity(np.array([m, k])) for k in axis] for m in axis])
    first = scan(aim, 0, parameters(made))[0]
    i, j = np.unravel_index(costs.argmin(), costs.shape)
    assert [middle for _, middle, _ in first] == [axis[i], axis[j]]


def test_the_other_cloth_keeps_its_values_and_does_not_count():
    one = even("nG")["objects"][0]
    made = scene(one, {**one, "springStiffness": [900.0] * 33}, optimizationIterations=12)
    aim = Objective(made, simulate(made, tolerance=1e-10), 1e-6)
    p = np.array([1.0, 1.0])
    for cloth_index, true in ((0, 30.0), (1, 900.0)):
        ((low, middle, high),) = scan(aim, cloth_index, p)[0]
        assert low < true < high
        assert low < middle < high
    assert p.tolist() == [1.0, 1.0]


@pytest.mark.parametrize("frames", [2, 3, 7, 40])
def test_a_motion_that_is_followed_has_its_whole_cost(frames):
    aim = Objective(flag(frames=frames), simulate(flag(frames=frames, stiffness=60.0), tolerance=1e-10), 1e-4)
    course, p = PartialCost(aim, 0), np.array([3.0])
    whole = course.cost(p, np.inf)
    assert whole == pytest.approx(aim.cost(p), rel=1e-3)  # systems solved to 3e-4
    assert course.cost(p, 1.001 * whole) == whole
    assert frames < 40 or course.cost(p, 0.01 * whole) == np.inf  # what costs more is not followed


def test_where_it_diverges_it_is_infinite():
    made = load(even("nG", 60, integrationMethod=0, delta=0.004))
    aim = Objective(made, simulate(made), TIGHT)
    assert PartialCost(aim, 0).cost(np.array([1e4]), np.inf) == np.inf
    ((low, _, high),) = scan(aim, 0, np.array([1.0]))[0]
    assert low < 30.0 < high


def test_a_spectrum_is_not_a_sum_over_frames():
    made = flag(frames=30)
    aim = Objective(made, simulate(flag(frames=30, stiffness=60.0), tolerance=1e-10), 1e-6, objective="spectrum")
    course = PartialCost(aim, 0)
    assert [shorter for _, shorter in course.legs] == [{}]
    assert course.cost(np.array([60.0]), np.inf) < 1e-6 < course.cost(np.array([3.0]), np.inf)


def test_what_can_be_scanned():
    objects = [cloth(3, 3, optimizationSettings=settings) for settings in ("GG", "nG", "LG", "nn", "nL")]
    held = cloth(2, 2, optimizationSettings="GG", vertIsFixed=[True] * 4)
    extra = cloth(3, 3, optimizationSettings="nG", fit={"damping": "G"})
    made = scene(*objects, held, extra, optimizationIterations=4)
    aim = Objective(made, simulate(made))
    found = [[block.name for block in scannable(aim, index)] for index in range(7)]
    assert found == [["mass", "stiffness"], ["stiffness"], [], [], [], [], ["stiffness"]]


def test_a_grid_leaves_no_point_out():
    assert sorted(grid([11, 7])) == [(i, j) for i in range(11) for j in range(7)]
    assert sorted(grid([11, 7], 5)) == [(i, j) for i in (0, 5, 10) for j in (0, 5)]


def test_minima_and_brackets():
    costs = {(0,): 3.0, (1,): 1.0, (2,): 2.0, (3,): np.inf, (4,): 0.5}
    assert [point for point in costs if is_minimum(costs, point)] == [(1,), (4,)]
    assert minima(costs, 2.0) == [(4,), (1,)]
    assert minima(costs, 1.5) == [(4,)]
    assert minima({(0,): 3.0, (2,): 1.0, (3,): 0.9, (4,): 2.0}, 2.0, step=2) == [(3,), (2,)]
    axis = np.array([1.0, 2.0, 4.0])
    assert [brackets(axis, i) for i in range(3)] == [(1.0, 1.0, 2.0), (1.0, 2.0, 4.0), (2.0, 4.0, 4.0)]


@pytest.mark.parametrize("frames", [4, 80])
def test_a_few_dozen_motions_find_one_value(frames, monkeypatch):
    followed = []
    original = PartialCost.cost
    monkeypatch.setattr(PartialCost, "cost", lambda course, p, most: followed.append(1) or original(course, p, most))
    aim = Objective(flag(frames=frames), simulate(flag(frames=frames, stiffness=123.0), tolerance=1e-10), 1e-6)
    ((low, _, high),) = scan(aim, 0, np.array([1.0]))[0]
    assert low < 123.0 < high
    assert len(followed) < POINTS[1] / 2
