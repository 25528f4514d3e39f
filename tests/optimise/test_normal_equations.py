"""The normal equations, a few steps at a time, against the whole Jacobian."""

import numpy as np
import pytest
from helpers.costs import jacobian, residual, simulate_all
from helpers.marks import compiled
from helpers.physics import TIGHT, scene, xyz
from helpers.scenes import cloth

from clothfit.derivative.sensitivity import columns, sweep
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.objective.running_cost import MatrixResiduals, free_columns, last_step
from clothfit.optimise import trajectory as normal
from clothfit.scene.fit_vector import parameters, with_parameters

pytestmark = pytest.mark.slow  # compiles a fit

FRAMES, DELTA = 12, 0.02
OBJECTIVES = ["position", "velocity", "edge-length", "spectrum", {"position": 1.0, "edge-length": 2.0, "velocity": 0.1}]
TIMES = {
    "steps": np.arange(FRAMES) * DELTA,
    "between": (np.arange(FRAMES - 1) + 0.3) * DELTA,
    "every second": np.arange(0, FRAMES, 2) * DELTA,
    "two in a step": np.arange(20) * 0.5 * DELTA,
}
CHUNKS = {"one step": 1, "two steps": 250, "all": 10**9}  # 19 columns of 21 coordinates


def objective(kind, times, loss="linear"):
    """A small cloth in the wind against the motion of other parameters, seen at some times."""
    made = scene(
        cloth(3, 3, optimizationSettings="LG", dragCoefficient=0.3, fit={"springRestLength": "L"}),
        optimizationIterations=FRAMES,
        windVel=xyz((3, 1, -2)),
    )
    p = parameters(made)
    x = simulate(with_parameters(made, 1.3 * p), tolerance=TIGHT).positions
    places = times / DELTA
    below = np.minimum(places.astype(int), FRAMES - 2)
    share = (places - below)[:, None, None]
    seen = np.random.default_rng(5).uniform(size=(len(times), 9)) < (1.0 if kind == "spectrum" else 0.8)
    motion = Motion((1 - share) * x[below] + share * x[below + 1], times, (9,), seen)
    return Objective(made, motion, TIGHT, objective=kind, loss=loss, loss_scale=None if loss == "linear" else 0.05), p


def parts(aim, p):
    """∂r/∂x of the free coordinates, r, the sweep, and its size."""
    (run,) = aim.runs
    system, memory = simulate_all(aim, run, p)
    wanted = columns(system, aim.blocks, p, np.arange(len(p), dtype=np.int32), np.ones(len(p)), len(p))
    by_position = jacobian(run.comparison, memory.x)[:, free_columns(system.vertex.free, run.steps)]
    size = (3 * int(system.vertex.free.sum()), len(p))
    return by_position, residual(run.comparison, memory.x), lambda: sweep(system, memory, wanted), size


@compiled
@pytest.mark.parametrize("chunk", CHUNKS)
@pytest.mark.parametrize("times", TIMES)
@pytest.mark.parametrize("kind", OBJECTIVES, ids=str)
def test_it_is_the_product_of_the_whole_jacobian(kind, times, chunk, monkeypatch):
    aim, p = objective(kind, TIMES[times])
    by_position, r, steps, size = parts(aim, p)
    J = by_position @ np.concatenate([step.copy() for step in steps()])
    monkeypatch.setattr(normal, "CHUNK", CHUNKS[chunk])
    H, g = normal.accumulate(MatrixResiduals(by_position, r, size[0]), steps(), np.zeros(size))
    assert np.abs(J).max() > 0
    # sums of some hundred products in another order
    np.testing.assert_allclose(H, J.T @ J, atol=1e-13 * np.abs(J.T @ J).max())
    np.testing.assert_allclose(g, J.T @ r, atol=1e-13 * np.abs(J).max() * np.abs(r).sum())


@compiled
@pytest.mark.parametrize("loss", ["linear", "huber"])
@pytest.mark.parametrize("kind", OBJECTIVES, ids=str)
def test_twice_g_is_the_gradient_of_the_cost(kind, loss):
    aim, p = objective(kind, TIMES["steps"], loss)
    by_position, r, steps, size = parts(aim, p)
    _, g = normal.accumulate(MatrixResiduals(by_position, r, size[0]), steps(), np.zeros(size))
    _, gradient = aim.cost_and_gradient(p)
    # linear systems are solved to 1e-14 on both sides
    np.testing.assert_allclose(2 * g, gradient, atol=1e-10 * np.abs(gradient).max())


def test_random_rows_that_end_anywhere(monkeypatch):
    from scipy.sparse import random_array

    rng = np.random.default_rng(8)
    rows, count, steps = 6, 4, 9
    by_position = random_array((40, rows * steps), density=0.05, rng=rng, format="csr")  # some rows are empty
    X, r = rng.normal(size=(steps, rows, count)), rng.normal(size=40)
    J = by_position @ X.reshape(-1, count)
    for chunk in (1, 50, 75, 10**6):
        monkeypatch.setattr(normal, "CHUNK", chunk)
        H, g = normal.accumulate(MatrixResiduals(by_position, r, rows), iter(X), np.zeros((rows, count)))
        np.testing.assert_allclose(H, J.T @ J, atol=1e-13)  # rounding of numbers of about 1
        np.testing.assert_allclose(g, J.T @ r, atol=1e-13)


def test_the_array_that_the_sweep_uses_again_is_not_kept(monkeypatch):
    from scipy.sparse import eye_array

    array, expected = np.zeros((2, 1)), np.zeros(1)

    def steps():
        for t in range(3):
            array[:] = t + 1.0
            yield array

    r = np.arange(6.0)
    expected = np.repeat([1.0, 2.0, 3.0], 2) @ r
    for chunk in (1, 100):
        monkeypatch.setattr(normal, "CHUNK", chunk)
        H, g = normal.accumulate(MatrixResiduals(eye_array(6, format="csr"), r, 2), steps(), np.zeros((2, 1)))
        assert (H[0, 0], g[0]) == (2 * (1 + 4 + 9), expected)


def test_the_last_step_of_each_row():
    from scipy.sparse import csr_array

    dense = np.zeros((4, 6))
    dense[0, 1], dense[1, [0, 5]], dense[2, 2] = 1.0, 1.0, 1.0
    assert last_step(csr_array(dense), 2).tolist() == [0, 2, 1, -1]
