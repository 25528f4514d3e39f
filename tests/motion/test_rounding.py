"""The rounding of a file's numbers is seen in the numbers, and only there."""

import numpy as np
import pytest

from clothfit.motion.degrade import rounding
from clothfit.motion.motion import Motion

FRAMES, VERTICES = 12, 30


def moving(size=1.0, seed=0):
    """Positions (12, 30, 3) of vertices that swing, but for the first, which is fixed."""
    generator = np.random.default_rng(seed)
    x = size * generator.uniform(-1.0, 1.0, (1, VERTICES, 3)) * np.ones((FRAMES, 1, 1))
    x[:, 1:] += 0.1 * size * generator.normal(size=(FRAMES, VERTICES - 1, 3))
    return x


def motion(x, observed=None, unit=1.0):
    """A motion of these positions."""
    return Motion(x, np.arange(float(len(x))), (x.shape[1],), observed, unit=unit)


def half(unit):
    """The root mean square distance of positions that are off by half a unit in each coordinate."""
    return 0.5 * np.sqrt(3.0) * unit


def test_float64_is_not_rounded():
    assert rounding(motion(moving())) == 0.0


@pytest.mark.parametrize("decimals", range(1, 10))
def test_decimals_of_text(decimals):
    x = np.array([[[float(f"{a:.{decimals}f}") for a in v] for v in frame] for frame in moving()])
    assert rounding(motion(x)) == pytest.approx(half(10.0**-decimals), rel=1e-12)  # rounding of the formula itself


@pytest.mark.parametrize("digits", range(3, 10))
def test_significant_digits_of_text(digits):
    x = np.array([[[float(f"{a:.{digits}g}") for a in v] for v in frame] for frame in moving(0.099)])
    places = np.array([f"{a:.{digits - 1}e}".split("e")[1] for a in x.ravel()], float)
    units = 10.0 ** (places + 1 - digits)
    assert rounding(motion(x)) == pytest.approx(half(np.sqrt((units**2).mean())), rel=1e-12)


@pytest.mark.parametrize("number", [np.float16, np.float32])
def test_floats_of_fewer_bits(number):
    x = moving().astype(number)
    units = np.spacing(np.abs(x)).astype(float)
    found = rounding(motion(x.astype(float)))
    assert found == pytest.approx(half(np.sqrt((units**2).mean())), rel=1e-12)
    error = np.sqrt(((x - moving()) ** 2).sum(axis=2).mean())
    assert 0.4 * found < error < found  # uniform between the halves: 1/√3 of it, about


@pytest.mark.parametrize("unit", [0.01, 0.0254, 100.0])
def test_the_unit_of_the_file_counts(unit):
    single = moving(1 / unit).astype(np.float32).astype(float)
    assert rounding(motion(single * unit, unit=unit)) == pytest.approx(unit * rounding(motion(single)), rel=1e-12)
    text = np.round(moving(1 / unit), 3)
    assert rounding(motion(text * unit, unit=unit)) == pytest.approx(half(1e-3 * unit), rel=1e-12)


def test_what_does_not_move_says_nothing():
    x = moving()
    x[:, 0] = 0.5  # round in every sense
    assert rounding(motion(x)) == 0.0
    assert rounding(motion(np.zeros_like(x))) == 0.0
    assert rounding(motion(x[:1])) == 0.0
    x[:, 1:] = np.round(x[:, 1:], 4)
    x[:, 0] = 1 / 3
    assert rounding(motion(x)) == pytest.approx(half(1e-4), rel=1e-12)


def test_what_is_not_observed_says_nothing():
    x, observed = np.round(moving(), 4), np.ones((FRAMES, VERTICES), bool)
    observed[3:5, 2], observed[:, 7] = False, False
    x[~observed] = np.nan
    assert rounding(motion(x, observed)) == pytest.approx(half(1e-4), rel=1e-12)


def test_free_fall_by_round_steps_is_not_text():
    """Sums of round numbers are near multiples of a power of ten, but do not keep to them."""
    v, x = np.zeros(3), [np.zeros((1, 3))]
    for _ in range(40):
        v = v + 0.02 * np.array([0.1, -9.81, 0.3])
        x.append(x[-1] + 0.02 * v)
    assert rounding(motion(np.array(x))) == 0.0
