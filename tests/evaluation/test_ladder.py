"""Where a cost is smooth, and what a gradient is worth there, on functions that are known."""

import numpy as np
import pytest

from clothfit.derivative.verify import DIFFERENCE, ORDER
from clothfit.evaluation import gradient_check
from clothfit.evaluation.gradient_check import FAILED, PASSED, UNCLEAR, Known, Rung, calm, difference, judged, taylor

NOISE = 1e-14
RIGHT = Known(2.0, 1e-13)


def rungs(cost, noise=NOISE, switch=lambda t: ""):
    """The rungs of a cost of t, with noise on it; G(0) = cost(0)."""
    rng = np.random.default_rng(3)

    def known(t):
        return cost(t) + noise * rng.uniform(-0.2, 0.2)

    start = known(0.0)
    pairs = [(t, known(t), known(-t)) for t in gradient_check.RELATIVE_STEPS]
    return [Rung(t, plus + minus - 2 * start, 0.5 * (plus - minus), switch(t)) for t, plus, minus in pairs]


def smooth(t):
    """Of derivative 2 at 0."""
    return 1.0 + 2.0 * t + 3.0 * t**2 + 5.0 * t**3


def verdicts(found, derivative=RIGHT, noise=NOISE):
    short = calm(found, noise)
    return taylor(short, derivative, noise).verdict, difference(short, derivative, noise).verdict


def test_a_smooth_cost_is_calm_throughout_and_its_gradient_right():
    found = rungs(smooth)
    assert calm(found, NOISE) == found
    order = taylor(found, RIGHT, NOISE)
    assert ORDER < order.measured < 2.2
    assert difference(found, RIGHT, NOISE).measured < 1e-8
    assert verdicts(found) == (PASSED, PASSED)


@pytest.mark.parametrize("fault", [1.0, 1e-1, 1e-3, 1e-5])
def test_a_wrong_gradient_fails_both_however_small_the_fault(fault):
    assert verdicts(rungs(smooth), Known(2.0 * (1 + fault), 1e-13)) == (FAILED, FAILED)


@pytest.mark.parametrize("fault", [0.0, 1e-3])
@pytest.mark.parametrize("height", [1e-3, 1e-1, 10.0])
@pytest.mark.parametrize("power", [0, 1])
def test_beyond_a_jump_or_a_kink_nothing_is_judged(fault, height, power):
    """Neither is a right gradient blamed for it nor a wrong one excused, whether anybody knows of it or not."""
    edge = 2e-4

    def cost(t):
        return smooth(t) + height * (t > edge) * (t - edge) ** power

    derivative = Known(2.0 * (1 + fault), 1e-13)
    for switch in (lambda t: "", lambda t: "contacts switch" if t > edge else ""):
        found = rungs(cost, switch=switch)
        assert calm(found, NOISE)[-1].t == pytest.approx(1e-4)
        assert set(verdicts(found, derivative)) == {FAILED if fault else PASSED}


def test_a_kink_at_the_point_itself_leaves_nothing_and_rounding_blames_nobody():
    found = rungs(lambda t: smooth(t) + abs(t))
    assert len(calm(found, NOISE)) <= 1
    assert verdicts(found) == (UNCLEAR, UNCLEAR)
    assert FAILED not in verdicts(rungs(smooth), Known(2.0 * (1 + 3e-6), 1e-5))


def test_a_motion_that_diverges_over_long_steps_is_judged_by_short_ones():
    found = [rung if rung.t < 1e-2 else Rung(rung.t, np.inf, np.inf, "diverged") for rung in rungs(smooth)]
    assert calm(found, NOISE)[-1].t < 1e-2
    assert verdicts(found) == (PASSED, PASSED)


def test_noise_makes_a_test_unclear_not_failed():
    noise = 1e-4
    found = rungs(smooth, noise)
    assert verdicts(found, noise=noise) == (UNCLEAR, UNCLEAR)
    assert taylor(calm(found, noise), RIGHT, noise).why.endswith("3 are needed")
    assert difference(calm(found, noise), RIGHT, noise).why.startswith("known to ")
    assert verdicts(found, Known(200.0, 1e-13), noise)[1] == FAILED  # a fault far above it


def test_a_cost_that_depends_on_nothing_shows_nothing():
    found = rungs(lambda t: 1.0, noise=0.0)
    assert verdicts(found, Known(0.0, 0.0)) == (UNCLEAR, UNCLEAR)
    assert difference(found, Known(0.0, 0.0), 0.0).why == "nothing that is checked changes the cost"
    assert verdicts(rungs(smooth), Known(0.0, 0.0)) == (FAILED, FAILED)  # but a gradient of 0 may be wrong


@pytest.mark.parametrize(
    ("blur", "measured", "verdict"),
    [
        (1e-16, 1e-7, PASSED),
        (1e-16, 1e-5, FAILED),
        (1e-5, 1e-5, UNCLEAR),
        (1e-5, 1e-3, FAILED),
        (1e-2, 1e-9, UNCLEAR),  # by chance
        (np.nan, 1.0, UNCLEAR),  # it overflows
    ],
)
def test_how_a_difference_is_judged(blur, measured, verdict):
    assert judged("difference", blur, measured, DIFFERENCE).verdict == verdict
