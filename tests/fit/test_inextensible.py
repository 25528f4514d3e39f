"""Edges that hardly stretch: lower bounds of their stiffness are true, and as sharp as the noise lets them be."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import cloth, document, even

from clothfit import degrade, load
from clothfit.cli.common.output import Output
from clothfit.cli.parts.estimate_results import lower_bounds, summary
from clothfit.fit import result
from clothfit.fit.confidence import residual_variance
from clothfit.fit.estimate import estimate, record_target
from clothfit.fit.inextensible import LEAST_STRAIN, PLAYED, SURE_BOUND, UNSEEN, Profile, of_targets
from clothfit.fit.posterior import half_width
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.scene.fit_vector import parameters

pytestmark = pytest.mark.slow

STIFF, NOISE = 9e3, 1e-3  # N/m, which a weight of 0.6 N stretches by 0.07 mm; m


def chain(**fields):
    """Six vertices that swing from the first of them, on springs of one stiffness."""
    n = 7
    own = {
        "vertPos": [{"x": 0.06 * i, "y": -0.19 * i, "z": 0.0} for i in range(n)],
        "vertIsFixed": [True] + [False] * (n - 1), "vertMass": [0.01] * n,
        "springs": [i + j for i in range(n - 1) for j in (0, 1)], "springStiffness": [STIFF] * (n - 1),
        "triangles": [], "dragCoefficient": 0.0, "damping": 1.0, "optimizationSettings": "nG", "fit": {"damping": "G"},
    }  # fmt: skip
    return load(document({**cloth(2, 2), **own, **fields}, optimizationIterations=30, integrationMethod=3))


@pytest.fixture(scope="module", params=range(4))
def found(request):
    """A fit of a noisy motion of the chain."""
    scene = chain()
    target = degrade(record_target(scene), NOISE, seed=request.param)
    with pytest.MonkeyPatch.context() as patch:  # all that is not fitted is right, as in textbooks
        patch.setattr(result, "alternatives", lambda search: None)
        return scene, target, estimate(scene, target, start=500.0)


def test_a_lower_bound_is_true_and_where_the_cost_begins_to_rise(found):
    scene, target, fit = found
    stiffness, damping = fit.parameters
    assert fit.verdict.model == "adequate"
    assert (stiffness.at_least, damping.at_least) == (True, False)
    assert stiffness.unidentifiable == []
    assert stiffness.interval[0] is None or stiffness.interval[0][1] == 1e4  # a bound of the fit
    (least,) = stiffness.least
    assert least <= STIFF
    assert least < parameters(fit.scene)[0] <= 1.001 * max(PLAYED * least, 1e4)  # the end of the bounds
    objective = Objective(scene, target)
    search = Search(objective, parameters(fit.scene), 1e-8, 100)
    best, sigma2 = search.visit(search.start), residual_variance(search)
    rise = (SURE_BOUND * half_width(1e3)) ** 2 * sigma2

    def cost(k):  # with the damping that fits best there: the cost is quadratic in it to the rounding of this scan
        values = np.linspace(0.7, 1.3, 5)
        return np.polynomial.Polynomial.fit(
            values, [objective.cost_or_infinity(np.array([k, each])) for each in values], 2
        )

    def lowest(k):
        own = cost(k)
        return float(own(own.deriv().roots()[0].real))

    # it is found to a twentieth of its logarithm, and a fifth of the rise is left to the others; it is lower where
    # noise would have the compliance below 0
    assert 0.8 * rise < lowest(least) - min(lowest(1e4), lowest(STIFF)) < 1.6 * rise
    assert lowest(PLAYED * least) - lowest(1e4) < UNSEEN * rise
    assert best <= objective.cost_or_infinity(parameters(scene)) + UNSEEN * rise


def test_the_profile_is_that_of_a_quadratic():
    random = np.random.default_rng(1)
    J, r = random.normal(size=(9, 4)), random.normal(size=9)
    own = Profile.of(J.T @ J, J.T @ r, float(r @ r), 1, 0.0)

    def least(du):  # at this change of the compliance, over all others
        left = r - J[:, 1] * du
        return float(np.linalg.lstsq(J[:, [0, 2, 3]], left, rcond=None)[1][0])

    for du in (-0.5, 0.0, 2.0):
        assert own.value - 2 * own.slope * du + own.bend * du**2 == pytest.approx(least(du), rel=1e-12)
    assert least(own.up_to(least(0.0) + 3.0)) == pytest.approx(least(0.0) + 3.0, rel=1e-12)


def test_noise_is_no_strain():
    scene = chain()
    noisy = Objective(scene, degrade(record_target(scene), 2e-3, seed=1))  # 1.4 % of an edge
    own = of_targets(noisy, 0)
    assert np.sqrt(own.squares.mean()) > LEAST_STRAIN
    # of 6 springs in 30 frames the mean of what is left is known to a tenth of the noise
    assert abs((own.squares - own.noise).mean()) < 0.3 * own.noise.mean()


def test_where_the_model_differs_strains_give_the_bound():
    windy = replace(chain(dragCoefficient=0.5), wind=np.array([1.0, 0.0, 0.0]))
    scene = chain(vertMass=[0.01, 0.02, 0.005, 0.01, 0.01, 0.02, 0.01])
    fit = estimate(scene, record_target(windy), start=500.0)
    block, _ = fit.parameters
    assert fit.verdict.model == "differs"
    assert block.at_least
    known = [each for each in block.least if each is not None]
    assert known
    assert max(known) <= STIFF
    told = json.loads(json.dumps(summary(scene, fit, Output("x.json"))))["parameters"][0]
    assert (told["at_least"], told["least"]) == (True, block.least)
    assert "at least" in lower_bounds(block)


def test_a_cloth_that_stretches_has_no_lower_bounds():
    scene = load(even("nG", 25))
    fit = estimate(scene, degrade(record_target(scene), NOISE, seed=1), start=100.0)
    assert not any(block.at_least for block in fit.parameters)
