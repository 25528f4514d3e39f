"""The motions that an objective keeps: simulated once, the same as anew, and few."""

import numpy as np
import pytest
from helpers.strangers import small

from clothfit.engine.tape import Tape
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.objective.run import KEPT
from clothfit.scene.fit_vector import parameters

pytestmark = pytest.mark.slow  # compiles a simulation and its gradient


@pytest.fixture
def simulated(monkeypatch):
    """The number of motions that were begun."""
    begun = []
    before = Tape.__init__

    def counted(self, *given, **named):
        begun.append(self)
        before(self, *given, **named)

    monkeypatch.setattr(Tape, "__init__", counted)
    return begun


def objective(**options):
    scene = small("nL", method=3)
    return Objective(scene, simulate(scene, tolerance=1e-12), 1e-10, **options)


def test_a_cost_and_its_derivatives_need_one_motion(simulated):
    aim = objective()
    p = 1.1 * parameters(aim.scene)
    del simulated[:]
    assert not aim.remembers(p)
    cost, (again, gradient) = aim.cost(p), aim.cost_and_gradient(p)
    change = aim.tangent(p, np.ones(len(p)))[0]
    assert len(simulated) == 1
    assert aim.remembers(p.copy())
    fresh = objective()
    assert (cost, again) == (fresh.cost(p), cost)
    np.testing.assert_array_equal(gradient, objective().cost_and_gradient(p)[1])
    np.testing.assert_array_equal(change, objective().tangent(p, np.ones(len(p)))[0])


def test_few_motions_are_kept(simulated):
    aim = objective()
    points = [parameters(aim.scene) * factor for factor in 1.0 + 0.1 * np.arange(KEPT + 1)]
    for p in points:
        aim.cost(p)
    assert [aim.remembers(p) for p in points] == [False] + KEPT * [True]


def test_little_memory_keeps_none(simulated):
    aim = objective(memory=10_000_000)  # a twentieth of which is less than 24 steps of 16 vertices, twice
    p = parameters(aim.scene)
    aim.cost(p)
    assert aim.remembers(p)
    aim = objective(memory=500_000)
    aim.cost(p)
    assert not aim.remembers(p)
