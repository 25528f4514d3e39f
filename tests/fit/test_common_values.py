"""Values that many springs share: how they are found, and what they make of fits to rounded motions."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.physics import xyz
from scipy.sparse import csr_array

from clothfit import estimate, load, simulate
from clothfit.fit import auto
from clothfit.fit.common_values import Common, fewest, grouped
from clothfit.meshes.mesh import object_document, plane, springs
from clothfit.motion.degrade import digits
from clothfit.objective.objective import Objective
from clothfit.optimise.balances import ANCHOR, anchor
from clothfit.optimise.search import Search
from clothfit.scene.fit_vector import parameters

TIGHT = 1e-12


def sheet(stiffness, side=8, steps=40):
    """A sheet of side² vertices that falls from one edge in the wind; `stiffness` of its edges and bendings."""
    mesh = plane(side - 2, 1.0)
    made, z = springs(mesh, 1.0), mesh.positions[:, 2]
    cloth = object_document(mesh, z == z.max(), density=0.1, stiffness=1.0, damping=0.1, drag=0.1, settings="nL")
    document = {
        "title": "sheet", "integrationMethod": 3, "delta": 0.02, "tolerance": TIGHT, "optimizationIterations": steps,
        "forwardSubSteps": 1, "printTimes": False, "windVel": xyz((1.0, 0.5, 2.0)), "colliders": [],
        "objects": [cloth | {"springStiffness": np.where(made.bends, *stiffness).tolist()}],
    }  # fmt: skip
    return load(document)


def to_tenths_of_micrometres(motion):
    return replace(motion, positions=np.round(motion.positions, 7))


def test_digits_are_those_that_a_file_shows():
    values = np.array([12.4994, 0.00020361, 149.51, 9.996])
    assert digits(3, values)[0].tolist() == [12.5, 0.000204, 150.0, 10.0]


def test_values_that_scatter_around_few_are_grouped_and_others_are_not():
    rng = np.random.default_rng(0)
    true = rng.choice([12.5, 50.0, 150.0], 600)
    values = true * (1.0 + 1e-4 * rng.standard_normal(600))
    values[:5] *= 1.2  # hardly determined: they go to the nearest
    labels = grouped(values, 3, 7)
    assert [np.unique(true[labels == group]).tolist() for group in (7, 8, 9)] == [[12.5], [50.0], [150.0]]
    assert (grouped(np.exp(rng.standard_normal(600)), 3, 0) == -1).all()  # each has its own


@pytest.mark.parametrize("stiffness", [(12.5, 50.0), (12.5 * np.pi / 3.0, 50.0 * np.e / 3.0)])
def test_a_rounded_motion_of_few_values_gives_them_back(stiffness, monkeypatch):
    monkeypatch.setattr(auto, "MANY", 0)
    made = sheet(stiffness)
    target = to_tenths_of_micrometres(simulate(made, tolerance=TIGHT))
    found = estimate(made, target, start=20.0)
    known = found.scene.cloths[0].stiffness != 20.0  # not of springs whose ends are both held
    true, values = made.cloths[0].stiffness[known], found.scene.cloths[0].stiffness[known]
    assert found.status == "converged"
    assert found.rmse <= Objective(made, target).rounding
    assert len(np.unique(values)) == 2
    if stiffness[0] == 12.5:
        assert np.array_equal(values, true)  # short numbers, to the last bit
    else:
        # as short as the rounding of 5e-8 m allows, of values that move vertices by centimetres
        np.testing.assert_allclose(values, true, rtol=5e-6)


def test_values_go_to_the_groups_that_they_share_most_simply():
    """Of values that scatter as some metric lets them: pairs that hardly show but in their sum, which are nearer to
    others, and groups that are parts of one.
    """
    rng = np.random.default_rng(0)
    true = np.repeat([12.5, 37.5, 50.0], 40)
    C = rng.standard_normal((400, 120))
    C[:, 1::10] = C[:, ::10] + 0.02 * C[:, 1::10]
    p = true + np.linalg.lstsq(C, 3.0 * rng.standard_normal(400), rcond=None)[0]
    begun = np.abs(p[:, None] - [12.0, 13.0, 37.0, 38.5, 50.0]).argmin(axis=1)
    assert (np.array([12.5, 12.5, 37.5, 37.5, 50.0])[begun] != true).any()
    H = csr_array(C.T @ C)
    values, groups = fewest(H, p, begun, np.zeros(120, int))
    assert len(np.unique(groups)) == 3
    for own in (groups == group for group in range(3)):
        assert len(np.unique(true[own])) == len(np.unique(values[own])) == 1
        # five σ of the sum of the columns of a group
        np.testing.assert_allclose(values[own], true[own], atol=5 * 3.0 / np.linalg.norm(C[:, own].sum(axis=1)))

    def left(x):
        return (x - p) @ (H @ (x - p))

    for i in range(0, 120, 7):
        other = values.copy()
        other[i] = values[(i + 50) % 120]
        assert left(other) >= left(values)
    block = np.arange(120) % 2
    assert len(np.unique(fewest(H, p, begun + 5 * block, block)[1])) == 6  # none is shared beyond a block


def test_a_common_value_lies_among_those_of_its_group():
    # of columns that nearly cancel, least squares takes values of any sign
    rng = np.random.default_rng(3)
    common = rng.standard_normal((60, 1))
    C = csr_array(common * np.tile([1.0, -0.9], 10))
    p = np.exp(rng.standard_normal(20))
    values, _ = fewest(csr_array(C.T @ C), p, np.zeros(20, int), np.zeros(20, int))
    assert p.min() <= values[0] == values[-1] <= p.max()


def test_values_that_are_all_different_are_left_alone(monkeypatch):
    monkeypatch.setattr(auto, "MANY", 0)
    made = sheet((12.5, 50.0))
    cloth = made.cloths[0]
    values = cloth.stiffness * np.exp(0.3 * np.random.default_rng(1).standard_normal(len(cloth.stiffness)))
    made = replace(made, cloths=(replace(cloth, stiffness=values),))
    target = to_tenths_of_micrometres(simulate(made, tolerance=TIGHT))
    found = estimate(made, target, start=20.0)
    assert found.rmse <= Objective(made, target).rounding
    assert len(np.unique(found.scene.cloths[0].stiffness)) > 0.9 * len(values)


@pytest.mark.parametrize(("settings", "fits"), [("nL", {"damping": "G"}), ("LL", {})])
def test_a_group_has_the_derivative_of_its_common_factor(settings, fits):
    made = sheet((12.5, 50.0), side=5, steps=20)
    made = replace(made, cloths=(replace(made.cloths[0], settings=settings, fits=fits),))
    target, p = simulate(made, tolerance=TIGHT), 1.2 * parameters(made)
    search = Search(Objective(made, target, TIGHT), p, 0.0, 100)
    labels = np.full(len(p), -1)
    for block in search.objective.blocks:
        if block.mode == "L":
            labels[block.part] = 10 * (1 + block.start) + np.arange(block.count) % 2  # any numbers, as of groups
    part = Common(search, search.objective, p, labels)
    assert part.size == {"nL": 3, "LL": 4}[settings]
    y, g = part.y(p), part.model(part.y(p)).g
    np.testing.assert_allclose(part.parameters(y), p, rtol=1e-14)  # of exponential and logarithm
    for k, step in enumerate(1e-4 * np.eye(part.size)):
        moved = [part.parameters(y + sign * step) for sign in (1.0, -1.0)]
        if k < len(part.first):
            assert len(np.unique((np.log(moved[0] / p) / 1e-4).round(6))) == 2  # one factor, of its group alone
        slope = np.subtract(*map(search.objective.cost, moved)) / 2e-4
        assert 2.0 * g[k] == pytest.approx(slope, rel=1e-5)  # step² of the difference, some hundred times


def test_masses_and_stiffnesses_come_back_from_a_rounded_motion_of_a_fabric(monkeypatch):
    """Masses that go with the area round each vertex, and stiffnesses of two families: the scene begins with other
    ones, which are as much too large for all. How large all are together, only the air shows.
    """
    monkeypatch.setattr(auto, "MANY", 0)
    made = sheet((12.5, 50.0))
    made = replace(made, cloths=(replace(made.cloths[0], settings="LL"),))
    target = to_tenths_of_micrometres(simulate(made, tolerance=TIGHT))
    cloth = made.cloths[0]
    start = replace(cloth, mass=1.7 * cloth.mass, stiffness=np.full(len(cloth.stiffness), 20.0))
    found = estimate(made, target, start=replace(made, cloths=(start,)))
    assert found.status == "converged"
    assert found.rmse <= Objective(made, target).rounding
    free = ~cloth.fixed
    factor = found.scene.cloths[0].mass[free] / cloth.mass[free]
    known = found.scene.cloths[0].stiffness != 20.0
    ratio = found.scene.cloths[0].stiffness[known] / cloth.stiffness[known]
    np.testing.assert_allclose(factor, factor[0], rtol=1e-12)  # one factor
    # rounding of 5e-8 m, in air that moves vertices by some decimetres
    np.testing.assert_allclose([*factor[:1], ratio.min(), ratio.max()], 1.0, rtol=2e-3)


def test_nothing_holds_masses_that_are_not_fitted():
    assert not anchor(np.zeros((4, 3)), 1e9).any()
    held = anchor(np.eye(3), 2.0)
    assert held @ held == pytest.approx(2.0 * ANCHOR)
