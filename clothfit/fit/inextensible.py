"""Edges that hardly stretch: of their stiffness a motion shows only how large it is at least.

Under a tension λ an edge of stiffness k is strained by λ / k L₀. Where noise leaves room for more, the cost is flat
above some k, and log k may be anything there; by the compliance 1/k the residuals are smooth down to 0. With
z_j = log k_j and u its compliance relative to that of the point where H = JᵀJ and g = Jᵀr are, dz_j = −du, so with all
other values o as they then fit best, z_o = −K g_o + K H_oj (u − 1), the cost is

    φ(u) = φ₀ − 2 γ (u − 1) + S (u − 1)²,    K = (H_oo + A)⁻¹,  φ₀ = cost − g_oᵀ K g_o,
    γ = g_j − H_jo K g_o,                    S = H_jj − H_jo K H_oj

Where the interval of 1/k reaches 0, k has a lower bound alone: there φ is above its least value by what half an
interval means. It is found by going there, with H and g of each point on the way (D. J. Venzon, S. H. Moolgavkar, A
method for computing profile-likelihood-based confidence intervals, Applied Statistics 37, 1988).

Where the model differs, or there are no intervals, the strains themselves say it: the fitted motion has the tensions
λ = k Δl, nearly whatever k is, so k is at least k rms(Δl) / rms(Δl of the target), less a factor for what differs.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags
from clothfit.engine.rollout import Rollout
from clothfit.fit.hints import edges_of
from clothfit.fit.posterior import Posterior, inverse_outside
from clothfit.motion.divergence import Diverged
from clothfit.objective.objective import Objective
from clothfit.optimise.status import Stop
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.block import Block
from clothfit.scene.cloth import Cloth

LEAST_STRAIN = 0.01
"""RMS strain of edges that hardly stretch, without noise: a metre of woven cloth has 0.01 to 1.6 % by its own weight.
"""

ROUNDS, CLOSE, STATIONARY = 12, 0.05, 0.2
"""Most points on the way to a bound, the change of its logarithm that is small enough, and what the other values may
still save there of the rise.
"""

FARTHEST = 2.0
"""Change of the logarithm from one of these points to the next at most."""

PLAYED = 10.0
"""Times its bound that a stiffness is kept at: nobody sees it, and no step is the harder for it."""

UNSEEN = 0.25
"""Share of the rise of the cost at a bound that this may cost."""

SURE_BOUND = 1.68
"""Half an interval of 99.9 % relative to one of 95 %: one bound in 2,000 is too high."""

DOUBT = 5.0
"""By how much the tensions of a model that differs may be too large."""

SURE = 4.0
"""Standard errors of what noise adds to mean squares of strains, that are taken for strains."""


class Strains(NamedTuple):
    """Mean squared strains of springs (S,) over the frames that show them, and the part that is new in each frame."""

    squares: Array
    noise: Array
    frames: Array  # that show each


def strains(cloth: Cloth, frames: Iterable[tuple[Array, Flags]]) -> Strains:
    """Those of a cloth in some frames, positions (n, 3) and which are seen (n,); half the mean squared difference of
    two frames is noise.
    """
    (a, b), known = cloth.springs.T, np.zeros(len(cloth.rest), bool)
    squares, noise, count, pairs, last = np.zeros((5, len(known)))
    for x, seen in frames:
        both = seen[a] & seen[b]
        strain = np.where(both, np.linalg.norm(x[a] - x[b], axis=1) / cloth.rest - 1.0, 0.0)
        squares, count = squares + strain**2, count + both
        noise, pairs = noise + np.where(both & known, (strain - last) ** 2 / 2.0, 0.0), pairs + (both & known)
        known, last = both, strain
    return Strains(squares / np.maximum(count, 1), noise / np.maximum(pairs, 1), count)


def of_targets(objective: Objective, i: int) -> Strains:
    """Those of object `i` in all targets."""
    given = [each.motion for each in objective.experiments]
    frames = ((x, seen) for each in given for x, seen in zip(each.of(i), each.seen(i), strict=True))
    return strains(objective.scene.cloths[i], frames)


def of_motions(objective: Objective, i: int, p: Array) -> Strains:
    """Those of object `i` in its motions with parameters p (P,). Raises Diverged."""
    frames, own = list[Array](), objective.scene.vertices(i)
    first = objective.scene.vertices(objective.scene.together(i)[0]).start
    for run in objective.runs:
        if i in objective.scene.together(run.cloth):
            part = slice(own.start - first, own.stop - first)
            objective.simulate(run, p, partial(keep, frames, part))
    seen = np.ones(own.stop - own.start, bool)
    return strains(objective.scene.cloths[i], ((x, seen) for x in frames))


def keep(frames: list[Array], part: slice, chunk: Rollout) -> None:
    """Take the positions of a part of the vertices after each step of a chunk."""
    frames.extend(chunk.x[1:, part].copy())


def levels(block: Block) -> NDArray[np.intp]:
    """Which parameter of a block of stiffnesses is the level of each spring (S,)."""
    if block.factors is None:
        return np.arange(block.elements) if block.mode == "L" else np.zeros(block.elements, np.intp)
    own, found = block.factors.constant[block.factors.column], np.zeros(block.elements, np.intp)
    found[block.factors.row[own]] = block.factors.column[own]
    return found


def of_edges(objective: Objective) -> list[tuple[Block, Flags, NDArray[np.intp]]]:
    """The blocks of stiffnesses, which of their springs (S,) are edges, and the level of each; springs of a level whose
    springs are mostly no edges are none.
    """
    found = []
    for block in objective.blocks:
        if block.name == "stiffness" and block.cloth is not None:
            cloth, of = objective.scene.cloths[block.cloth], levels(block)
            edge = edges_of(cloth)
            share = np.bincount(of, edge, block.count) / np.maximum(np.bincount(of, minlength=block.count), 1)
            found.append((block, edge & (share[of] >= 0.5), of))
    return found


def hardly_stretching(objective: Objective) -> Flags:
    """Which parameters (P,) are the stiffness of edges that hardly stretch in the targets."""
    found = np.zeros(sum(block.count for block in objective.blocks), bool)
    if any(each.scene.vertex_counts != objective.scene.vertex_counts for each in objective.experiments):
        return found  # shapes at rest of other meshes
    for block, edge, of in of_edges(objective):
        assert block.cloth is not None
        own = of_targets(objective, block.cloth)
        weight = np.where(edge, own.frames, 0.0)
        total = np.bincount(of, weight, block.count)
        mean = np.bincount(of, weight * (own.squares - own.noise), block.count)
        found[block.part] = (total > 0) & (mean < LEAST_STRAIN**2 * total)
    return found


class Profile(NamedTuple):
    """φ near a point of a fit, by the value j."""

    value: float  # φ₀
    slope: float  # γ
    bend: float  # S
    away: Array  # K g_o (Q − 1,)
    along: Array  # K H_oj

    @classmethod
    def of(cls, H: Array, g: Array, cost: float, j: int, damping: float) -> Profile:
        """By the quadratic model in z, with the prior's part; a change of 1 of one of the others costs `damping`."""
        o = np.arange(len(g)) != j
        K = inverse_outside(H[np.ix_(o, o)] + damping * np.eye(len(g) - 1), np.zeros((len(g) - 1, 0)))
        away, along = K @ g[o], K @ H[o, j]
        slope, bend = float(g[j] - H[o, j] @ away), float(H[j, j] - H[o, j] @ along)
        return cls(cost - float(g[o] @ away), slope, max(bend, np.finfo(float).tiny), away, along)

    def beyond(self, rise: float) -> float:
        """φ where it would be so much above its least value of u ≥ 0, were that its minimum."""
        u = max(self.slope / self.bend, -1.0) + float(np.sqrt(rise / self.bend))
        return self.value - 2.0 * self.slope * u + self.bend * u**2

    def up_to(self, most: float) -> float:
        """u − 1 where φ comes to `most`, or is least where it does not."""
        beyond = self.slope**2 + self.bend * (most - self.value)
        return (self.slope + float(np.sqrt(max(beyond, 0.0)))) / self.bend


