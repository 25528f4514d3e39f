"""The coordinates of a fit: there and back, bounds, and their slope."""

import json

import numpy as np
from helpers.physics import xyz
from helpers.scenes import cloth, document, load_text

from clothfit.optimise.coordinates import Coordinates
from clothfit.scene.fit_vector import bounds, parameters

EVERY = {"damping": "G", "dragCoefficient": "G", "vertVel": "L", "springRestLength": "G"}
SCENE = load_text(
    json.dumps(
        document(
            cloth(3, 3, optimizationSettings="GL", fit=EVERY, damping=3.0, vertVel=[xyz((1, -2, 0.5))] * 9),
            cloth(2, 2, dragCoefficient=0.0),
            fit={"windVel": True, "gravity": True},
            windVel=xyz((8, 0, -1)),
        )
    )
)
P = parameters(SCENE)
MADE = Coordinates(SCENE, P)
# parameters: 1 mass, 16 stiffnesses, damping, drag, 27 velocities, 1 factor, wind, gravity
C = np.sqrt([9] + [1] * 16 + [9, 9] + [1] * 27 + [16] + [9] * 3 + [13] * 3)  # one cloth feels the wind, both gravity


def test_logarithms_or_multiples_of_the_typical_size_weighted_by_what_moves():
    sizes = [3.0, 1.0, *np.maximum(np.abs(P[19:46]), 1.0), 8.0, 5.0, 5.0, 10.0, 10.0, 10.0]
    logs = [*np.log(P[:17]), *(P[17:46] / sizes[:29]), np.log(P[46]), *(P[47:] / sizes[29:])]
    np.testing.assert_allclose(MADE.y(P), C * logs, rtol=1e-14, atol=1e-15)  # rounding


def test_there_and_back():
    p = P + 0.25
    np.testing.assert_allclose(MADE.p(MADE.y(p)), p, rtol=1e-13)  # rounding of log and exp


def test_both_ways_stay_within_the_bounds():
    lower, upper = bounds(SCENE)
    for far, end, side in ((-1e9, lower, MADE.lower), (1e9, upper, MADE.upper)):
        p = np.full(len(P), far)
        np.testing.assert_array_equal(MADE.y(p), side)
        np.testing.assert_allclose(MADE.p(side + far), end, rtol=1e-13)  # rounding of log and exp
        np.testing.assert_allclose(MADE.p(side), end, rtol=1e-13)


def test_the_derivative_is_that_of_the_parameters():
    y, t = MADE.y(P + 0.5), 1e-6
    measured = (MADE.p(y + t) - MADE.p(y - t)) / (2 * t)
    # Rounding: 1e-16 / 1e-6 of values up to 100.
    np.testing.assert_allclose(MADE.derivative(MADE.p(y)), measured, rtol=1e-8)


def test_nothing_to_fit_has_no_coordinates():
    made = Coordinates(load_text(json.dumps(document())), np.zeros(0))
    assert [len(part) for part in (made.lower, made.upper, made.y(np.zeros(0)))] == [0, 0, 0]
