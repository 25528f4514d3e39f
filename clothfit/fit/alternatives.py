"""What else could explain a target: other values of what the scene holds as it is, another clock, another place.

Near a result the residuals are r + J d + E δ, with d the change of the fitted values and δ that of what is not fitted:
wind, gravity, drag, a factor on masses …, and the registration of each target. With H = [J E]ᵀ[J E], g = [J E]ᵀ r and
K = (H_dd + A)⁻¹, A the prior's matrix,

    S = H_δδ − H_δd K H_dδ,    s = g_δ − H_δd K g_d

Rao's score test: where the model is right, sᵀ S⁻¹ s / σ² is a χ² of as many degrees as δ has components. It looks where
a wrong model of that kind leaves its trace, so it finds what is far too little for a test of all residuals
(`whiteness`).

What no test finds may still be there, and moves the fitted values. Let δ be of the size τ at most that nobody would
notice in a scene (`DOUBTS`). From the target and that together, its mean and its covariance are

    m = −(S + σ² T⁻²)⁻¹ s,    C = σ² (S + σ² T⁻²)⁻¹,    T = diag τ

so the fitted values, which change by −K H_dδ δ, have intervals that are wider by this share (M. C. Kennedy and
A. O'Hagan, Bayesian calibration of computer models, J. R. Statist. Soc. B 63, 2001).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.base.eigen import eigen
from clothfit.base.messages import owned
from clothfit.fit.registration import OFFSET, PLACE, RATE, THETA, Unknowns
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion, at_frames
from clothfit.objective.experiment import Experiment, flagged_as
from clothfit.objective.objective import Objective
from clothfit.optimise import trajectory
from clothfit.optimise.evidence import inverse
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Trajectory
from clothfit.registration.record import Registration
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.kinds import CLOTH_KINDS, KIND, REST, SCENE_KINDS, Kind
from clothfit.scene.scene import Scene

DOUBTS = {"wind": 0.2, "gravity": 0.05, "velocity": 0.05}
"""τ in the unit of a kind: m/s, m/s², m/s."""

SHARES = {"damping": 0.3, "drag": 0.3, "rest": 0.005, "friction": 0.3, "contact": 0.3}
"""τ as a share of the scene's value. Masses and stiffnesses are relative to those of them that the scene holds."""

CLOCK, DELAY, TURN, SHIFT = 0.01, 0.1, 0.003, 0.002
"""τ of a clock's rate and of its offset, in frames, and of a place: rad, m."""

RARE = 5e-4
"""Probability in noise of one of the tests from which on it counts: with ten of them one fit in 200."""

OVER_TIME = ("path", "gusts")
"""Kinds whose values over time take up so much of what the scene lacks that they could be anything."""

ALIKE = 1e-6
"""Share of an effect that fitted values cannot make up for, below which it is rounding."""

RIDGE, REFINEMENTS = 1e-12, 4
"""Added to the unit diagonal of H_dd, so that directions which change nothing stay finite; and how often what this
changes is put right.
"""

EPSILON = 1e-13
"""Rounding of an eigenvalue relative to the largest."""

PART = 0.1
"""Operations for all this, as a share of those of the largest dense model."""

ALSO, MOST = 0.5, 3
"""Squares beside those of the best explanation from which on another one is named, and how many are."""

WAYS = {"clock": "--fit-time", "place": "--fit-placement"}
"""Options that fit what is no kind of the scene."""


class Found(NamedTuple):
    """What one test says against the model."""

    what: str  # the name of a kind, or one of `WAYS`
    chance: float  # probability of as much in noise
    squares: float  # that it explains, m²
    cloth: int | None
    change: Array  # δ (k,) that would explain them, in the unit of the kind, of logarithms where those are fitted


