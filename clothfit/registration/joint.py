"""Clock, place and scale of fitted targets beside all the values of the fit: what is left to go, and 95 % intervals.

Near the result the cost is |r|² + 2 gᵀz + zᵀ H z in the values and the registrations together, and the prior of the fit
adds A = (σ²/τ²) P to the values of a kind. With the values at their minimum, the step to that of all is
−(H + A)⁻¹ (0, g_θ), in which they follow the registrations, and the registrations' covariance is their block of
σ² (H + A)⁻¹: what another stiffness could make up for counts as unknown. Both are mapped to the numbers that are shown
by their derivative; the step that is left is added to the half width.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.motion.divergence import Diverged
from clothfit.objective.comparison import Loss
from clothfit.objective.experiment import Experiment
from clothfit.optimise.coordinates import Coordinates
from clothfit.optimise.evidence import inverse, variance
from clothfit.optimise.prior import WIDEST
from clothfit.registration.record import Registration
from clothfit.registration.residuals import RATE, THETA, Around, Registered, Sums, around
from clothfit.scene.fit_vector import parameters
from clothfit.scene.scene import Scene

TOLERANCE = 1e-5
"""Of the linear systems: intervals and steps need no better."""

MOST = 1500
"""Values beside which this is looked for."""

NORMAL = 1.96
"""Standard deviations of a 95 % interval."""

STEP = 1e-5
"""Of the derivative by coordinates, whose 1 is a large change."""

SETTLED = 0.5
"""Step relative to the half width of the interval up to which it is not worth another fit."""

STEADY = 0.1
"""Distance of a rate from 1, relative to the same, that is worth another fit where the data show no other rate than 1:
cameras keep time, and a rate that only noise moves would move the stiffnesses with it.
"""


class Joint(NamedTuple):
    """What is known of the registrations of a fit."""

    known: list[Registration]  # as they were, with intervals
    moved: list[Registration] | None  # where the step leads; None where that says nothing beside the noise


def joint(
    scene: Scene,
    given: Sequence[Experiment],
    known: Sequence[Registration],
    free: Flags,
    loss: Loss,
    sigma: float | None,
    taus: Mapping[tuple[int | None, str], float],
) -> Joint | None:
    """The registrations with the intervals of those coordinates (9,) that are `free`, and where they should be.

    `scene` has the fitted values, `given` the targets as they came; `sigma`, m, is that of a residual (None: from what
    is left), `taus` the width of the prior by object and kind. None where the motion diverges, or there are too many
    values.
    """
    p = parameters(scene)
    if not 0 < len(p) <= MOST:
        return None
    where = [around(own, each.motion) for own, each in zip(known, given, strict=True)]
    registered = Registered(scene, given, loss, TOLERANCE, summing=True)
    try:
        sums = registered.sums(p, where, np.zeros((len(given), THETA)), Coordinates(scene, p).change(p))
    except Diverged:
        return None
    residuals = 3 * sum(int(each.motion.seen().sum()) for each in given)
    sigma = float(np.sqrt(variance(sums.cost, residuals, 0.0))) if sigma is None else sigma
    if not sigma > 0:
        return None
    covariance, step = solved(scene, sums, np.tile(free, len(given)), sigma, taus)
    found, moved, far = [], [], False
    for k, (each, near) in enumerate(zip(known, where, strict=True)):
        own = slice(len(p) + THETA * k, len(p) + THETA * (k + 1))
        J, by = by_coordinates(near), step[own]
        width, away = NORMAL * sigma * np.sqrt(np.diag(J @ covariance[own, own] @ J.T)), np.abs(J @ by)
        found.append(replace(each, within=width + away))
        most_likely = near.at(by)
        keeps_time = free[RATE] and abs(most_likely.rate - 1.0) <= width[RATE]
        moved.append(with_rate_1(near, by, covariance[own, own], J) if keeps_time else most_likely)
        far |= bool((np.abs(moved[-1].numbers - each.numbers) > SETTLED * width).any())
        far |= bool(keeps_time and abs(each.rate - 1.0) > STEADY * width[RATE])
    return Joint(found, moved if far else None)


def with_rate_1(near: Around, step: Array, covariance: Array, J: Array) -> Registration:
    """The most likely registration with a clock of rate 1, from the `step` (9,) to the most likely one, their
    covariance (9, 9) and the derivative J (9, 9) of its numbers.
    """
    if not covariance[RATE, RATE] > 0:
        return replace(near.at(step), rate=1.0)
    way = (1.0 - near.at(np.zeros(THETA)).rate) / J[RATE, RATE] - step[RATE]
    return replace(near.at(step + covariance[:, RATE] / covariance[RATE, RATE] * way), rate=1.0)


def solved(
    scene: Scene, sums: Sums, free: Flags, sigma: float, taus: Mapping[tuple[int | None, str], float]
) -> tuple[Array, Array]:
    """(H + A)⁻¹ (Q, Q) on the values and the `free` of the 9 K other coordinates, and the step (Q,)."""
    H, count = sums.H.copy(), len(sums.g) - len(free)
    for block in scene.blocks:
        tau = taus.get((block.cloth, block.name), WIDEST if block.mode == "L" and block.kind.log else None)
        if tau is not None:
            H[block.part, block.part] += (sigma / tau) ** 2 * (np.eye(block.count) - 1.0 / block.count)
    chosen = np.concatenate([np.ones(count, bool), free]) & (np.diag(H) > 0)
    scale, every = 1.0 / np.sqrt(np.diag(H)[chosen]), np.ix_(chosen, chosen)
    covariance = np.zeros_like(H)
    covariance[every] = inverse(H[every] * np.outer(scale, scale)) * np.outer(scale, scale)
    return covariance, -covariance @ np.concatenate([np.zeros(count), sums.g[count:]])


def by_coordinates(near: Around) -> Array:
    """The derivative (9, 9) of a registration's numbers by its coordinates."""
    ends = [[near.at(sign * STEP * e).numbers for sign in (1.0, -1.0)] for e in np.eye(THETA)]
    return np.stack([(up - down) / (2.0 * STEP) for up, down in ends], axis=1)
