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

Which steps of a motion can be in balance, and how they were taken.

Few steps of a motion may not be in balance as the scene has it, whatever the parameters: those that were shortened
(`step.guard`) or taken with the clamped matrix, and Euler steps among those of BDF2. How a step was taken shows in all
of the cloth. So values are determined from some steps that follow one another in a patch of it alone, and those of most
steps that are in balance with them count: most need not be, and many more rows than values prove it. Where none agree,
as in noise, it is least trimmed squares: the half of the steps that is nearest to balance is balanced again and again,
until it stays the same. Steps out of balance are left out.

P. J. Rousseeuw, Least median of squares regression, Journal of the American Statistical Association 79, 1984;
P. J. Rousseeuw, K. Van Driessen, Computing LTS regression for large data sets, Data Mining and Knowledge Discovery 12,
2006.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.derivative.adjoint import Sweep
from clothfit.derivative.sensitivity import Columns, columns
from clothfit.engine import prescribed
from clothfit.engine.system import EXPLICIT, System, mobile
from clothfit.kernels.parallel import only_here, together
from clothfit.objective.objective import Objective
from clothfit.objective.run import Run
from clothfit.optimise import trust_region
from clothfit.optimise.balances import Equations, Patch, Rows, balances, relative, smoothed, summed_twice, track
from clothfit.scene.block import Block
from clothfit.scene.fit_vector import bounds, changes
from clothfit.scene.kinds import LETTERED, REST

if TYPE_CHECKING:
    from scipy.sparse import csr_array

DENSE = 6000
"""Parameters up to which normal equations may be dense: those of `information`, and those that hold the whole mass,
which couples all masses.
"""

ENTRY = 32
"""Bytes for each number in the balances, with those of sums beside it."""

NEARLY = 1.0 - 4.0 * np.finfo(float).eps
"""Share of the way to a bound that is all of it but for rounding."""

REFINEMENTS = 3
"""Solutions for what the one before left: the first loses half of the digits, as CᵀC is badly conditioned."""


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
        self._kept: dict[int, tuple[Indices, Equations | None]] = {}

    def rows(self, cloth: int, treatment: Treatment = TREATMENTS[0]) -> tuple[Indices, Equations | None]:
        """The places of the values of a cloth, and its balances."""
        if treatment not in (TREATMENTS[0], ANCHORED):
            return equations(self.objective, self.p, self.fitted, cloth, treatment)
        if cloth not in self._kept:
            made = equations(self.objective, self.p, self.fitted, cloth)
            if not self.at_once:
                return made
            self._kept[cloth] = made
        places, rows = self._kept[cloth]
        return places, Equations(rows.parts, True) if rows and treatment.anchored else rows

    def agree(self) -> bool:
        """Whether enough steps of a cloth agree on its values."""
        for _, rows in map(self.rows, self.objective.cloths):
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
        lower, upper = bounds(self.objective.scene)
        found, heard = self.p.copy(), only_here(waiting)

        def fitted_one(cloth: int) -> tuple[Indices, Array]:
            places, rows = self.rows(cloth, treatment)
            if rows is None:
                return places, found[places]
            best = solve(rows, found[places], lower[places], upper[places], not treatment.summed, heard)
            self.own |= rows.own
            return places, best

        made = [partial(fitted_one, cloth) for cloth in self.objective.cloths]
        for places, values in together(made) if self.at_once else (each() for each in made):
            found[places] = values
        return found

    def along_targets(self, p: Array, whole: bool, waiting: Callable[[], None]) -> Array:
        """Values (P,) near p (P,) with which the steps along the targets, or `whole` motions, end nearest to these; p
        where no step shows that, or where steps end farther away than rounding explains.
        """
        along = AlongTarget.of(self.objective, p, whole)
        if along is None or along.typical > ROUGHLY * self.objective.rounding:
            return p
        found = [(places, rows.normal) for places, rows in map(self.rows, self.objective.cloths) if rows]
        solutions = [(places, trust_region.inverse(trust_region.either(H))) for places, H in found if H is not None]

        def balance(g: Array) -> Array:
            z = np.zeros(len(g))
            for places, solution in solutions:
                z[places] = solution(g[places])
            return z

        return np.asarray(np.clip(p + nearer(along, balance, waiting), *bounds(self.objective.scene)))