@dataclass(frozen=True, eq=False)
class Alternatives:
    """The residuals near a result by the coordinates z (log p, or p / σ) of N values that are fitted or could be."""

    H: Array  # (N, N)
    g: Array  # (N,)
    fitted: Indices  # (Q,), in the order of the search
    groups: list[tuple[str, int | None, Indices]]  # of what is tested together: its name, its cloth, and where it is
    doubt: Array  # τ (N,) in z
    unit: Array  # (N,), σ: 1 for logarithms

    @property
    def scale(self) -> Array:
        """1 / sqrt(H_ii) (N,), 0 where nothing is changed."""
        size = np.sqrt(np.maximum(np.diag(self.H), 0.0))
        return np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), 0.0)

    def seen(self, at: Indices, A: Array | None = None) -> tuple[Array, Array, Array]:
        """S (k, k) and s (k,) of those `at` (k,), and −K H_dδ (Q, k), by `scale`; A (Q, Q) is the prior's, in z."""
        own, by = self.fitted, self.scale
        unit = self.H * np.outer(by, by)
        prior = np.zeros((len(own), len(own))) if A is None else A * np.outer(by[own], by[own])
        own_part, across_part = unit[np.ix_(own, own)] + prior, unit[np.ix_(own, at)]
        K, across = inverse(own_part + RIDGE * np.eye(len(own))), np.zeros((len(own), len(at)))
        for _ in range(REFINEMENTS):
            across -= K @ (own_part @ across + across_part)
        S = unit[np.ix_(at, at)] + unit[np.ix_(at, own)] @ across
        return (S + S.T) / 2.0, by[at] * self.g[at] + across.T @ (by[own] * self.g[own]), across

    def improbable(self, sigma2: float) -> list[Found]:
        """What speaks against the model, the most improbable first; `sigma2`, m², is the variance of a residual."""
        from scipy.special import gammaincc  # of χ²

        found = []
        for what, cloth, at in self.groups:
            S, s, _ = self.seen(at)
            parts = eigen(S)
            if parts is None:
                continue
            values, vectors = parts
            kept = values > ALIKE
            change = -vectors[:, kept] @ ((vectors[:, kept].T @ s) / values[kept])
            squares = -float(s @ change)
            chance = float(gammaincc(0.5 * kept.sum(), 0.5 * max(squares, 0.0) / sigma2)) if kept.any() else 1.0
            if chance < RARE:
                found.append(Found(what, chance, squares, cloth, change * self.scale[at] * self.unit[at]))
        return sorted(found, key=lambda each: -each.squares)

    def widening(self, sigma2: float, A: Array) -> tuple[Array, Array]:
        """How far (Q,) the fitted values are moved, and with which variance, in z, by what may be there unnoticed."""
        at = np.flatnonzero((self.doubt > 0) & (self.scale > 0)).astype(np.int32)
        S, s, across = self.seen(at, A)
        tau, by = self.doubt[at] / np.where(self.scale > 0, self.scale, 1.0)[at], self.scale[self.fitted]
        parts = eigen(S)
        if parts is None or not len(at):
            return np.zeros(len(by)), np.full(len(by), np.inf if len(at) else 0.0)
        # what is below rounding is as good as one of the fitted values: τ alone bounds it
        values, vectors = parts
        S = (vectors * np.where(values > ALIKE, values, 0.0)) @ vectors.T
        values, vectors = np.linalg.eigh(S * np.outer(tau, tau))
        known = values > EPSILON * values.max(initial=0.0)
        effect = by[:, None] * (across * tau) @ vectors
        share = np.where(known, 1.0 / np.where(known, values + sigma2, 1.0), 0.0)
        moved = effect @ (share * (vectors.T @ (tau * s)))
        return np.abs(moved), effect**2 @ np.where(known, sigma2 * share, 1.0)


def alternatives(search: Search) -> Alternatives | None:
    """What else could explain the target at the best point of a search; None where positions are not what is compared,
    axes move, the cloth is at rest, values over time are fitted, it would take long, or the motion diverges.
    """
    objective, given = search.objective, search.objective.experiments
    if objective.scene.method == REST:
        return None
    free = freed(with_parameters(objective.scene, search.best.p))
    problem, start = Trajectory(search, objective), parameters(free)
    more = (len(start) + THETA) / max(problem.size, 1)
    expensive = more * problem.operations() > PART * trajectory.LARGEST or not problem.fits()
    expensive = expensive or any(block.name in OVER_TIME for block in objective.blocks)
    if expensive or list(objective.weights) != ["position"] or any(each.scene.frame for each in given):
        return None
    pairs = [Experiment(compared(objective, k), free if each.scene is objective.scene else flagged_as(each.scene, free))
             for k, each in enumerate(given)]  # fmt: skip
    known = [Registration()] * len(pairs)
    every = Unknowns(free, pairs, start, known, np.ones(THETA, bool), objective.loss, objective.tolerance)
    try:
        model = every.model(every.here)
    except Diverged:
        return None
    return arranged(search, free, every, model.H, model.g)


