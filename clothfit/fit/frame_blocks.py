"""What blocks of successive frames, each kept out in turn, say of the direction of gravity and of the kinds of a fit.

Gravity keeps its direction until another one pays.

The scene knows which way is down better than a motion that its model cannot reproduce: two more values than gravity's
size always come nearer to the frames that are fitted, by turning what the model lacks into a slope, and may lead away
on those after them. So a component of gravity that is 0 beside one that is not stays 0, until a step of Gauss–Newton by
it as well

- would save most of the cost, or
- is certain: without any one of B blocks of successive frames it would be much the same (the jackknife),

      d = −H⁻¹ g,    d_b = −(H − H_b)⁻¹ (g − g_b),    t² = d² / ((B − 1)/B Σ_b (d_b − d̄)²)

Where the wind is fitted as well, it may push any way; gravity is then as free.

Which kinds a fit does without, beside the values of its cloths: those that take it farther from frames kept out.

At the values y of a model with all kinds the residuals are r + J d. Each of B blocks of successive frames is kept out
in turn, and the step

    d_b = −(H − H_b)⁻¹ (g − g_b),    E = Σ_b |r_b + J_b d_b|²

says what comes of it there; without a kind, whose coordinates go back to where they began, d_b is found with these
given. A kind is left out without which E is lower by more than `HARM` of what is left, the most harmful one first,
unless steps of Gauss–Newton without all that were left out end clearly farther away. One that frames kept out say
nothing of stays free: finer models may need it.

M. Stone, Cross-validatory choice and assessment of statistical predictions, Journal of the Royal Statistical Society B
36, 1974.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.fit.continuation import Even, through_nudging
from clothfit.motion.divergence import Diverged
from clothfit.optimise import preconditioned
from clothfit.optimise.search import BestSoFar, Search
from clothfit.optimise.trajectory import Kept
from clothfit.scene.fit_vector import of_kinds, with_parameters
from clothfit.scene.kinds import KIND
from clothfit.scene.scene import Scene

PAYS = 0.3
"""Share of the cost that is worth another direction at once. What a wrong model leaves is so alike from frame to frame,
and from vertex to vertex, that a motion has some ten numbers of its own: two values save a fifth of them by chance.
"""

BLOCKS, SHORTEST = 6, 4
"""Blocks of the jackknife, and frames of one at least."""

CERTAIN = 4.77
"""t of one component beyond which it is certain: Student's, of 5 degrees of freedom, one in 200 by chance."""


def held(scene: Scene) -> Flags:
    """Which parameters (P,) of a scene are components of gravity that are 0 beside one that is not; none where the wind
    is fitted as well.
    """
    flags = np.zeros(sum(block.count for block in scene.blocks), bool)
    windy = any(block.name in ("wind", "gusts") for block in scene.blocks)
    for block in scene.blocks:
        if block.name == "gravity" and not windy:
            gravity = np.asarray(scene.gravity)
            flags[block.part] = (gravity == 0) & gravity.any()
    return flags


def pays(search: Search) -> bool:
    """Whether another direction pays at the best point of a search that may turn it."""
    more, part = held(search.objective.scene)[search.fitted], preconditioned.for_metric(search)
    if not (more.any() and part.fits() and search.has_time(search.each * len(more))):
        return False
    kept = Kept()
    try:
        model = part.model(search.y, kept.keep)
    except Diverged:
        return False
    scale = 1.0 / np.sqrt(np.maximum(np.diag(model.H), np.finfo(float).tiny))
    H, g = model.H * np.outer(scale, scale), model.g * scale
    if saving(H, g, more) > PAYS * model.cost:
        return True
    H_b, g_b = blocks_of(kept, len(g))
    found = len(g_b) == BLOCKS and t_values(H, g, H_b * np.outer(scale, scale), g_b * scale)[more].max() > CERTAIN
    return bool(found)


def saving(H: Array, g: Array, more: Flags) -> float:
    """What the best step of all coordinates saves of the cost, with its H (Q, Q) and half its gradient g (Q,), beyond
    that of those which are not `more` (Q,).
    """
    few = ~more
    return float(-g @ step(H, g) + g[few] @ step(H[np.ix_(few, few)], g[few]))


def step(H: Array, g: Array) -> Array:
    """−H⁻¹ g (Q,), where H (Q, Q) may be singular."""
    return -np.asarray(np.linalg.lstsq(H, g, rcond=None)[0])


def t_values(H: Array, g: Array, H_b: Array, g_b: Array) -> Array:
    """|t| (Q,) of each coordinate of the step by H (Q, Q) and g (Q,), from what B blocks add to them (B, Q, …)."""
    d = np.array([step(H - own, g - part) for own, part in zip(H_b, g_b, strict=True)])
    variance = (len(d) - 1) * d.var(axis=0)
    return np.asarray(np.abs(step(H, g)) / np.sqrt(np.maximum(variance, np.finfo(float).tiny)))


