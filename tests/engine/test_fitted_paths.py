"""Paths of pins that a fit finds: what they do, their derivatives with all that they meet, and fits."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.physics import keys, scene, sheet, xyz

from clothfit import estimate, simulate
from clothfit.engine.system import build
from clothfit.objective.target import target
from clothfit.optimise.balances import balances, track

pytestmark = pytest.mark.slow  # compiles a fit



def curtain(values, offset=(0, 0, 0), **fit):
    """A sheet whose held corners are drawn along keys each 0.1 s."""
    one = sheet("nn", 4, 4, fit=fit, damping=0.5, pinOffset=xyz(offset))
    one["pins"] = [{"vertices": [0, 3], "posKeys": keys([0, 0.1, 0.2, 0.3], values, interpolation="smooth")}]
    return scene(one, delta=0.01, optimizationIterations=31, tolerance=1e-12)


PATH, OFFSET = np.array([(0, 0, 0), (0.2, 0.05, 0), (0.1, 0.2, -0.1), (0.3, 0, 0.1)]), (0.03, -0.02, 0.01)


def unpinned(motion, made):
    """The motion without what it shows of fixed vertices."""
    return replace(motion, observed=np.broadcast_to(~made.cloths[0].fixed, motion.positions.shape[:2]).copy())


@pytest.mark.parametrize("hide", [True, False])
def test_a_fit_finds_the_path_of_pins_from_an_exact_target(hide):
    made = curtain(PATH, OFFSET)
    seen = unpinned(simulate(made), made) if hide else simulate(made)
    found = estimate(curtain(0 * PATH, posKeys="L", pinOffset="G"), seen)
    # positions are exact to 1e-12 m
    np.testing.assert_allclose(found.scene.cloths[0].path, PATH, atol=1e-8)
    np.testing.assert_allclose(found.scene.cloths[0].shift, OFFSET, atol=1e-8)
    assert found.parameters[0].unidentifiable == [0, 1, 2]  # the key at time 0


def test_in_noise_the_path_of_pins_is_within_its_intervals():
    made = curtain(PATH)
    seen = unpinned(simulate(made), made)
    noise = 1e-3 * np.random.default_rng(3).normal(size=seen.positions.shape)
    found = estimate(curtain(0 * PATH, posKeys="L"), replace(seen, positions=seen.positions + noise))
    ends = np.array(found.parameters[0].interval[3:])
    truth = PATH[1:].reshape(-1)
    assert ((ends[:, 0] < truth) & (truth < ends[:, 1])).all()
    assert (ends[:, 1] - ends[:, 0] < 0.01).all()


def test_without_a_target_pins_start_where_they_stand_still():
    made = curtain(PATH + [1.0, 2.0, 3.0], posKeys="L")
    found = estimate(made)
    assert found.rmse < 1e-8
    np.testing.assert_allclose(found.scene.cloths[0].path, made.cloths[0].path, atol=1e-6)


def test_balances_leave_out_the_neighbours_of_pins_whose_path_is_not_known():
    made = curtain(PATH, posKeys="L")
    motion, system = simulate(made), build(made, 0)
    for shown, goal in ((True, motion), (False, unpinned(motion, made))):
        rows = balances(system, track(target(goal, 0, made.delta), system))
        near = np.isin(system.springs.ends, [0, 3]).any(axis=1)
        neighbours = np.setdiff1d(system.springs.ends[near], [0, 3])
        assert rows.valid[:, neighbours].all() == shown
        left = np.where(rows.valid[..., None], rows.residual, 0.0)
        assert rows.valid.any()
        assert np.abs(left).max() < 1e-11  # differences of positions, 1e-16 m over 0.01 s, of masses of 0.1 kg