def compared(objective: Objective, k: int) -> Motion:
    """The frames of a target that an objective compares."""
    count = max(len(run.comparison.goal.step) for run in objective.runs if run.experiment == k)
    return at_frames(objective.experiments[k].motion, slice(count))


def arranged(search: Search, free: Scene, every: Unknowns, H: Array, g: Array) -> Alternatives:
    """What was found, by what it is of."""
    own = {(block.cloth, block.name): block for block in search.objective.blocks}
    fitted, groups, p, doubt = list[Array](), list[tuple[str, int | None, Indices]](), every.p, list[Array]()
    for block in free.blocks:
        at, values = np.arange(block.part.start, block.part.stop, dtype=np.int32), p[block.part]
        share = SHARES.get(block.name, 0.0) * (1.0 if block.kind.log else np.abs(values))
        doubt.append(np.broadcast_to(np.asarray(DOUBTS.get(block.name, share), float), len(at)))
        if (same := own.get((block.cloth, block.name))) is not None:
            fitted.append(at[search.fitted[same.part]])
            doubt[-1] = np.zeros(len(at))
        else:
            groups.append((block.name, block.cloth, at))
    unit = [np.where(every.coordinates.log, 1.0, every.coordinates.scale)]
    for k, near in enumerate(every.where):
        first = len(p) + THETA * k
        place = np.arange(first + PLACE.start, first + PLACE.stop, dtype=np.int32)
        groups += [("clock", None, np.array([first + at], np.int32)) for at in (RATE, OFFSET)]
        groups.append(("place", None, place))
        doubt.append(registration_doubts(every, k))
        unit.append(near.scale)
    units = np.concatenate(unit)
    return Alternatives(H, g, np.concatenate(fitted), groups, np.concatenate(doubt) / units, units)


def registration_doubts(every: Unknowns, k: int) -> Array:
    """τ (9,) of a target's registration; none of its scale."""
    times = every.given[k].motion.times
    frame = float(np.ptp(times)) / max(len(times) - 1, 1)
    return np.array([CLOCK, DELAY * frame, *[TURN] * 3, *[SHIFT] * 3, 0.0])


def freed(scene: Scene) -> Scene:
    """The scene with a flag for each kind of value that could be other than it says: one factor, or one value."""
    cloths = []
    for cloth in scene.cloths:
        modes = {kind.name: with_one(kind, cloth.mode(kind.name)) for kind in CLOTH_KINDS}
        settings = modes.pop("mass") + modes.pop("stiffness")
        cloths.append(replace(cloth, settings=settings, fits={name: m for name, m in modes.items() if m != "n"}))
    fits = {kind.name: with_one(kind, scene.mode(kind.name)) for kind in SCENE_KINDS}
    return replace(scene, cloths=tuple(cloths), fits={name: m for name, m in fits.items() if m != "n"}, main=None)


def with_one(kind: Kind, mode: str) -> str:
    """The mode of a kind, or one with few values where it has none."""
    if mode != "n" or kind.of == "key" or kind.name in ("shift", "offset"):
        return mode
    return next((letter for letter in "FG" if letter in kind.modes), "n")


def in_words(found: Sequence[Found], scene: Scene) -> str:
    """A sentence on what speaks against the model, of which the first explains most, with what helps."""
    alike = [each for each in found if each.squares >= ALSO * found[0].squares][:MOST]
    return (
        "what is left looks like noise, but it follows what would change with "
        f"{' or '.join(dict.fromkeys(named(each, scene) for each in alike))}; the fitted values make up for a part of "
        "it, so correct that, or fit it as well"
    )


def named(found: Found, scene: Scene) -> str:
    """What one test is of, with the change that would explain the target."""
    if found.what in WAYS:
        return f"the {found.what} of the target ({WAYS[found.what]})"
    kind = KIND[found.what] if found.cloth is None else scene.cloths[found.cloth].kind(found.what)
    by = ", ".join(f"{value:.2g}" for value in found.change) + kind.suffix
    if kind.log:
        by = f"{100 * float(np.expm1(np.clip(found.change[0], -9.0, 9.0))):+.2g} %"
    return f"{owned(found.cloth, kind.title)} (by {by})"
