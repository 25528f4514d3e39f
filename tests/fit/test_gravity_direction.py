"""Gravity keeps its direction until another one pays: algebra of the tests, and fits whose model differs."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.strangers import sheet

from clothfit.fit import frame_blocks, hierarchy
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.scene.fit_vector import parameters

G = 9.81
FREE = {  # gravity, and which of its components may turn
    "down": ((0.0, -G, 0.0), [True, False, True]),
    "another axis": ((0.0, 0.0, -G), [True, True, False]),
    "aslant": ((1.0, -G, 0.0), [False, False, True]),
    "none": ((0.0, 0.0, 0.0), [False, False, False]),
}


def falling(gravity, **fields):
    """A sheet of which one factor and gravity are free."""
    return replace(sheet(letters="nF", frames=30), gravity=np.array(gravity), fits={"gravity": "G"}, **fields)


def quadratic(count):
    """H (Q, Q) and g (Q,) of a quadratic cost, and what each of six blocks adds to them."""
    random = np.random.default_rng(3)
    J, r = random.normal(size=(6, 20, count)), random.normal(size=(6, 20))
    return np.einsum("bni,bnj->bij", J, J), np.einsum("bni,bn->bi", J, r), J, r


@pytest.mark.parametrize("case", FREE)
def test_components_that_are_zero_beside_others_are_held(case):
    gravity, expected = FREE[case]
    assert frame_blocks.held(falling(gravity)).tolist() == [False, *expected]


def test_gravity_is_free_where_the_wind_is():
    scene = falling((0.0, -G, 0.0))
    assert not frame_blocks.held(replace(scene, fits={"wind": "G", "gravity": "G"})).any()


def test_the_saving_is_that_of_linear_least_squares():
    H, g, J, r = quadratic(5)
    J, r, more = J.reshape(-1, 5), r.reshape(-1), np.array([False, True, False, False, True])
    few, every = (float(np.linalg.lstsq(each, -r)[1][0]) for each in (J[:, ~more], J))
    found = frame_blocks.saving(H.sum(axis=0), g.sum(axis=0), more)
    assert found == pytest.approx(few - every, rel=1e-10)  # of sums of 120 products


def test_t_is_that_of_fits_without_each_block():
    H, g, J, r = quadratic(3)
    whole = np.linalg.lstsq(J.reshape(-1, 3), -r.reshape(-1))[0]
    others = [np.delete(np.arange(6), b) for b in range(6)]
    without = np.array([np.linalg.lstsq(J[own].reshape(-1, 3), -r[own].reshape(-1))[0] for own in others])
    error = np.sqrt(5.0 / 6.0 * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    found = frame_blocks.t_values(H.sum(axis=0), g.sum(axis=0), H, g)
    assert found == pytest.approx(np.abs(whole) / error, rel=1e-10)


@pytest.mark.parametrize(("slope", "turns"), [(0.0, False), (2.0, True)])
def test_gravity_turns_where_the_target_falls_aslant_and_nowhere_else(slope, turns):
    true = falling((slope, -0.8 * G, 0.0))
    cloth = true.cloths[0]
    scattered = cloth.stiffness * np.exp(0.5 * np.random.default_rng(1).normal(size=len(cloth.stiffness)))
    motion = simulate(replace(true, cloths=(replace(cloth, stiffness=scattered),)))
    scene = falling((0.0, -G, 0.0))
    search = Search(Objective(scene, motion, 1e-8), parameters(scene), 0.0, 500)
    hierarchy.refine(search, ["F"], [search.start])
    found = search.best.p[1:]
    assert (found[0] != 0.0) == turns
    assert found == pytest.approx([slope, -0.8 * G, 0.0], abs=0.05 * G)  # what another fabric is taken for
