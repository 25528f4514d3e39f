"""The routes of a default fit by themselves: balances of momentum, a scan, single values by a prior, coarse to fine.

`fit.routes` says which of them a fit takes, and when. Each trial is a visit of the search, so that none makes it worse.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from clothfit.base.arrays import Array
from clothfit.fit import common_values, hierarchy
from clothfit.fit.options import RMSE_TOLERANCE
from clothfit.fit.trajectory_fit import (
    FAR_ERROR,
    NEAR_ERROR,
    ModelDiffers,
    by_gauss_newton,
    is_far,
    is_long,
    is_near,
    is_near_but_for_noise,
)
from clothfit.objective.objective import Objective
from clothfit.optimise import momentum
from clothfit.optimise.along_target import AlongTarget
from clothfit.optimise.scan import is_large, scan, scannable
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status
from clothfit.optimise.trajectory import LARGEST, Trajectory
from clothfit.scene.kinds import LETTERED

ACCURATE = 3e-4
"""Error of a momentum fit, relative to how far the target moves, below which noise has hardly scattered its values."""

EXACT = 1e-5
"""The same below which a fit of thousands of values ends: the values of 100 × 100 vertices are then right to 1e-8, and
steps of minutes would only follow how a cloth that buckles makes more of that.
"""

ROUNDINGS = 8.0
"""How many roundings of positions a single step may be from its end: the weights of the positions that lead to a BDF2
step are 24, 22, 8 and 1 ninth, and its end is one more.
"""

MANY = 1500
"""Values from which on a fit to a motion of its model tries common values, and to a rounded one ends along the target:
Gauss–Newton with a dense model, which comes to the rounding itself, takes minutes of them.
"""

HALF = 0.5
"""Share of the error that another search along the target must leave at most to be followed by one more."""

FINE = "ML"
"""Models of a hierarchy with so many values that they follow noise."""

TRIED = momentum.TREATMENTS[:2]
"""The momentum fits that are worth their time beside a trajectory fit; `treatments` adds `ANCHORED`."""


class SolvedLoosely(Exception):
    """Ends a search whose target was solved less accurately than the search does, where that makes another motion."""

    def __init__(self, tolerance: float, p: Array) -> None:
        """`p` (P,) reproduces the target with linear systems solved to this tolerance, relative."""
        super().__init__(f"the target was solved to {tolerance:g}")
        self.tolerance, self.p = tolerance, p


def by_hierarchy(
    search: Search, tau: float | None, starts: Sequence[Array], wanted: Sequence[str] | None = None
) -> Status:
    """Fit from coarse to fine, from `starts` (P,), all models or those that are `wanted`; where that comes to the noise
    of the target, Gauss–Newton goes on to the minimum.

    Single values are tried at once after the models of few: by a prior they may reproduce a target that windows from a
    far start have not come to, where those of the hierarchy, without one, would follow its noise.
    """
    search.best.belief = search.best.descent = None
    search.visit(search.start)
    models = hierarchy.models(search.objective.scene)
    left = models if wanted is None else wanted
    coarse = [model for model in left if model not in FINE]
    hierarchy.refine(search, coarse, starts)
    status = by_single_values(search, tau) if left else None
    if status is not None:
        return status
    fine, begin = left[len(coarse):], [search.best.p] if coarse else starts
    if too_many(search) and "L" in fine:
        hierarchy.refine(search, fine[:-1], begin)
        if np.isfinite(search.best.cost) and not is_far(search):
            return by_products(search, tau)
        fine, begin = fine[-1:], [search.best.p]
    hierarchy.refine(search, fine, begin)
    if not search.levels:
        search.levels.append(hierarchy.level_result(search, models[0]))
    if is_far(search) or too_many(search) or not is_near_but_for_noise(search):
        return ended(search)
    return by_gauss_newton(search, search.best.p, centre_of(search), tau, windows=False)


def ended(search: Search) -> Status:
    """How a search ends at its best point."""
    if not search.is_stationary:
        search(search.y)  # its gradient says whether this is a minimum
    return search.verdict()


def centre_of(search: Search) -> Array:
    """The values (P,) of the coarsest model that a hierarchy has fitted, which follow no noise; else the best point."""
    return search.levels[0].p if search.levels else search.best.p


def by_products(search: Search, tau: float | None) -> Status:
    """Fit single values from the best point of coarser models, by products alone, and note what that has come to.
    Raises Stop.
    """
    began = time.monotonic()
    status = by_gauss_newton(search, search.best.p, centre_of(search), tau, windows=False)
    search.add_level(hierarchy.level_result(search, "L", time.monotonic() - began))
    return status


def by_single_values(search: Search, tau: float | None) -> Status | None:
    """Fit single values from the best point of coarser models, by a prior around the coarsest; None where there are
    none, or where they cannot reproduce the target. Raises Stop.
    """
    if hierarchy.model_of(search.objective.scene) != "L" or too_many(search) or search.is_late:
        return None
    return singly(search, search.best.p, centre_of(search), tau)


def singly(search: Search, p: Array, centre: Array, tau: float | None) -> Status | None:
    """Gauss–Newton from p (P,), by a prior around `centre` (P,); None where the model cannot reproduce the target, and
    then what that took does not count as time of a hierarchy. Raises Stop.
    """
    began = search.progress.computing
    try:
        return by_gauss_newton(search, p, centre, tau, watched=True)
    except ModelDiffers:
        search.longest += search.progress.computing - began
        return None


def too_many(search: Search) -> bool:
    """Whether so many values are fitted one by one that their fit has no dense model."""
    operations = Trajectory(search, search.objective).operations()
    return operations > LARGEST and any(block.mode == "L" for block in search.objective.blocks)


def treatments(search: Search) -> list[momentum.Treatment]:
    """The momentum fits of a search in the order in which they are tried. Where masses and stiffnesses are fitted, what
    a target is rounded to favours small values of all, so that first a mass is held.
    """
    exact, *others = TRIED
    anchored = [momentum.ANCHORED] if momentum.anchors(search.objective, search.fitted) else []
    return [*anchored, exact, *others] if search.objective.rounding > 0.0 else [exact, *anchored, *others]


def by_momentum(
    search: Search,
    start: Array,
    treatments: Sequence[momentum.Treatment] = momentum.TREATMENTS,
    beginning: Objective | None = None,
    balances: momentum.Momentum | None = None,
) -> list[Array]:
    """The momentum fits (P,), the best last, by `balances` where they are begun; none where the target does not show
    enough.

    One that costs more over the frames of `beginning` than a cloth that keeps still is left out: of a target that the
    model cannot reproduce it may be so soft that a whole motion takes minutes.
    """
    if not momentum.fits(search.objective):
        search.warn("too little memory for the balance of momentum, which was left out (--memory)")
        return []
    search.enter("momentum")
    found: list[tuple[float, Array]] = []
    balances = balances or momentum.Momentum(search.objective, start, search.fitted)
    for treatment in treatments:
        many = treatment in (TRIED[0], momentum.ANCHORED) and search.fitted.sum() > MANY
        rounded = many and search.objective.rounding > 0.0
        p = (balances.solved if rounded else balances.fit)(treatment, search.report)
        if np.array_equal(p, start):
            return []
        begun = np.nan if beginning is None else beginning.cost_or_infinity(p)  # no evaluation of the whole
        if beginning is not None and begun > beginning.cost_at_rest:
            continue
        search.own |= balances.own
        if many and (search.own or rounded) and common_values.simplify(search, p, balances):
            takes_each_step(search)
            return [search.best.p]
        if rounded:
            p = balances.along_targets(balances.refined(p, search.report), False, search.report)
        found.append((search.visit(p), p))
        if (search.own or rounded) and not (is_exact(search) and not rounded) and takes_each_step(search):
            as_whole_motions(search, balances)
            break
        if is_exact(search) or is_accurate(search):
            break
        if beginning is not None and begun <= NEAR_ERROR**2 * beginning.cost_at_rest and not is_near(search):
            check_tolerance(search, p)
    return [p for _, p in sorted(found, key=lambda pair: -pair[0])]


def check_tolerance(search: Search, p: Array) -> None:
    """Raise SolvedLooser where the motion with p (P,) is the target's if the linear systems are solved as `simulate`
    does: a cloth that buckles may fall to one side or the other by the error of a solver.
    """
    if search.loose_tolerance is None:
        return
    own = search.objective.until(search.objective.steps + 1, search.loose_tolerance)
    if own.cost_or_infinity(p) <= NEAR_ERROR**2 * own.cost_at_rest:
        raise SolvedLoosely(search.loose_tolerance, p)


def balances_can_hold(search: Search, balances: momentum.Momentum, beginning: Objective) -> bool:
    """Whether the momentum fit is worth its time: in a long fit, where steps agree on the values, or the balances hold
    over the frames of `beginning`.
    """
    if not is_long(search):
        return True
    search.enter("momentum", beginning)
    first = treatments(search)[0]
    agree = momentum.fits(search.objective) and balances.agree(first)
    search.own |= balances.own
    if agree:
        return True
    p = momentum.Momentum(beginning, balances.p, search.fitted).fit(first, search.report)
    return beginning.cost_or_infinity(p) <= FAR_ERROR**2 * beginning.cost_at_rest


def takes_each_step(search: Search) -> bool:
    """Whether the best point takes each step of the target from where that begins it to where that ends it: then no
    other values are nearer, however far a motion that makes more and more of any difference ends from the target.
    """
    along = AlongTarget.of(search.objective, search.best.p)
    if along is not None and along.steps.largest <= ROUNDINGS * max(RMSE_TOLERANCE, search.objective.rounding):
        search.single, search.own = (search.best.p, along.steps), True
    return search.proven is not None


def as_whole_motions(search: Search, balances: momentum.Momentum) -> None:
    """Go on from values that take each step of the target to those whose motion is nearest as a whole, as long as that
    halves what is left above the rounding of the target: it says more of the combinations of values of which the motion
    makes most. Not where the motion is so far from the target that it is not linear in them. Raises Stop.
    """
    objective = search.objective
    while objective.rounding and is_accurate(search) and objective.rmse(search.best.cost) > objective.rounding:
        before = search.best.cost
        search.visit(balances.along_targets(search.best.p, True, search.report))
        if not (search.best.cost < before and takes_each_step(search) and search.best.cost < HALF**2 * before):
            break


def is_exact(search: Search) -> bool:
    """Whether the best point reproduces the target but for what a cloth that buckles makes of rounding."""
    return bool(search.best.cost <= EXACT**2 * search.objective.cost_at_rest)


def is_accurate(search: Search) -> bool:
    """Whether the best point is so near the target that noise has hardly scattered its values."""
    return search.best.cost < ACCURATE**2 * search.objective.cost_at_rest


def one_value_each(search: Search) -> bool:
    """Whether the fit is of single masses and stiffnesses for whole cloths only, which a scan can find."""
    fitted = [block for block in search.objective.blocks if search.fitted[block.part].any()]
    return all(block.is_one and block.name in LETTERED for block in fitted)


def by_scan(search: Search, start: Array, tau: float | None) -> Status:
    """Scan the values of each cloth and descend from the best points: one value by Brent's method."""
    search.enter("scan")
    if not is_near(search):
        search.visit(start)
    for cloth in search.objective.objects:
        own = [block.start for block in scannable(search.objective, cloth)]
        large = is_large(search.objective, cloth)
        for point in scanned(search, cloth, start) if own else []:
            p = search.best.p.copy()
            p[own] = point[:, 1]
            if len(own) == 1 and not large:
                by_brent(search, p, own[0], point[0])
            else:
                by_gauss_newton(search, p, p, tau, windows=large)
    if len(search.y) == 1:
        search(search.y)
        return search.verdict()
    return by_gauss_newton(search, search.best.p, search.best.p, tau, windows=False)


def scanned(search: Search, cloth: int, start: Array) -> Array:
    """The best points of the scan of a cloth (K, blocks, 3): values between their neighbours on the grid. The other
    cloths keep the values of the best point; the scan of a large cloth stays around `start` (P,).
    """
    p = search.best.p.copy()
    for block in scannable(search.objective, cloth):
        p[block.part] = start[block.part]
    return np.array(scan(search.objective, cloth, p))


def by_brent(search: Search, p: Array, place: int, bracket: Array) -> None:
    """Descend by one value of p (P,), in its logarithm, between the ends of a bracket."""
    from scipy.optimize import minimize_scalar

    def cost(log: float) -> float:
        q = p.copy()
        q[place] = np.exp(log)
        return min(search.visit(q), np.finfo(float).max)

    minimize_scalar(cost, bounds=(np.log(bracket[0]), np.log(bracket[2])), method="bounded", options={"xatol": 1e-7})