class SingleSteps(NamedTuple):
    """How far steps end from a target if each begins in the state that this shows."""

    steps: int
    rmse: float  # m, of all of them
    largest: float  # m, of the one that ends farthest


LOOSE = 1e-3
"""Tolerance of the linear systems of products for single steps, whose errors do not grow."""


class Shown(NamedTuple):
    """A run whose steps begin in the states that its target shows."""

    run: Run
    system: System
    seen: Flags  # (T + 1, n)
    single: prescribed.Single


class AlongTarget:
    """Where the steps of p (P,) end that begin in the states of targets, and what changes of p make of that, by sweeps
    along the targets: the residuals (T + 1, n, 3), m, of each run, and products with their derivative J.

    Steps that end far out, as they take another form than the target's, are left out. As `whole` motions each step
    inherits what those before have missed: residuals of the motions from their starts, but to the first order about
    targets, not about motions that have left them.
    """

    def __init__(self, objective: Objective, p: Array, runs: Sequence[Shown], whole: bool) -> None:
        self.objective, self.p, self.runs, self.whole = objective, p, runs, whole
        self.tolerance = objective.tolerance if whole else max(LOOSE, objective.tolerance)  # of products

    @classmethod
    def of(cls, objective: Objective, p: Array, whole: bool = False) -> AlongTarget | None:
        """Those of p (P,), in the time of a simulation; None where a step fails, or where a step does not show in the
        positions after it.
        """
        if objective.scene.method in (EXPLICIT, REST):
            return None
        runs = list[Shown]()
        for run in objective.runs:
            system = run.changed(p)
            shown = track(run.comparison.goal, system)
            single = prescribed.single_steps(system, shown.x, shown.seen, objective.tolerance)
            if single is None:
                return None
            runs.append(Shown(run, system, shown.seen, single))
        return cls(objective, p, runs, whole)

    @property
    def steps(self) -> SingleSteps:
        """How far the single steps end from the targets."""
        sizes, counts = (np.concatenate([np.zeros(0), *each]) for each in zip(*map(sizes_of, self.runs), strict=True))
        rmse = float(np.sqrt((sizes**2 * counts).sum() / counts.sum()))
        return SingleSteps(len(sizes), rmse, float(sizes.max(initial=0.0)))

    @property
    def typical(self) -> float:
        """How far a step ends from the target in the median, m: a few take another form than the target's."""
        return float(np.median(np.concatenate([np.zeros(0), *(sizes_of(each)[0] for each in self.runs)])))

    def residuals(self) -> list[Array]:
        """The residuals."""
        return [self._swept(each, np.zeros(len(self.p)), each.single.away) for each in self.runs]

    def forward(self, z: Array) -> list[Array]:
        """J z of a change z (P,)."""
        return [self._swept(each, z, np.zeros_like(each.single.away)) for each in self.runs]

    def back(self, w: Sequence[Array]) -> Array:
        """Jᵀ w (P,)."""
        gradient = np.zeros(len(self.p))
        for (run, system, _, (part, _, _)), own in zip(self.runs, w, strict=True):
            for each in [part] if self.whole else [part.part(t, t + 1) for t in range(part.steps)]:
                self.objective.add_pullback(run, self.p, system, each, own, gradient, self.tolerance)
        return gradient

    def _swept(self, shown: Shown, z: Array, away: Array) -> Array:
        run, system, seen, (part, _, h) = shown
        sweep = Sweep(system, changes(run.scene, run.cloth, self.p, z), self.tolerance)
        change = np.zeros_like(part.x)
        for t in range(part.steps):
            for each in () if self.whole else sweep.state:
                each[:] = 0.0
            sweep.through(part.part(t, t + 1))
            sweep.state[0][:] += away[t]
            sweep.state[1][:] += away[t] / h[t]
            change[t + 1] = sweep.state[0]
        shows = seen.copy()
        shows[1:][sizes_of(shown)[0] > (np.inf if self.whole else OUT_OF_BALANCE * self.typical)] = False
        return np.asarray(np.where(shows[..., None], change, 0.0))


