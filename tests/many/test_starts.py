"""Several starts: what is drawn, and what it depends on."""

import numpy as np
import pytest
from helpers.scenes import cloth, document, even, trial

from clothfit.fit.estimate import record_target
from clothfit.many.job import FACTOR, drawn, numbered
from clothfit.objective.identifiability import identifiable
from clothfit.scene.fit_vector import bounds, parameters
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow  # compiles a fit


def values(scene, number, seed=0, start=None):
    """The drawn start (P,) of a scene with a target."""
    return parameters(numbered(scene, record_target(scene), start, number, seed), flags=scene)


def test_the_first_start_is_what_was_given():
    scene = load(trial("Ln"))
    for start in (None, 0.3, scene):
        assert numbered(scene, record_target(scene), start, 0, 7) is start


def test_a_start_depends_on_seed_and_number_only():
    scene = load(trial("LL"))
    again, other, seeded = values(scene, 3), values(scene, 2), values(scene, 3, seed=1)
    np.testing.assert_array_equal(values(scene, 3), again)
    assert (values(scene, 3) != other)[identifiable(scene)].all()
    assert (values(scene, 3) != seeded)[identifiable(scene)].all()


def test_one_factor_for_each_kind_of_each_cloth_within_a_decade_either_way():
    scene = load(document(cloth(optimizationSettings="LL"), cloth(optimizationSettings="nL")))
    ratios = values(scene, 1) / parameters(scene)
    masses, stiffnesses, others = ratios[1:3], ratios[13:35], ratios[-20:]
    for part in (masses, stiffnesses, others):
        np.testing.assert_allclose(part, part[0], rtol=1e-14)  # one product each
        assert 1 / FACTOR < part[0] < FACTOR
    assert len({masses[0], stiffnesses[0], others[0]}) == 3


def test_factors_fill_the_decades_evenly_in_the_logarithm():
    scene = load(even("nG"))
    draw = np.random.default_rng(0)
    logs = np.log10([drawn(scene, np.array([1.0]), draw)[0] for _ in range(2000)])
    # a uniform distribution over (−1, 1): mean 0 ± 3 standard errors of 0.013, variance 1/3
    assert abs(logs.mean()) < 0.04
    assert logs.var() == pytest.approx(1 / 3, rel=0.06)


def test_what_no_motion_shows_keeps_its_value_and_the_rest_stays_within_the_bounds():
    heavy = [9e3] * 16
    scene = load(trial("Ln", vertMass=heavy))
    lower, upper = bounds(scene)
    for number in range(1, 6):
        p = values(scene, number)
        assert p[[0, 3]].tolist() == [9e3, 9e3]
        assert ((lower <= p) & (p <= upper)).all()


def test_vectors_are_shifted_by_their_size_at_most():
    scene = load({**even("nn"), "fit": {"windVel": True}})
    p = values(scene, 1)
    assert (p != 0).all()
    assert (np.abs(p) <= 5.0).all()  # m/s: the typical size of a wind


def test_of_a_hidden_truth_only_its_motion_matters():
    # masses and stiffnesses all times 4 move alike where there is no air: the same starts, the truth being unknown
    light, heavy = (
        load(even("nG", dragCoefficient=0.0, vertMass=[0.02 * k] * 16, springStiffness=[30.0 * k] * 33)) for k in (1, 4)
    )
    starts = [parameters(numbered(scene, None, None, 2, 0), flags=scene)[0] for scene in (light, heavy)]
    assert 4 * starts[0] / starts[1] == pytest.approx(1, rel=0.4)  # the coarse search's step is an eighth of a decade
    assert starts[0] != parameters(light)[0]
