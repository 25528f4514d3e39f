"""Gravity keeps its direction until another one pays.

The scene knows which way is down better than a motion that its model cannot reproduce: two more values than gravity's
size always come nearer to the frames that are fitted, by turning what the model lacks into a slope, and may lead away
on those after them. So a component of gravity that is 0 beside one that is not stays 0, until a step of Gauss–Newton by
it as well

- would save most of the cost, or
- is certain: without any one of B blocks of successive frames it would be much the same (the jackknife),

      d = −H⁻¹ g,    d_b = −(H − H_b)⁻¹ (g − g_b),    t² = d² / ((B − 1)/B Σ_b (d_b − d̄)²)

Where the wind is fitted as well, it may push any way; gravity is then as free.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.motion.divergence import Diverged
from clothfit.optimise import preconditioned
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Scores
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
        model = part.model(search.y, kept.of)
    except Diverged:
        return False
    scale = 1.0 / np.sqrt(np.maximum(np.diag(model.H), np.finfo(float).tiny))
    H, g = model.H * np.outer(scale, scale), model.g * scale
    if saving(H, g, more) > PAYS * model.cost:
        return True
    H_b, g_b = kept.blocks(len(g))
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


class Kept:
    """What each step of the runs of a model adds to H and g."""

    def __init__(self) -> None:
        self.scores: list[tuple[Indices, Scores]] = []

    def of(self, own: Indices) -> Scores:
        """What takes that of the next run, which depends on some coordinates."""
        self.scores.append((own, Scores(by_step=True)))
        return self.scores[-1][1]

    def blocks(self, count: int) -> tuple[Array, Array]:
        """What each block of the frames of all runs adds to H and g (B, Q, …) of so many coordinates; none of runs that
        are too short.
        """
        H, g = np.zeros((BLOCKS, count, count)), np.zeros((BLOCKS, count))
        for own, scores in self.scores:
            if len(scores.parts) < BLOCKS * SHORTEST:
                return H[:0], g[:0]
            for b, part in enumerate(np.array_split(np.arange(len(scores.parts)), BLOCKS)):
                H[b][np.ix_(own, own)] += sum(scores.information[i] for i in part)
                g[b][own] += sum(scores.parts[i] for i in part)
        return H, g