def lower_bound(problem: Trajectory, known: Posterior, j: int, rise: float) -> float:
    """The stiffness below which φ is more than `rise` above its least value, relative to that of the best point; NaN
    where it was not found within the budget.
    """
    local, scale, y = known.local, known.local.scale, problem.search.y
    A, centre, o = local.prior.matrix(known.sigma2), local.prior.centre, np.arange(len(y)) != j
    model, most, at, ends = local.model, np.inf, 0.0, [0.0, np.inf]  # of log u, where φ is below and above
    try:
        for _ in range(ROUNDS):
            off = A @ (model.y - centre)
            H, cost = (model.H + A) * np.outer(scale, scale), model.cost + float((model.y - centre) @ off)
            profile = Profile.of(H, (model.g + off) * scale, cost, j, rise)
            most = min(most, profile.beyond(rise))
            ends[int(profile.value > most)] = at
            wanted = at + float(np.log(max(1.0 + profile.up_to(most), np.finfo(float).tiny)))
            if abs(wanted - at) < CLOSE and cost - profile.value < STATIONARY * rise:
                return float(np.exp(-at))
            if not ends[0] < wanted < ends[1]:
                wanted = min(sum(ends) / 2.0, ends[0] + FARTHEST)
            change, at = min(wanted - at, FARTHEST), min(wanted, at + FARTHEST)
            y = model.y.copy()
            y[j] -= scale[j] * change
            y[o] += scale[o] * (profile.along * np.expm1(change) - profile.away)
            if np.array_equal(problem.parameters(y), problem.parameters(model.y)):  # at a bound
                break
            model = problem.model(y)
    except (Diverged, Stop):
        pass
    return np.nan


