"""Estimation methods against each other."""

import numba
import numpy as np
import pytest
from helpers.scenes import even, trial

from clothfit.base.errors import InvalidInput
from clothfit.evaluation import fit_methods
from clothfit.evaluation.evaluate import relative_deviations
from clothfit.evaluation.fit_methods import COMPARED, compare_methods
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.scene import load

pytestmark = [
    pytest.mark.slow,  # compiles a fit
    pytest.mark.skipif(numba.config.DISABLE_JIT, reason="hundreds of simulations need compilation"),
]

ONE = load(even("nG", 20))


def test_all_methods_find_one_stiffness():
    told = []
    rows = compare_methods(ONE, report=lambda seconds, what: told.append(what))
    assert [row.method for row in rows] == list(COMPARED)
    assert told == [f"fit by {method}" for method in COMPARED]
    assert {row.status for row in rows} == {"converged"}
    assert all(row.rmse <= 1e-8 for row in rows)  # where a fit ends
    assert all(row.median_relative_deviation < 1e-5 for row in rows)  # 1e-8 m where a factor e is decimetres
    points = [(row.seconds, row.rmse) for row in rows]
    beaten = [any(c <= cost and e <= error and (c, e) != (cost, error) for c, e in points) for cost, error in points]
    assert [row.pareto for row in rows] == [not worse for worse in beaten]


def test_the_evaluations_are_limited():
    (row,) = compare_methods(load(trial("nL", 8)), ["l-bfgs-b"], evaluations=4)
    assert (row.status, row.evaluations) == ("limit", 4)
    assert row.rmse > 0


def test_the_seconds_are_limited():
    (row,) = compare_methods(load(trial("nL", 8)), ["l-bfgs-b"], seconds=0.0)
    assert row.status == "limit"
    assert row.evaluations == 1


def test_the_deviation_is_the_median_of_what_can_be_identified():
    truth = load(trial("Ln", 8))
    factors = np.full(16, 1.2)
    factors[[0, 3]] = 50.0  # fixed vertices
    factors[5:8] = 1.0, 0.9, 3.0
    found = relative_deviations(truth, with_parameters(truth, parameters(truth) * factors))
    assert np.isnan(found[[0, 3]]).all()
    assert np.nanmedian(found) == pytest.approx(0.2)
    held = load(even("nG", 8, vertIsFixed=[True] * 16))
    assert np.isnan(relative_deviations(held, held)).all()


def test_what_cannot_be_is_refused():
    with pytest.raises(InvalidInput, match="there is no 'magic'"):
        compare_methods(ONE, ["magic"])
    with pytest.raises(InvalidInput, match="nothing to fit"):
        compare_methods(load(trial("nn", 8)))
    with pytest.raises(InvalidInput, match="evaluations must be at least 1"):
        compare_methods(ONE, evaluations=0)


def test_a_fit_that_finds_nothing_has_no_numbers(monkeypatch):
    class Nothing:
        scene, status, rmse, evaluations = ONE, "diverged", np.inf, 3

    monkeypatch.setattr(fit_methods, "estimate", lambda *given, **options: Nothing)
    (row,) = compare_methods(ONE, ["auto"])
    assert (row.status, row.rmse, row.median_relative_deviation, row.pareto) == ("diverged", None, None, False)
