"""Student's t distribution: how many standard deviations an interval is wide that few residuals support.

SciPy has it too, in a package that takes longer to import than a small fit takes. With ν degrees of freedom,

    P(|T| < t) = I_x(1/2, ν/2),   x = t² / (ν + t²)

I is the regularised incomplete beta function, here by its continued fraction (DLMF 8.17.22), in the order that
converges. P is concave in t, so Newton's method from 0 never goes beyond the root.
"""

from __future__ import annotations

from math import exp, lgamma, log, log1p, sqrt

TINY = 1e-300  # in place of 0 in a denominator
STEPS = 200  # at most, of the fraction and of Newton's method


def half_width(coverage: float, freedom: float) -> float:
    """The t with P(|T| < t) = coverage, in [0, 1), for `freedom` degrees, above 0."""
    t, scale = 0.0, 2.0 * exp(lgamma((freedom + 1) / 2) - lgamma(freedom / 2)) / sqrt(freedom * 3.141592653589793)
    for _ in range(STEPS):
        density = scale * exp(-(freedom + 1) / 2 * log1p(t * t / freedom))
        step = (coverage - inside(t, freedom)) / density
        t += step
        if abs(step) <= 1e-12 * t:
            break
    return t


def inside(t: float, freedom: float) -> float:
    """P(|T| < t) for t at least 0."""
    if t == 0.0:
        return 0.0
    x, rest = t * t / (freedom + t * t), freedom / (freedom + t * t)
    if x < 3.0 / (freedom + 5.0):  # (a + 1) / (a + b + 2) of a = 1/2, b = ν/2
        return _beta(0.5, freedom / 2, x, rest)
    return 1.0 - _beta(freedom / 2, 0.5, rest, x)


def _beta(a: float, b: float, x: float, rest: float) -> float:
    """I_x(a, b) for x below (a + 1) / (a + b + 2); rest = 1 − x. The fraction by Lentz's method."""
    front = exp(lgamma(a + b) - lgamma(a) - lgamma(b) + a * log(x) + b * log(rest)) / a
    c, d = 1.0, 1.0 / _not_zero(1.0 - (a + b) * x / (a + 1.0))
    value = d
    for m in range(1, STEPS):
        for term in (
            m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)),
            -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1)),
        ):
            d, c = 1.0 / _not_zero(1.0 + term * d), _not_zero(1.0 + term / c)
            value *= c * d
        if abs(c * d - 1.0) < 1e-15:
            break
    return front * value


def _not_zero(value: float) -> float:
    return value if abs(value) > TINY else TINY