def played(known: Posterior, ratio: Array, p: Array) -> Array:
    """The parameters p (P,) with stiffnesses of `PLAYED` times their lower bounds, which are `ratio` (Q,; else NaN)
    relative to the best point, or of the start where that is above these, and with the others as they then fit best.
    """
    local, search, open_ = known.local, known.local.search, np.isfinite(ratio)
    A, scale, o = local.prior.matrix(known.sigma2), local.scale, np.flatnonzero(~open_)
    y, start = (search.coordinates.y(each)[search.fitted] for each in (p, search.start))
    change = np.maximum(np.log(PLAYED * ratio[open_]), ((start - y) / scale)[open_])
    H = (local.model.H + A) * np.outer(scale, scale)
    K = inverse_outside(H[np.ix_(o, o)], np.zeros((len(o), 0)))
    y[open_] += scale[open_] * change
    y[o] += scale[o] * (K @ (H[np.ix_(o, np.flatnonzero(open_))] @ np.expm1(-change)))
    return search.parameters(y)


def by_strains(objective: Objective, block: Block, p: Array) -> Array:
    """Lower bounds (count,) of stiffnesses relative to those of p (P,), by strains of edges. Raises Diverged."""
    ((edge, of),) = [(edge, of) for own, edge, of in of_edges(objective) if own is block]
    assert block.cloth is not None
    target, fitted = of_targets(objective, block.cloth), of_motions(objective, block.cloth, p)
    weight, tiny = np.where(edge, target.frames, 0.0), np.finfo(float).tiny
    squares, noise, ours, count = (
        np.bincount(of, weight * each, block.count) for each in (target.squares, target.noise, fitted.squares, 1.0)
    )
    theirs = np.maximum(squares - noise, 0.0) + SURE * noise / np.sqrt(np.maximum(count, 1.0))
    return np.asarray(np.sqrt(np.minimum(ours / np.maximum(DOUBT**2 * theirs, tiny), 1.0)))
