"""A cost chunk by chunk against that of the whole motion, and residuals against those of a comparison."""

from itertools import pairwise

import numpy as np
import pytest
from helpers import costs
from helpers.physics import TIGHT, gentle, scene
from helpers.scenes import cloth

from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.motion.motion import Motion
from clothfit.objective.comparison import OBJECTIVES, Comparison, Loss
from clothfit.objective.running_cost import (
    DistanceResiduals,
    KeptStates,
    SquaredDistances,
    free_columns,
    movable,
    running_cost,
)
from clothfit.objective.target import target

STEPS = 11
SYSTEM = gentle()
N = len(SYSTEM.x0)
TIMES = {
    "steps": np.arange(STEPS + 1.0),
    "some steps": np.array([2.0, 3.0, 7.0]),
    "between": np.array([0.4, 0.5, 1.25, 1.5, 3.0, 3.9, 4.0, 4.1, 4.9, 8.5, 10.999]),
    "spread": 0.77 * np.arange(14),
}
MIXED = {"position": 2.0, "velocity": 0.01, "edge-length": 0.5}
COSTS = {
    "plain": ({"position": 1.0}, Loss()),
    "scaled": ({"position": 0.3}, Loss()),
    "robust": ({"position": 1.0}, Loss("huber", 0.05)),
    "mixed": (MIXED, Loss("soft_l1", 0.05)),
    "spectrum": ({"spectrum": 1.5}, Loss()),
}
PARTS = [(STEPS,), (1,) * STEPS, (4, 4, 3), (1, 5, 2, 3)]


def compared(times, cost="plain", partly=True):
    """A random target with gaps and weights."""
    objective, loss = COSTS[cost]
    places = TIMES[times]
    rng = np.random.default_rng(3)
    seen = rng.random((len(places), N)) < (1.0 if cost == "spectrum" or not partly else 0.7)
    weights = rng.uniform(0.5, 2, seen.shape) if partly else None
    x = SYSTEM.x0 + 0.1 * rng.normal(size=(len(places), N, 3))
    motion = Motion(x, SYSTEM.h * places, (N,), seen, weights=weights)
    return Comparison(target(motion, 0, SYSTEM.h), SYSTEM, objective, loss)


def cut(memory, lengths):
    """The parts of a motion, of these lengths."""
    ends = np.cumsum([0, *lengths])
    return [memory.part(int(a), int(b)) for a, b in pairwise(ends)]


def moved(made):
    """A motion as long as it is compared, and parts of it."""
    memory, _ = rollout(SYSTEM, made.last_step, TIGHT)
    return memory


def fitting(lengths, steps):
    """Lengths of parts that make so many steps."""
    ends = np.minimum(np.cumsum(lengths), steps)
    return [int(d) for d in np.diff([0, *ends]) if d]


@pytest.mark.parametrize("lengths", PARTS, ids=str)
@pytest.mark.parametrize("times", ["steps", "some steps", "between", "spread"])
@pytest.mark.parametrize("cost", ["plain", "scaled", "robust", "mixed"])
def test_cost_and_derivative_are_the_same_to_the_last_bit(cost, times, lengths):
    made = compared(times, cost)
    memory, running = moved(made), running_cost(made)
    parts = cut(memory, fitting(lengths, made.last_step))
    for part in parts:
        running.update(part)
    value, derivative = costs.cost_and_derivative(made, memory.x)
    assert running.value == value == costs.cost(made, memory.x)
    for part in reversed(parts):
        found = running.derivative(part)[1 : part.steps + 1]
        np.testing.assert_array_equal(found, derivative[part.first + 1 : part.first + part.steps + 1])


@pytest.mark.parametrize("times", ["steps", "spread"])
def test_a_spectrum_is_known_from_chunks(times):
    made = compared(times, "spectrum")
    memory, running = moved(made), running_cost(made)
    for part in cut(memory, fitting((4, 4, 3), made.last_step)):
        running.update(part)
    assert running.value == costs.cost(made, memory.x)


@pytest.mark.parametrize("cost", COSTS)
def test_only_squared_distances_need_no_states(cost):
    found = running_cost(compared("steps", cost))
    assert isinstance(found, SquaredDistances if cost in ("plain", "scaled") else KeptStates)
    assert (found.bytes > 0) == (found.residual_bytes > 0) == isinstance(found, KeptStates)


def test_every_objective_is_tried():
    shadows = {"outline", "coverage"}  # of whole cloths at rest, in tests/engine/test_equilibrium.py
    assert {name for objective, _ in COSTS.values() for name in objective} == set(OBJECTIVES) - shadows


@pytest.mark.parametrize("times", TIMES)
@pytest.mark.parametrize("length", [1, 3, STEPS])
@pytest.mark.parametrize("partly", [True, False])
def test_running_residuals_are_those_of_the_comparison(times, length, partly):
    made = compared(times, "scaled", partly)
    memory, free = moved(made), SYSTEM.vertex.free
    found = DistanceResiduals(made.goal, free, made.distance_scale)
    for part in cut(memory, fitting((2,) * STEPS, made.last_step)):
        found.update(part)
    wide = 3 * int(free.sum())
    residuals, rows = [], []
    for first in range(0, made.last_step, length):
        end = min(first + length, made.last_step)
        by_position, r = found.linearised(first, end)
        padded = np.zeros((by_position.shape[0], wide * (made.last_step + 1)))
        padded[:, wide * first : wide * (end + 1)] = by_position.toarray()
        rows.append(padded)
        residuals.append(r)
    J = costs.jacobian(made, memory.x).toarray()[:, np.tile(np.repeat(free, 3), made.last_step + 1)]
    kept = np.abs(J[:, wide:]).sum(axis=1) > 0
    np.testing.assert_allclose(np.concatenate(rows)[:, wide:], J[kept, wide:], rtol=1e-15)  # roots of weights, rounded
    np.testing.assert_allclose(np.concatenate(residuals), costs.residual(made, memory.x)[kept], rtol=1e-13, atol=1e-15)
    assert 3 * movable(made.goal, free).sum() == kept.sum()
    assert found.gaps.keys() <= {0}  # the initial state is never asked for


@pytest.mark.parametrize("cost", COSTS)
def test_squares_are_those_of_the_residuals_that_can_change(cost):
    made = compared("spread", cost)
    memory, free = moved(made), SYSTEM.vertex.free
    squares, count = running_cost(made).squares(free, lambda observe: [observe(part) for part in cut(memory, (4, 7))])
    J, r = costs.jacobian(made, memory.x), costs.residual(made, memory.x)
    kept = np.diff(J[:, free_columns(free, made.last_step)].indptr) > 0
    assert count == kept.sum()
    assert squares == pytest.approx((r[kept] ** 2).sum(), rel=1e-13)  # another order of summation


def test_a_target_is_not_copied():
    one = scene(cloth(3, 3), optimizationIterations=4)
    motion = Motion(np.zeros((4, 9, 3)), 0.02 * np.arange(4), (9,))
    made = Comparison(target(motion, 0, 0.02), build(one, 0))
    assert np.shares_memory(made.goal.positions, motion.positions)