def sizes_of(shown: Shown) -> tuple[Array, Array]:
    """How far each step ends from the target, m, root mean square, and of how many vertices that is, at least 1, (T,)
    each.
    """
    counts = np.maximum((shown.seen[1:] & mobile(shown.system)).sum(axis=1), 1)
    return np.asarray(np.sqrt((shown.single.away**2).sum(axis=(1, 2)) / counts)), counts


ROUGHLY = 100.0
"""Roundings of positions that single steps of values by balances may leave: what these values make of rounding."""

ROUNDS_ALONG, SAVED = 20, 0.1
"""Products with J and Jᵀ, at most, for a change of the values, which ends where another one saves less than this share
of the squares.
"""


def nearer(along: AlongTarget, balance: Callable[[Array], Array], waiting: Callable[[], None]) -> Array:
    """The change z (P,) of values that makes the squares of r + J z least, by conjugate gradients on its normal
    equations; `balance` is their preconditioner, the solution of those of the balances. Gradients are made orthogonal
    to all before: of motions that make much of small changes J is large in a few directions, which rounding else brings
    back.
    """
    z, r, before = np.zeros(len(along.p)), along.residuals(), list[tuple[Array, Array]]()
    squares, d, last = sum(float((own * own).sum()) for own in r), z, 1.0
    for _ in range(ROUNDS_ALONG):
        g = -along.back(r)
        y = balance(g)
        for other, solved in before:
            y = y - solved * (other @ y) / (other @ solved)
        if not g @ y > 0.0:
            break
        before.append((g, y))
        d, last = y + d * (g @ y) / last, float(g @ y)
        change = along.forward(d)
        share = last / sum(float((own * own).sum()) for own in change)
        z, r = z + share * d, [own + share * more for own, more in zip(r, change, strict=True)]
        left, squares = squares, sum(float((own * own).sum()) for own in r)
        waiting()
        if squares > (1.0 - SAVED) * left:
            break
    return z


def equations(
    objective: Objective, p: Array, fitted: Flags, cloth: int, treatment: Treatment = TREATMENTS[0]
) -> tuple[Indices, Equations | None]:
    """The places of the masses and stiffnesses of a cloth that are fitted, and its balances by them, if any are."""
    own = [block for block in objective.blocks_of(cloth) if is_linear(block)]
    places = np.concatenate([np.arange(b.start, b.start + b.count) for b in own] or [np.zeros(0, int)])
    places = places[fitted[places]]
    if not len(places):
        return places, None
    column = np.full(len(p), -1, np.int32)
    column[places] = np.arange(len(places))
    parts = [rows_of(run, p, own, column, treatment) for run in objective.runs if run.cloth == cloth]
    return places, Equations(parts, treatment.anchored)


