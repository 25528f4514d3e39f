"""Where a cost is smooth, and what a gradient is worth there, on functions that are known."""

import numpy as np
import pytest

from clothfit.derivative.verify import DIFFERENCE, ORDER
from clothfit.evaluation import gradient_check
from clothfit.evaluation.gradient_check import (
    FAILED,
    PASSED,
    UNCLEAR,
    Known,
    TaylorStep,
    calm,
    difference,
    judged,
    taylor,
)

NOISE = 1e-14
RIGHT = Known(2.0, 1e-13)


def steps(cost, noise=NOISE, switch=lambda t: ""):
    """The steps of a cost of t, with noise on it; G(0) = cost(0)."""
    rng = np.random.default_rng(3)

    def known(t):
        return cost(t) + noise * rng.uniform(-0.2, 0.2)

    start = known(0.0)
    pairs = [(t, known(t), known(-t)) for t in gradient_check.RELATIVE_STEPS]
    return [TaylorStep(t, plus + minus - 2 * start, 0.5 * (plus - minus), switch(t)) for t, plus, minus in pairs]


def smooth(t):
    """Of derivative 2 at 0."""
    return 1.0 + 2.0 * t + 3.0 * t**2 + 5.0 * t**3


def verdicts(found, derivative=RIGHT, noise=NOISE):
    short = calm(found, noise)
    return taylor(short, derivative, noise).verdict, difference(short, derivative, noise).verdict


def test_a_smooth_cost_is_calm_throughout_and_its_gradient_right():
    found = steps(smooth)
    assert calm(found, NOISE) == found
    order = taylor(found, RIGHT, NOISE)
    assert ORDER < order.measured < 2.2
    assert difference(found, RIGHT, NOISE).measured < 1e-8
    assert verdicts(found) == (PASSED, PASSED)


FAULTS, COARSE = [1.0, 1e-1, 1e-3, 1e-5], 1e-4
DIVERGES = [step if step.t < 1e-2 else TaylorStep(step.t, np.inf, np.inf, "diverged") for step in steps(smooth)]
CASES = {
    **{f"a fault of {fault:g}": (smooth, Known(2.0 * (1 + fault), 1e-13), NOISE, FAILED, FAILED) for fault in FAULTS},
    "a kink at the point itself": (lambda t: smooth(t) + abs(t), RIGHT, NOISE, UNCLEAR, UNCLEAR),
    "noise": (smooth, RIGHT, COARSE, UNCLEAR, UNCLEAR),
    "a fault far above noise": (smooth, Known(200.0, 1e-13), COARSE, FAILED, FAILED),
    "what depends on nothing": (lambda t: 1.0, Known(0.0, 0.0), 0.0, UNCLEAR, UNCLEAR),
    "a gradient of 0 that is wrong": (smooth, Known(0.0, 0.0), NOISE, FAILED, FAILED),
}


@pytest.mark.parametrize(("cost", "derivative", "noise", "first", "second"), CASES.values(), ids=CASES)
def test_a_fault_fails_however_small_it_is_and_what_cannot_be_known_is_unclear(cost, derivative, noise, first, second):
    assert verdicts(steps(cost, noise), derivative, noise) == (first, second)


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
        found = steps(cost, switch=switch)
        assert calm(found, NOISE)[-1].t == pytest.approx(1e-4)
        assert set(verdicts(found, derivative)) == {FAILED if fault else PASSED}


def test_why_a_test_is_unclear_and_how_far_it_looks():
    assert len(calm(steps(lambda t: smooth(t) + abs(t)), NOISE)) <= 1
    assert FAILED not in verdicts(steps(smooth), Known(2.0 * (1 + 3e-6), 1e-5))  # by rounding
    assert calm(DIVERGES, NOISE)[-1].t < 1e-2
    assert verdicts(DIVERGES) == (PASSED, PASSED)  # by short steps
    short = calm(steps(smooth, COARSE), COARSE)
    assert taylor(short, RIGHT, COARSE).why.endswith("3 are needed")
    assert difference(short, RIGHT, COARSE).why.startswith("known to ")
    still = steps(lambda t: 1.0, noise=0.0)
    assert difference(still, Known(0.0, 0.0), 0.0).why == "nothing that is checked changes the cost"


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