def blocks_of(kept: Kept, size: int) -> tuple[Array, Array]:
    """What each block of the frames of all runs adds to H and g (B, Q, …) of so many coordinates; none of runs that are
    too short.
    """
    if not kept.runs or any(len(scores.parts) < BLOCKS * SHORTEST for _, scores in kept.runs):
        return np.zeros((0, size, size)), np.zeros((0, size))
    H, g = zip(*(kept.blocks(run, BLOCKS, size) for run in range(len(kept.runs))), strict=True)
    return np.sum(H, axis=0), np.sum(g, axis=0)


CHOSEN = ("wind", "gravity", "friction")
"""Kinds that are chosen among. Damping and drag belong to any cloth, and coarse steps stand for them."""

HARM = 0.02
"""Share of the cost that frames kept out must be nearer by without a kind: 1 % of the error."""

MANY = 10.0
"""Relative change from which on no number of it is given."""

RISE = 1.02
"""Times the cost without what was left out, up to which that stays so."""


class Choice(NamedTuple):
    """What was found of a kind."""

    name: str
    needed: bool
    rise: float  # relative change of the error on frames kept out, without it, as derivatives foretell it

    @property
    def text(self) -> str:
        """The same in a sentence."""
        title = KIND[self.name].title
        # derivatives foretell no number where it is large
        by = f"{100 * abs(self.rise):.0f} % farther" if abs(self.rise) < MANY else "many times as far"
        if not self.needed:
            return f"{title}: not fitted; with it, frames kept out would be {by} away"
        if self.rise > HARM:
            return f"{title}: fitted; without it, frames kept out would be {by} away"
        if self.rise < -HARM:
            return f"{title}: fitted; without it the fit ends farther away"
        return f"{title}: fitted; frames kept out do not speak against it"


def needed(own: Search) -> tuple[list[Choice], Array]:
    """What the kinds of a search are for, at its best point, and its best values (P,) without what is left out. Raises
    Stop.
    """
    part, kept = Even(own, own.objective), Kept()
    names = [name for name in CHOSEN if (of_kinds(own.objective.scene, (name,)) & own.fitted).any()]
    try:
        model = part.model(part.y(own.best.p), kept.keep)
    except Diverged:
        return [], own.best.p
    H_b, g_b = blocks_of(kept, part.size)
    if not len(H_b) or not model.cost > 0:
        return [], own.best.p
    turn = part.turn(model.y)
    H_b, g_b = turn.T @ H_b @ turn, g_b @ turn
    back = part.y(own.origin) - model.y
    member = {name: of_kinds(own.objective.scene, (name,))[own.fitted] for name in names}
    left, found = np.zeros(part.size, bool), dict[str, Choice]()
    while len(found) < len(names):
        now = kept_out(H_b, g_b, left, back)
        rises = {name: (kept_out(H_b, g_b, left | member[name], back) - now) / (model.cost + max(now, 0.0))
                 for name in names if name not in found}  # fmt: skip
        name = min(rises, key=lambda each: rises[each])
        harms = rises[name] < -HARM
        for each in [name] if harms else list(rises):
            found[each] = Choice(each, not harms, float(np.sqrt(max(1.0 + rises[each], 0.0)) - 1.0))
        left |= harms & member[name]
    best = ended_without(own, left) if left.any() else own.best
    if not best.cost <= RISE * own.best.cost:
        best, found = own.best, {name: choice._replace(needed=True) for name, choice in found.items()}
    return [found[name] for name in names], best.p


def kept_out(H_b: Array, g_b: Array, left: Flags, back: Array) -> float:
    """By how much the cost on blocks kept out changes by the steps without each of them, from what the blocks add to H
    and g (B, Q, …); coordinates that are `left` out (Q,) go `back` (Q,).
    """
    H, g, free, change = H_b.sum(axis=0), g_b.sum(axis=0), ~left, 0.0
    for own, part in zip(H_b, g_b, strict=True):
        d = np.where(left, back, 0.0)
        rest, slope = (H - own)[np.ix_(free, free)], (g - part + (H - own) @ d)[free]
        d[free] = step(rest, slope)
        change += float(2.0 * part @ d + d @ own @ d)
    return change


def ended_without(own: Search, left: Flags) -> BestSoFar:
    """Where a search without the coordinates that are `left` out (Q,) ends. Raises Stop."""
    whole = np.zeros(len(own.fitted), bool)
    whole[own.fitted] = left
    start = np.where(whole, own.origin, own.best.p)
    other = own.subsearch(own.objective, start, np.inf)
    other.fitted, other.origin = own.fitted & ~whole, own.origin
    through_nudging(other, (0.0,))
    return other.best


def left_out(choices: Sequence[Choice]) -> tuple[str, ...]:
    """The kinds that are not needed."""
    return tuple(choice.name for choice in choices if not choice.needed)


def without(scene: Scene, start: Array, gone: Collection[str]) -> Scene:
    """The scene with the values of `start` (P,), without the flags of some kinds."""
    scene = with_parameters(scene, start)
    cloths = tuple(
        replace(cloth, fits={name: mode for name, mode in cloth.fits.items() if name not in gone})
        for cloth in scene.cloths
    )
    return replace(scene, cloths=cloths, fits={name: mode for name, mode in scene.fits.items() if name not in gone})