def anchors(objective: Objective, fitted: Flags) -> bool:
    """Whether there is a whole mass to hold: some cloth has masses and stiffnesses that are fitted, not too many."""
    own = [block for block in objective.blocks if is_linear(block) and fitted[block.part].any()]
    masses, others = ({block.cloth for block in own if (block.name == "mass") is heavy} for heavy in (True, False))
    return bool(masses & others) and int(fitted.sum()) <= DENSE


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
    run: Run, p: Array, own: Sequence[Block], column: Indices, treatment: Treatment, width: int | None = None
) -> Rows:
    """The rows of one run, by the parameters of its masses and stiffnesses; Q is `width`, or as many as
    `column` (P,) has.
    """
    system = run.changed(p)
    seen = track(run.comparison.goal, system)
    seen = smoothed(seen, system.x0, treatment.frames) if treatment.frames > 1 else seen
    made = balances(system, seen, treatment == TREATMENTS[0])
    acting = [(block, part) for block, part in run.acting if block in own]
    wanted = columns(system, acting, p, column, np.ones(len(p)), width or int(column.max()) + 1)
    return Rows(summed_twice(made, system.method) if treatment.summed else made, system, spread(wanted))


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
) -> Array:
    """The parameters (Q,) within the bounds that make r − C (q − p) least, from p (Q,); with `trim` over the steps
    that can be in balance.

    What the rows do not determine stays as it is in p. Two rounds of refinement with the rows themselves undo what
    squaring the matrix costs.
    """
    kept: Flags = rows.counts > 0
    if not kept.any():
        return p
    if trim and rows.agreed is not None and rows.agreed.any():
        kept = balanced_beside(rows, kept, rows.agreed)
        H = rows.gram(kept)
    else:
        H = rows.gram(kept)
        good = trimmed(rows, kept, trust_region.either(H)) if trim else kept
        if not np.array_equal(good, kept) or rows.agreed is not None:  # which rows count may have changed, too
            kept, H = good, rows.gram(good)
    rows.normal = H
    size = np.sqrt(H.diagonal())
    determined = size > 0
    scale = np.where(determined, size, 1.0)
    low, high = (lower - p) * scale, (upper - p) * scale
    scaled, q = trust_region.either(H.multiply(1.0 / scale).multiply(1.0 / scale[:, None]).tocsr()), np.zeros(len(p))
    for _ in range(REFINEMENTS):
        g = -rows.right(q / scale, kept) / scale
        q = q + trust_region.solve(scaled, g, low - q, high - q, waiting=waiting)
    inner = np.clip(p + q / scale, lower, upper)
    ended = np.where(q >= high * NEARLY, upper, np.where(q <= low * NEARLY, lower, inner))  # to the bit
    return np.asarray(np.where(determined, ended, p))


OUT_OF_BALANCE = 10.0
"""Times the median residual of the steps from which on a step is out of balance."""

UNEVEN = 3.0
"""The same for a balance that all steps share in, so that those which are in none spoil it for the others."""

NEGLIGIBLE = 1e-8
"""Residual, relative to what masses and stiffnesses make of their columns, up to which a step is in balance however
much less the others' is: a hundred times the tolerance of the linear systems of an exact target.
"""

EXACT = 1e-6
"""The same up to which a step is in balance beside others that are."""

SHARP = 1e-3
"""The same of a share of the steps, or of half of those that agree, up to which they are taken for exact but for the
rounding of a file, and the others for exceptions, how many they may be: nearer than noise or another model comes.
"""

MOST_OUT = 0.25
"""Share of the steps that may be out of balance; where more are, it is not the steps that are exceptions."""

ROUNDS = 10
"""Rounds of trimming; a few suffice."""

PATCH, PATCHES, RUN = 36, 3, 3
"""Vertices of a patch, patches of a motion, and steps that follow one another, at least, with which values begin."""

BEGIN, SURELY = 1.1, 1.5
"""Rows of these steps for each value: as few as one can do with; and so many that such steps show that they agree."""

DAMPED = 1e-12
"""Added to CᵀC of a patch, whose columns have the length 1: what is below it is rounding."""

DETERMINED = 1e-6
"""Eigenvalue of CᵀC of a patch, relative to the largest, from which on a direction counts as shown."""

CHANGED = 1e-3
"""Change of the rows of a patch from one step to the next, relative to their size, with which a step is another one."""

SHARE = 0.25
"""Share of the steps, at least, that must agree where they do so no better than noise lets them: the others may all be
exceptions.
"""

FEW, VOTES, VOTERS = 4, 0.05, 8
"""Values, at most, on which single rows vote; the share of the rows that must agree, and the vertices, at least, as one
at rest says the same in each step.
"""

ROWS_EACH = 4
"""Rows for each parameter, at least."""


