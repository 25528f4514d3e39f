"""What is advised where a search has stalled: another thing where the error jumps than where it is smooth."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers.strangers import small

from clothfit.fit.residual_hints import SHIFT, around, with_stall_hint
from clothfit.fit.result import Fit
from clothfit.optimise.status import Status
from clothfit.scene.fit_vector import bounds, parameters


def fit(status=Status.STALLED, rmse=1e-3):
    """A fit of a factor and gravity."""
    scene = small("nF", fit={"gravity": "G"})
    return Fit(
        scene=scene, cost=rmse**2, rmse=rmse, status=status, evaluations=1, seconds=0.0, method="auto", frames=24,
        parameters=[], warnings=[],
    )  # fmt: skip


def objective(error, found):
    """One whose error is a function of the parameters."""
    scene = found.scene
    return SimpleNamespace(
        scene=scene, blocks=scene.blocks, identifiable=np.array([True, True, True, False]),
        cost_or_infinity=lambda p: error(p) ** 2, rmse=np.sqrt,
    )  # fmt: skip


def advice(error, **kind):
    found = fit(**kind)
    return [(hint.code, hint.text) for hint in with_stall_hint(found, objective(error, found)).hints]


def test_only_a_stalled_fit_that_is_off_is_advised():
    assert advice(lambda p: 2e-3, status=Status.CONVERGED) == []
    assert advice(lambda p: 2e-3, status=Status.LIMIT) == []
    assert advice(lambda p: 2e-3, rmse=0.0) == []


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (lambda p: 1e-3 * (1.0 + (p[0] - 1.0)), "fit again from its result"),
        (lambda p: 1e-3 + 5e-4 * (p[0] > 1.0), "change it by 50 %"),
        (lambda p: 1e-3 if p[0] > 1.0 else np.inf, "let it diverge"),
    ],
)
def test_the_advice_is_another_one_where_the_error_jumps(error, words):
    ((code, text),) = advice(error)
    assert code == "stalled"
    assert words in text
    assert ("jumps" in text) is ("fit again" not in text)


def test_values_around_are_a_millionth_off_within_their_bounds_and_only_those_that_are_fitted():
    found = fit()
    p = parameters(found.scene)
    lower, upper = bounds(found.scene)
    for sign, q in zip((1.0, -1.0), around(found, objective(lambda p: 1.0, found)), strict=True):
        change = sign * (q - p)
        np.testing.assert_allclose(change[[0, 2]], SHIFT * np.array([1.0, 9.81]), rtol=1e-6)
        assert change[3] == 0.0
        assert ((q >= lower) & (q <= upper)).all()
