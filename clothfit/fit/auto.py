"""The default way to fit: from what is certain to what is fine.

1. The momentum fit, where the target shows whole successive frames: exact where the target is.
2. One value for a whole cloth: a scan over the bounds, for the global minimum.
3. Otherwise the best of what is known (the start, a uniform fabric of the best density and stiffness, equal values),
   and from there Gauss–Newton, on a few frames first where that is far from the target: near the start of a motion its
   cost is smooth, later that of a windy cloth is chaotic. A momentum fit that is not exact is no such start: its
   motion may be near, but noise has thrown its values far apart.

Long fits save time: linear systems are solved loosely on the way, thousands of values are first multiplied by one
factor for each kind (`shares`), and where the motion stays far from the target, which the model then cannot reproduce,
the fit ends when the cost hardly falls any more.

Whatever is tried is a visit of the search, so the result is never worse than the best of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.objective.objective import Objective
from clothfit.optimise import matrix_free, momentum
from clothfit.optimise import scipy_methods as descent
from clothfit.optimise.common_factors import Shared
from clothfit.optimise.gauss_newton import PATIENT, Patience, minimise_resumed
from clothfit.optimise.prior import Prior, none
from clothfit.optimise.scan import is_large, scan, scannable
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status
from clothfit.optimise.trajectory import LARGEST, Trajectory
from clothfit.scene.kinds import LETTERED

NEAR = 2e-3
"""Error relative to how far the target moves, below which all frames are fitted at once."""

FIRST_WINDOW, GROWTH = 10, 2
"""Frames of the first window after what shows something, and by how much each is longer than the one before."""

ITERATIONS, MOST = 8, 200
"""Of Gauss–Newton in each window, and where all frames are fitted."""

ROUGH, FINER, LOOSE = 1e-3, 1e-4, 1e-5
"""A window is left where a step would save less than the first fraction of its cost, all frames less than the second.
Linear systems are solved to `LOOSE` on the way: what that leaves open is far below what the motion is off.
"""

LARGE = 100_000
"""Positions that are compared, from which on time is saved: a look at a few frames comes before the momentum fit of
all, looser stages before the last one, and a fit that stays far from its target ends without that.
"""

SHORT = Patience(4, 1e-2, 1e-3)
"""Patience on the way."""

FAR = 0.05
"""Error relative to how far the target moves, above which the model cannot reproduce it: the fit ends there. Nearer, a
last stage with the fit's own tolerance goes to the very minimum.
"""


class Stage(NamedTuple):
    """Gauss–Newton over some frames, as well as is needed there."""

    objective: Objective
    least: float  # relative saving that ends it
    iterations: int
    patience: Patience


def find(search: Search, start: Array, others: Callable[[], list[Array]] | None, tau: float | None) -> Status:
    """Fit by the steps above from `start` (P,); returns the status. Raises Stop.

    `others` gives values (P,) to try beside the start; `tau` is the width of the prior, learned where None. The prior
    is centred on what of the start and the others is nearest to the target at first.
    """
    first = search.objective.until(first_window(search.objective), loosened(search))
    exact = by_momentum(search, start, momentum.TREATMENTS[:1], first) if balanced(search, start, first) else []
    if one_value_each(search):
        return by_scan(search, start, tau)
    search.enter("starts")
    guesses = [start]
    if others is not None and not is_near(search, search.visit(start)):
        known = search.journal.recall("others", lambda: np.array(others()))
        guesses += [np.where(search.fitted, p, start) for p in known]
    centre = min(guesses, key=lambda p: search.measure(p, first))
    status = by_gauss_newton(search, centre, centre, tau)
    if exact and np.array_equal(search.best.p, exact[-1]):  # noisy as it is, it is better than that
        return by_gauss_newton(search, search.best.p, centre, tau)
    return status


def first_window(objective: Objective) -> int:
    """Frames of the first window: some after the first that shows anything."""
    return objective.first_step + FIRST_WINDOW


def by_momentum(
    search: Search,
    start: Array,
    treatments: Sequence[momentum.Treatment] = momentum.TREATMENTS,
    early: Objective | None = None,
) -> list[Array]:
    """The momentum fits (P,), the best last; none where the target does not show enough.

    One that is farther off over the frames of `early` than a cloth that keeps still is not followed further: of a
    target that the model cannot reproduce it may be so soft that a whole motion takes minutes.
    """
    if not momentum.fits(search.objective):
        search.warn("too little memory for the balance of momentum, which was left out (--memory)")
        return []
    search.enter("momentum")
    found: list[tuple[float, Array]] = []
    for treatment in treatments:
        fit = partial(momentum.fit, search.objective, start, search.fitted, treatment)
        p = search.journal.recall("momentum", fit)
        if np.array_equal(p, start):
            return []
        if early is not None and early_cost(search, p, early) > early.still:
            continue
        found.append((search.visit(p), p))
        if is_near(search):
            break
    return [p for _, p in sorted(found, key=lambda pair: -pair[0])]


def balanced(search: Search, start: Array, early: Objective) -> bool:
    """Whether the momentum fit of a large cloth is worth its time: where its balances cannot even be fulfilled over the
    few frames of `early`, they cannot over all.
    """
    if not is_long(search):
        return True
    search.enter("momentum", early)
    fit = partial(momentum.fit, early, start, search.fitted, momentum.TREATMENTS[0])
    p = search.journal.recall("early momentum", fit)
    return early_cost(search, p, early) <= FAR**2 * early.still


def early_cost(search: Search, p: Array, early: Objective) -> float:
    """The cost of values (P,) over a few frames, which is no evaluation of the whole."""
    return float(search.journal.recall("early cost", lambda: np.array(early.cost_or_infinity(p)), p))


def is_long(search: Search) -> bool:
    """Whether a fit takes so long that time is to be saved."""
    return search.objective.observations >= LARGE


def is_near(search: Search, cost: float | None = None) -> bool:
    """Whether a cost, by default that of the best point, means that the motion is nearly the target's."""
    best = search.best.cost if cost is None else cost
    return bool(np.isfinite(best)) and best < NEAR**2 * search.objective.still