def trimmed(rows: Equations, known: Flags, H: trust_region.Matrix) -> Flags:
    """The steps (S,) that can be in balance, of those that are `known`, whose CᵀC (Q, Q) is H."""
    if rows.counts[known].sum() < ROWS_EACH * H.shape[0]:
        return known
    q = balanced(rows, known, H)
    size, terms = rows.sizes(q)
    if size[known].max() <= NEGLIGIBLE * np.median(terms[known]):
        rows.own = True
        return known
    agreed = consensus(rows, known)
    if agreed.any():
        return balanced_beside(rows, known, agreed)
    if size[known].max() <= UNEVEN * np.median(size[known]):  # as noise leaves it
        return known
    return in_balance(rows, known, nearest_half(rows, known, q))


def consensus(rows: Equations, known: Flags) -> Flags:
    """The known steps (S,) that agree on the values in some patch of each part; none where too few do."""
    if rows.agreed is None:
        rows.agreed = np.zeros(len(known), bool)
        if rows.Q <= FEW and all(map(vote, rows.parts)):
            rows.counts = np.concatenate([part.counts for part in rows.parts])
            rows.agreed[:] = rows.own = True
            return rows.agreed & known
        for before, patches in rows.patches(PATCH, PATCHES):
            for patch in patches:
                found = agreeing(patch)
                rows.own |= found.own
                if found.steps.any():
                    rows.agreed[before + patch.steps] = found.steps
                    break
    return rows.agreed & known


def vote(part: Rows) -> bool:
    """Whether many rows of a part that depend on one value agree on it, for each value, though no whole step does: as
    parts of a cloth touch something, or are compressed, in each. Then no others count.
    """
    C, r, kept = part.by_columns(), part.found.residual, np.zeros(part.found.valid.shape, bool)
    slopes = np.linalg.norm(C, axis=3)
    for own, slope in zip(C, slopes, strict=True):
        alone = part.found.valid & (slope > 0) & (slope == slopes.sum(axis=0))
        if not alone.any():
            return False
        guess = (own[alone] * r[alone]).sum(axis=1) / slope[alone] ** 2
        votes, near = np.sort(guess), EXACT * float(np.median(np.abs(guess)))
        counts = np.searchsorted(votes, votes + near) - np.arange(len(votes))
        value = float(np.median(votes[counts.argmax() :][: counts.max()]))
        left = np.linalg.norm(r - own * value, axis=2) <= near * slope
        if counts.max() < VOTES * len(votes) or (left & alone).any(axis=0).sum() < VOTERS:
            return False
        kept |= left & alone
    part.keep(kept)
    return True


def balanced_beside(rows: Equations, known: Flags, agreed: Flags) -> Flags:
    """Which of the known steps (S,) are in balance beside those that have agreed."""
    away = relative(*rows.sizes(balanced(rows, agreed)))
    return known & is_sharp(away, away[agreed])


class Agreeing(NamedTuple):
    """Which steps of a patch agree on its values."""

    steps: Flags  # (T,); none where they are too few
    own: bool  # whether some, however few, show that they are those of the model


def agreeing(patch: Patch) -> Agreeing:
    """The most steps of a patch that are in balance with the same values, which some that follow one another determine
    (M. A. Fischler, R. C. Bolles, Random sample consensus, Communications of the ACM 24, 1981): as few as can, as a
    motion may have no more between exceptions, or else more, and twice as many, by which rounding of the target hardly
    scatters them.
    """
    T, R, Q = len(patch.steps), patch.entries.shape[1], patch.spread.shape[1]
    fewest, enough = (max(RUN, int(np.ceil(share * Q / max(R, 1)))) for share in (BEGIN, SURELY))
    own = False
    for steps in sorted({fewest, enough, 2 * enough}) if Q else ():
        if steps <= T:
            found = agreeing_with_runs(patch, steps)
            own |= found.own
            if found.steps.any():
                return found
    return Agreeing(np.zeros(T, bool), own)


