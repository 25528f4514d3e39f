"""The momentum fit: masses and stiffnesses straight from the balance of momentum along the target motion.

All `balances` together are one sparse linear least-squares problem,

    min_p Σ_t Σ_i |r_ti(p₀) − C_ti (p − p₀)|² / m_i²,      lower ≤ p ≤ upper,

without a starting point's luck and without a simulation. Directions that the balances do not determine (masses and
stiffnesses by a common factor where nothing else acts) keep their part of p₀.

Noise: an error of a position enters three balances, with weights 1, −2, 1 over h² (five of BDF2's). Summing the
balances twice over time, as the step sums, undoes that: row t then compares where the forces so far carry the vertex
with where it is, and the errors of different rows are independent again, as least squares assumes. What is left is the
noise within the forces; smoothing the target over a few frames lessens it. A fit tries several `TREATMENTS` and keeps
the best. Reference for equation-error estimation: L. Ljung, System Identification, 1999, chapter 7.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.derivative.sensitivity import Columns, columns
from clothfit.engine import prescribed
from clothfit.engine.system import EXPLICIT
from clothfit.kernels.parallel import only_here, together
from clothfit.objective.objective import Objective
from clothfit.objective.run import Run
from clothfit.optimise import trust_region
from clothfit.optimise.along_target import AlongTarget, nearer
from clothfit.optimise.balances import Equations, Rows, balances, plain, smoothed, summed_twice, track
from clothfit.optimise.consensus import balanced_beside, consensus, in_balance, trimmed
from clothfit.scene.block import Block
from clothfit.scene.families import spring_groups
from clothfit.scene.fit_vector import bounds
from clothfit.scene.kinds import LETTERED

if TYPE_CHECKING:
    from scipy.sparse import csr_array

DENSE = 6000
"""Parameters up to which the normal equations of `information` may be."""

ENTRY = 32
"""Bytes for each number in the balances, with those of sums beside it."""

NEARLY = 1.0 - 4.0 * np.finfo(float).eps
"""Share of the way to a bound that is all of it but for rounding."""

ROUGHLY = 100.0
"""Roundings of positions that single steps of values by balances may leave: what these values make of rounding."""

ROUNDS, UNCHANGED = 10, 1e-9
"""Rounds of a solution, at most, and the relative change that is the last: the next would be rounding."""

TRIES, HALF = 3, 0.5
"""Times, at most, that the forms of steps are looked for anew with values that they have led to; and the share of what
single steps have missed that they may miss with these.
"""


class Treatment(NamedTuple):
    """What is done to the target and to the balances against noise."""

    frames: int  # over which the target is smoothed, odd
    summed: bool  # whether the balances are summed twice over time
    anchored: bool = False  # whether the mass of each cloth as a whole is held


ANCHORED = Treatment(1, False, True)
"""Where masses and stiffnesses are fitted, only the air and what else is known shows their common factor; in rounded
positions that drowns, and least squares takes small values for small residuals. The ratios stay right.
"""

TREATMENTS = (
    Treatment(1, False),
    Treatment(1, True),
    Treatment(7, True),
    Treatment(15, True),
    Treatment(7, False),
    Treatment(15, False),
)
"""From exact targets to very noisy ones."""


class Momentum:
    """The momentum fits of an objective from its parameters p (P,), of the masses and stiffnesses among those that are
    `fitted` (P,). The rows of exact targets are made once for all of them where the memory holds those of all cloths.
    """

    def __init__(self, objective: Objective, p: Array, fitted: Flags) -> None:
        self.objective, self.p, self.fitted = objective, p, fitted
        self.at_once = sum(needed(objective)) <= objective.room
        self.own = False  # whether some steps show that the target is a motion of the model
        self._sure = False  # whether steps that agree have determined the values to the last digits
        self._forms = [plain(run.system, run.steps) for run in objective.runs]  # of the steps, until values show them
        self._typical = np.inf  # how far single steps ended with the values that showed them
        self.normals: dict[int, tuple[Indices, csr_array]] = {}
        """The places (Q,) of the values of each cloth, and CᵀC (Q, Q) of the steps that have given them."""
        self._kept: dict[tuple[int, bool], tuple[Indices, Equations | None]] = {}

    def rows(self, cloth: int, treatment: Treatment = TREATMENTS[0]) -> tuple[Indices, Equations | None]:
        """The places of the values of a cloth, and its balances."""
        if treatment not in (TREATMENTS[0], ANCHORED):
            return equations(self.objective, self.p, self.fitted, cloth, treatment)
        key = cloth, treatment.anchored
        if key not in self._kept:
            if treatment.anchored:
                places, rows = self.rows(cloth)
                made = places, Equations(rows.parts, True) if rows else None
            else:
                made = equations(self.objective, self.p, self.fitted, cloth, forms=self._forms)
            if not self.at_once:
                return made
            self._kept[key] = made
        return self._kept[key]

    def agree(self, treatment: Treatment = TREATMENTS[0]) -> bool:
        """Whether enough steps of a cloth agree on its values."""
        for cloth in self.objective.cloths:
            rows = self.rows(cloth, treatment)[1]
            agreed = rows is not None and bool(consensus(rows, rows.counts > 0).any())
            self.own |= rows is not None and rows.own
            if agreed:
                return True
        return False

    def fit(self, treatment: Treatment = TREATMENTS[0], waiting: Callable[[], None] | None = None) -> Array:
        """The values (P,); the rest stays, and so do the factors of maps. A fit of thousands of values calls `waiting`
        now and then.

        What no complete balance determines stays as well: everything, where the target shows no three successive steps.
        """
        found = self.solved(treatment, waiting)
        return self.refined(found, waiting) if treatment == TREATMENTS[0] else found

    def refined(self, p: Array, waiting: Callable[[], None] | None = None) -> Array:
        """The values (P,) that `solved` has found, once more where steps are those of the model, but those that agree
        do not determine them to the last digits: p (P,) shows which forms steps take, so that others are balances, too.
        """
        for _ in range(TRIES):
            if self._sure or not self.own or not self._take_forms(p):
                break
            p = self.solved(TREATMENTS[0], waiting)
        return p

    def _take_forms(self, p: Array) -> bool:
        """Let steps have the forms that they take with p (P,); whether these are others than before, of better values.
        Where single steps end as near as rounding lets them, more rows only bring more of that into the values.
        """
        along = AlongTarget.of(self.objective, p)
        if along is None or not ROUGHLY * self.objective.rounding < along.typical < HALF * self._typical:
            return False
        same = all(map(prescribed.Forms.equals, self._forms, along.forms))
        self._typical, self._forms = along.typical, along.forms
        if not same:
            self._kept.clear()
        return not same

    def solved(self, treatment: Treatment = TREATMENTS[0], waiting: Callable[[], None] | None = None) -> Array:
        """The values (P,) by the balances as they are."""
        lower, upper = bounds(self.objective.scene)
        found, heard = self.p.copy(), only_here(waiting)

        def fitted_one(cloth: int) -> tuple[Indices, Array, bool]:
            places, rows = self.rows(cloth, treatment)
            if rows is None:
                return places, found[places], True
            best, H = solve(rows, found[places], lower[places], upper[places], not treatment.summed, heard)
            self.own |= rows.own
            if H is not None:
                self.normals[cloth] = places, H
            return places, best, rows.sure

        made = [partial(fitted_one, cloth) for cloth in self.objective.cloths]
        self._sure = True
        for places, values, each in together(made) if self.at_once else (each() for each in made):
            found[places] = values
            self._sure &= each
        return found

    def along_targets(self, p: Array, whole: bool, waiting: Callable[[], None]) -> Array:
        """Values (P,) near p (P,) with which the steps along the targets, or `whole` motions, end nearest to these; p
        where no step shows that, or where steps end farther away than rounding explains.
        """
        along = AlongTarget.of(self.objective, p, whole)
        if along is None or along.typical > ROUGHLY * self.objective.rounding:
            return p
        solutions = [(places, trust_region.inverse(trust_region.either(H))) for places, H in self.normals.values()]

        def balance(g: Array) -> Array:
            z = np.zeros(len(g))
            for places, solution in solutions:
                z[places] = solution(g[places])
            return z

        return np.asarray(np.clip(p + nearer(along, balance, waiting), *bounds(self.objective.scene)))


def equations(
    objective: Objective, p: Array, fitted: Flags, cloth: int, treatment: Treatment = TREATMENTS[0],
    forms: Sequence[prescribed.Forms] | None = None,
) -> tuple[Indices, Equations | None]:  # fmt: skip
    """The places of the masses and stiffnesses of a cloth that are fitted, and its balances by them, if any are, of
    steps of these `forms`, of each run, or plain ones.
    """
    own = [block for block in objective.blocks_of(cloth) if is_linear(block)]
    places = np.concatenate([np.arange(b.start, b.start + b.count) for b in own] or [np.zeros(0, int)])
    places = places[fitted[places]]
    if not len(places):
        return places, None
    column = np.full(len(p), -1, np.int32)
    column[places] = np.arange(len(places))
    every = zip(objective.runs, forms or itertools.repeat(None), strict=False)
    parts = [rows_of(run, p, own, column, treatment, forms=its) for run, its in every if run.cloth == cloth]
    return places, Equations(parts, treatment.anchored)


def anchors(objective: Objective, fitted: Flags) -> bool:
    """Whether there is a mass to hold: some cloth has masses and stiffnesses that are fitted."""
    own = [block for block in objective.blocks if is_linear(block) and fitted[block.part].any()]
    masses, others = ({block.cloth for block in own if (block.name == "mass") is heavy} for heavy in (True, False))
    return bool(masses & others)


def is_linear(block: Block) -> bool:
    """Whether the balances are linear in the parameters of a block: masses and stiffnesses, but for those of a map."""
    return block.name in LETTERED and block.mode != "M"


def fits(objective: Objective) -> bool:
    """Whether the balances of each cloth fit into what an objective may hold."""
    return max(needed(objective), default=0) <= objective.room


def needed(objective: Objective) -> list[int]:
    """The bytes that the balances of each cloth take."""
    sizes = [
        (run.steps * (3 * len(run.system.x0) + 6 * len(run.system.springs.rest)) for run in group)
        for group in ([run for run in objective.runs if run.cloth == cloth] for cloth in objective.cloths)
    ]
    return [ENTRY * sum(each) for each in sizes]


def information(objective: Objective, p: Array, fitted: Flags, factor: Array) -> tuple[Array, Array, float, int] | None:
    """H = CᵀC and g = −Cᵀr (Q,) of the balances at p (P,), by the parameters that are `fitted`, times `factor` (P,);
    their sum of squares and number. None unless every free vertex is seen at every step and only masses and
    stiffnesses are fitted: then a direction that the balances do not show leaves the motion as it is, and only then.
    """
    kinds = {block.name for block in objective.blocks if fitted[block.part].any()}
    if not (fits(objective) and objective.plain and kinds <= set(LETTERED)) or int(fitted.sum()) > DENSE:
        return None
    places = np.flatnonzero(fitted)
    H, g, squares, count = np.zeros((len(places),) * 2), np.zeros(len(places)), 0.0, 0
    for run in objective.runs:
        own = objective.blocks_of(run.cloth)
        column = np.full(len(p), -1, np.int32)
        for block in own:
            column[block.part] = np.where(fitted[block.part], (np.cumsum(fitted) - 1)[block.part], -1)
        part = rows_of(run, p, own, column, TREATMENTS[0], len(places))
        steps = run.steps - (1 if run.system.method == EXPLICIT else 0)
        if part.counts.sum() < 3 * steps * int(run.system.vertex.free.sum()):
            return None
        rows, none = Equations([part]), np.zeros(len(places))
        kept = in_balance(rows, rows.counts > 0, none)
        H += factor[places, None] * rows.gram(kept).toarray() * factor[places]
        g -= factor[places] * rows.right(none, kept)
        squares, count = squares + float((rows.sizes(none)[0][kept] ** 2).sum()), count + int(rows.counts[kept].sum())
    return H, g, squares, count


def rows_of(
    run: Run, p: Array, own: Sequence[Block], column: Indices, treatment: Treatment, width: int | None = None,
    forms: prescribed.Forms | None = None,
) -> Rows:
    """The rows of one run, by the parameters of its masses and stiffnesses; Q is `width`, or as many as
    `column` (P,) has.
    """
    system = run.changed(p)
    seen = track(run.comparison.goal, system)
    seen = smoothed(seen, system.x0, treatment.frames) if treatment.frames > 1 else seen
    made = balances(system, seen, treatment == TREATMENTS[0], forms)
    acting = [(block, part) for block, part in run.acting if block in own]
    wanted = columns(system, acting, p, column, np.ones(len(p)), width or int(column.max()) + 1)
    families = [spring_groups(run.scene.cloths[each]).of for each in run.scene.together(run.cloth)]
    first = np.cumsum([0, *(own.max(initial=-1) + 1 for own in families)])
    family = np.concatenate([own + begin for own, begin in zip(families, first, strict=False)])
    return Rows(summed_twice(made, system.method) if treatment.summed else made, system, spread(wanted), family)


def spread(wanted: Columns) -> csr_array:
    """∂(masses, stiffnesses)/∂parameters (n + S, Q)."""
    from scipy.sparse import csr_array

    shares = (wanted.mass, wanted.stiffness)
    column, factor = (np.concatenate([getattr(share, name) for share in shares]) for name in ("column", "factor"))
    entries = np.concatenate([np.diff(share.start) for share in shares])
    row, moved = np.repeat(np.arange(len(entries)), entries), column >= 0
    return csr_array((factor[moved], (row[moved], column[moved])), shape=(len(entries), wanted.width))


def solve(
    rows: Equations,
    p: Array,
    lower: Array,
    upper: Array,
    trim: bool,
    waiting: Callable[[], None] | None = None,
) -> tuple[Array, csr_array | None]:
    """The parameters (Q,) within the bounds that make r − C (q − p) least, from p (Q,), and CᵀC (Q, Q), if there are
    rows; with `trim` over the steps that can be in balance.

    What the rows do not determine stays as it is in p. Refinement with the rows themselves undoes what squaring the
    matrix costs; each way is as long as is best, as what the rows hardly show is short by what keeps H regular, or
    drowns: above all the common factor of masses and stiffnesses, which only the air shows.
    """
    kept: Flags = rows.counts > 0
    if not kept.any():
        return p, None
    if trim and rows.agreed is not None and rows.agreed.any():
        kept = balanced_beside(rows, kept, rows.agreed)
        H = rows.gram(kept)
    else:
        H = rows.gram(kept)
        good = trimmed(rows, kept, trust_region.either(H)) if trim else kept
        if not np.array_equal(good, kept) or rows.agreed is not None:  # which rows count may have changed, too
            kept, H = good, rows.gram(good)
    size = np.sqrt(H.diagonal())
    determined = size > 0
    scale = np.where(determined, size, 1.0)
    low, high = (lower - p) * scale, (upper - p) * scale
    scaled, q = trust_region.either(H.multiply(1.0 / scale).multiply(1.0 / scale[:, None]).tocsr()), np.zeros(len(p))

    def along(way: Array) -> Array:
        return np.clip(q + rows.length(q / scale, way / scale, kept) * way, low, high)

    for _ in range(ROUNDS):
        before, g = q, -rows.right(q / scale, kept) / scale
        q = along(trust_region.solve(scaled, g, low - q, high - q, waiting=waiting))
        q = along(p * scale + q)
        if np.linalg.norm(q - before) <= UNCHANGED * np.linalg.norm(q):
            break
    inner = np.clip(p + q / scale, lower, upper)
    ended = np.where(q >= high * NEARLY, upper, np.where(q <= low * NEARLY, lower, inner))  # to the bit
    return np.asarray(np.where(determined, ended, p)), H