def is_far(search: Search) -> bool:
    """Whether the best point is so far from the target that the model cannot reproduce it."""
    return search.best.cost > FAR**2 * search.objective.still


def one_value_each(search: Search) -> bool:
    """Whether all that is fitted is one mass or stiffness for a cloth: what a scan can find."""
    fitted = [block for block in search.objective.blocks if search.fitted[block.part].any()]
    return all(block.mode == "G" and block.name in LETTERED for block in fitted)


def by_scan(search: Search, start: Array, tau: float | None) -> Status:
    """Scan the values of each cloth, and follow the best points down: one value by Brent's method."""
    search.enter("scan")
    if not is_near(search):
        search.visit(start)
    for cloth in search.objective.cloths:
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
    cloths are as in the best point; `start` (P,) is where that of a large one is looked for.
    """
    p = search.best.p.copy()
    for block in scannable(search.objective, cloth):
        p[block.part] = start[block.part]
    return search.journal.recall("scan", lambda: np.array(scan(search.objective, cloth, p)))


def by_brent(search: Search, p: Array, place: int, bracket: Array) -> None:
    """Follow one value of p (P,) down, in its logarithm, between the ends of a bracket."""
    from scipy.optimize import minimize_scalar

    def cost(log: float) -> float:
        q = p.copy()
        q[place] = np.exp(log)
        return min(search.visit(q), np.finfo(float).max)

    minimize_scalar(cost, bounds=(np.log(bracket[0]), np.log(bracket[2])), method="bounded", options={"xatol": 1e-7})


def by_gauss_newton(search: Search, p: Array, centre: Array, tau: float | None, windows: bool = True) -> Status:
    """Gauss–Newton from p (P,), in windows of more and more frames where p is far from the target."""
    search.enter("gauss-newton")
    cost = search.visit(p)
    if not is_near(search, cost) and too_many(search):
        p, status = by_factors(search, p, windows)
        if is_far(search):
            return status
        cost, windows = search.best.cost, False
    before, status = (search.best.cost, search.best.p), Status.STALLED
    y: Array | None = None
    prior: Prior | None = None
    for objective, least, iterations, patience in stages(search, is_near(search, cost), windows):
        whole = objective is search.objective
        part = Trajectory(search, objective)
        search.enter("gauss-newton", objective)
        y = part.y(p) if y is None else y
        prior = part.prior(part.y(centre), tau) if prior is None else prior
        if not np.isfinite(part.cost(y)):
            break
        search.best.believe(prior)
        if part.operations() > LARGEST or not part.fits():
            if matrix_free.fits(part):
                search.enter("matrix-free", objective)
                y, status = matrix_free.minimise(part, y, prior, whole)
                continue
            search.best.believe(None)
            search.warn("too little memory for the matrices of gauss-newton: l-bfgs-b took its place (--memory)")
            if whole:
                status = descent.minimise(search, "l-bfgs-b")
            continue
        accepted = part.accepted if whole else part.passed
        y, prior, status = minimise_resumed(search, part.problem(least, patience), y, prior, accepted, iterations)
        search.best.believe(prior)
        if not whole:
            search.enter("gauss-newton")
            search.visit(search.parameters(y))
            if objective.steps == search.objective.steps and is_far(search):
                break
    if before[0] < search.best.cost:
        search.best.believe(None)
        search.accept(before[1], before[0])
    return Status.STALLED if status == Status.CONVERGED and search.on_plateau() else status


def too_many(search: Search) -> bool:
    """Whether so many values are fitted one by one that there is no dense model of a fit."""
    operations = Trajectory(search, search.objective).operations()
    return is_long(search) and operations > LARGEST and any(block.mode == "L" for block in search.objective.blocks)


def by_factors(search: Search, p: Array, windows: bool) -> tuple[Array, Status]:
    """Go from p (P,) by one factor for all values of a kind, and where that stays far from the target some steps by the
    values themselves; the best point, and how it ended.
    """
    y, status = Trajectory(search, search.objective).y(p), Status.STALLED
    for objective, least, iterations, patience in stages(search, False, windows)[:-1]:
        part = Shared(search, objective, y)
        z = np.zeros(part.size)
        if not np.isfinite(part.cost(z)):
            break
        search.enter("factors", objective)
        problem = part.problem(least, patience)
        z, _, status = minimise_resumed(search, problem, z, none(part.size), part.passed, iterations)
        y = part.all(z)
        search.visit(search.parameters(y))
    if is_far(search):
        loose = search.objective.until(search.objective.steps + 1, loosened(search))
        search.enter("l-bfgs-b", loose)
        y, status = descent.short(search, loose, search.y)
        search.visit(search.parameters(y))
    return search.best.p, status


def stages(search: Search, near: bool, windows: bool) -> list[Stage]:
    """What is fitted one after the other, of all frames last."""
    objective, whole = search.objective, search.objective.steps + 1
    last = Stage(objective, 0.0, MOST, PATIENT)
    if near:
        return [last]
    windows = windows and "spectrum" not in objective.weights  # that of a part is another spectrum
    lengths = window_lengths(first_window(objective), whole) if windows else [whole]
    tolerance = loosened(search)
    patience = SHORT if is_long(search) else PATIENT
    found = [Stage(objective.until(frames, tolerance), ROUGH, ITERATIONS, patience) for frames in lengths[:-1]]
    if tolerance > objective.tolerance and is_long(search):
        found.append(Stage(objective.until(whole, tolerance), FINER, MOST, SHORT))
    return [*found, last]


def loosened(search: Search) -> float:
    """The tolerance of the linear systems where the motion is still far from the target's."""
    return max(LOOSE, search.objective.tolerance)


def window_lengths(frames: int, last: int) -> list[int]:
    """Frames of each window, from the first to the last, which is whole."""
    lengths = []
    while frames < 0.8 * last:
        lengths.append(frames)
        frames *= GROWTH
    return [*lengths, last]