def agreeing_with_runs(patch: Patch, length: int) -> Agreeing:
    """The same with runs of so many steps."""
    C = patch.entries @ patch.spread
    (T, R, Q), best = C.shape, np.zeros(len(C), bool)
    runs = [slice(first, first + length) for first in range(T - length + 1)]
    found = patch.away(np.array([solved(C[run], patch.residual[run]) for run in runs]).reshape(len(runs), Q).T)
    own = any(away[run].max() <= EXACT and shows_more(C[run]) for away, run in zip(found.T, runs, strict=True))
    for away, run in zip(found.T, runs, strict=True):
        if np.median(away[run]) <= SHARP:
            best = max(best, is_sharp(away, away[run]), key=np.sum)
    for _ in range(ROUNDS if best.any() else 0):
        away = patch.away(solved(C[best], patch.residual[best])[:, None])[:, 0]
        before, best = best, is_sharp(away, away[best]) & (np.median(away[best]) <= SHARP)
        if not best.any() or np.array_equal(best, before):
            break
    sure = best.any() and away[best].max() <= EXACT and shows_more(C[best])
    suffices = best.sum() * R >= ROWS_EACH * Q and (sure or best.mean() >= SHARE)
    return Agreeing(best if suffices else np.zeros(T, bool), own or bool(suffices))


def shows_more(C: Array) -> bool:
    """Whether the rows C (K, R, Q) of some steps determine more than those of one could, and `SURELY` holds. Steps that
    are as the one before do not count: of a cloth at rest all are, and some values balance any shape.
    """
    others = 1 + int((np.linalg.norm(np.diff(C, axis=0), axis=(1, 2)) > CHANGED * np.linalg.norm(C[0])).sum())
    flat = C.reshape(-1, C.shape[2])
    size = np.linalg.norm(flat, axis=0)
    flat = flat / np.where(size > 0, size, 1.0)
    shown = np.linalg.eigvalsh(flat.T @ flat)
    rank = int((shown > DETERMINED * shown.max(initial=0.0)).sum())
    return bool(C.shape[1] < rank <= others * C.shape[1] / SURELY)


def solved(C: Array, r: Array) -> Array:
    """The minimum q (Q,) of |r − C q|², but for what the rows C (K, R, Q) hardly determine, with r (K, R)."""
    from scipy.linalg import cho_factor, cho_solve

    flat = C.reshape(-1, C.shape[2])
    size = np.linalg.norm(flat, axis=0)
    flat, q = flat / np.where(size > 0, size, 1.0), np.zeros(len(size))
    factor = cho_factor(flat.T @ flat + DAMPED * np.eye(len(q)))
    for _ in range(REFINEMENTS):
        q = q + cho_solve(factor, flat.T @ (r.ravel() - flat @ q))
    return np.asarray(q / np.where(size > 0, size, 1.0))


def nearest_half(rows: Equations, known: Flags, q: Array) -> Array:
    """The parameters (Q,) that balance the half of the steps which is nearest to balance, from q (Q,) on."""
    half: Flags = np.zeros(len(known), bool)
    for _ in range(ROUNDS):
        size = rows.sizes(q)[0]
        before, half = half, known & (size <= np.median(size[known]))
        if np.array_equal(half, before):
            break
        q = balanced(rows, half)
    return q


def in_balance(rows: Equations, known: Flags, q: Array) -> Flags:
    """Which of the known steps (S,) are in balance at q (Q,): all, where too many would not be."""
    size, terms = rows.sizes(q)
    away = relative(size, terms)
    nearest = np.sort(away[known])[: int(np.ceil(SHARE * known.sum()))]
    if nearest.max(initial=0.0) <= SHARP:
        return known & is_sharp(away, nearest)
    good = known & (size <= OUT_OF_BALANCE * np.median(size[known]))
    return np.asarray(good if good[known].mean() >= 1.0 - MOST_OUT else known)


def is_sharp(away: Array, others: Array) -> Flags:
    """Which steps with residuals `away`, relative, are in balance beside others, of which most are."""
    return np.asarray(away <= max(OUT_OF_BALANCE * float(np.median(others)), EXACT))


def balanced(rows: Equations, kept: Flags, H: trust_region.Matrix | None = None) -> Array:
    """The minimum q (Q,) of |r − C q|² over some steps, without bounds."""
    G = trust_region.either(rows.gram(kept)) if H is None else H
    return trust_region.unbounded(G, rows.right(np.zeros(G.shape[0]), kept))
