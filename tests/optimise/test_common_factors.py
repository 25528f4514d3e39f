"""One factor for all values of a kind: the model is that of all values along those directions."""

import numba
import numpy as np
import pytest
from helpers.physics import TIGHT, scene, xyz
from helpers.scenes import cloth

from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise.common_factors import Shared
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.fit_vector import parameters, with_parameters

pytestmark = [
    pytest.mark.slow,  # compiles a fit
    pytest.mark.skipif(numba.config.DISABLE_JIT, reason="dozens of simulations are slow without compilation"),
]


def both(settings="LL", **fit):
    """A model by all values and one by factors, of the same objective, at the same point."""
    own = [cloth(3, 3, optimizationSettings=settings, fit=fit), cloth(2, 3, optimizationSettings="nL")]
    made = scene(*own, optimizationIterations=9, windVel=xyz((3, 1, -2)), fit={"windVel": True})
    p = parameters(made)
    aim = Objective(made, simulate(with_parameters(made, 1.2 * p), tolerance=TIGHT), TIGHT)
    search = Search(aim, p, 0.0, 10**6)
    whole = Trajectory(search, aim)
    return whole, Shared(search, aim, whole.y(p))


def directions(shared):
    """∂y/∂z (Q, B)."""
    ends = np.eye(shared.size)
    return np.stack([shared.all(end) - shared.start for end in ends], axis=1)


@pytest.mark.parametrize(("settings", "fit"), [("LL", {}), ("GL", {"damping": "G"}), ("nL", {"springRestLength": "L"})])
def test_the_model_is_that_of_all_values_along_the_factors(settings, fit):
    whole, shared = both(settings, **fit)
    E = directions(shared)
    all_values, few = whole.model(shared.start), shared.model(np.zeros(shared.size))
    # both are sums of the same products in another order; systems solved to TIGHT
    np.testing.assert_allclose(few.H, E.T @ all_values.H @ E, rtol=1e-7, atol=1e-9 * np.abs(few.H).max())
    np.testing.assert_allclose(few.g, E.T @ all_values.g, rtol=1e-7, atol=1e-9 * np.abs(few.g).max())
    assert few.cost == pytest.approx(all_values.cost, rel=1e-12)


def test_the_slope_is_the_difference_of_the_cost():
    _, shared = both()
    z, d = np.full(shared.size, 0.05), 1e-5
    g = shared.model(z).g
    for i, unit in enumerate(np.eye(shared.size)):
        slope = (shared.cost(z + d * unit) - shared.cost(z - d * unit)) / (2 * d)
        assert 2 * g[i] == pytest.approx(slope, rel=1e-5)  # d² times the third derivative


def test_values_keep_their_proportions():
    whole, shared = both()
    p, q = shared.parameters(np.zeros(shared.size)), shared.parameters(np.full(shared.size, 0.3))
    each = [block for block in whole.objective.blocks if block.mode == "L"]
    assert each
    for block in each:
        own = np.arange(block.start, block.start + block.count)[whole.fitted[block.part]]
        assert np.ptp(q[own] / p[own]) < 1e-12
        assert q[own[0]] / p[own[0]] == pytest.approx(np.exp(0.3 / np.sqrt(len(own))))


def test_velocities_of_their_own_stay():
    whole, shared = both("nL", vertVel="L")
    moved = shared.parameters(np.ones(shared.size)) != shared.parameters(np.zeros(shared.size))
    kinds = {block.name for block in whole.objective.blocks if moved[block.part].any()}
    assert kinds == {"stiffness", "wind"}


def test_the_ends_are_where_the_last_value_comes_to_its_bound():
    whole, shared = both()
    lower, upper = shared.bounds
    low, high = whole.bounds
    for end, bound in ((lower, low), (upper, high)):
        there = shared.all(end)
        assert (np.sign(there - bound) * np.sign(end[0]) >= -1e-9)[shared.group == 0].all()
        assert np.abs(there - bound)[shared.group == 0].min() < 1e-9
