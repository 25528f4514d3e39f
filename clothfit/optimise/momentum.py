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

Few steps of a motion may not be in balance at all, whatever the parameters: those that were shortened (`step.guard`) or
taken with the clamped matrix, and Euler steps among those of BDF2. They are found by least trimmed squares, and left
out: P. J. Rousseeuw, Least median of squares regression, Journal of the American Statistical Association 79, 1984.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.derivative.columns import columns
from clothfit.derivative.sensitivity import Columns
from clothfit.engine.system import EXPLICIT
from clothfit.objective.objective import Objective
from clothfit.objective.run import Run
from clothfit.optimise import bounded
from clothfit.optimise.balances import Rows, balances, matrix, smoothed, stacked, summed_twice, track
from clothfit.scene.block import Block
from clothfit.scene.fit_vector import bounds
from clothfit.scene.kinds import LETTERED

if TYPE_CHECKING:
    from scipy.sparse import csr_array

DENSE = 6000
"""Parameters up to which the normal equations are a dense matrix."""


ENTRY = 100
"""Bytes for each number in the balances, in all the forms that it takes on the way to a matrix."""


OUT_OF_BALANCE = 10.0
"""Times the median residual of the steps from which on a step is out of balance."""

UNEVEN = 3.0
"""The same for a balance that all steps share in, so that those which are in none spoil it for the others."""

NEGLIGIBLE = 1e-8
"""Residual, relative to what masses and stiffnesses make of their columns, up to which a step is in balance however
much less the others' is: a hundred times the tolerance of the linear systems of an exact target.
"""

MOST_OUT = 0.25
"""Share of the steps that may be out of balance; where more are, it is not the steps that are exceptions."""

ROUNDS = 10
"""Rounds of trimming; a few suffice."""

RIDGE = 1e-12
"""What makes a matrix regular that finds the steps out of balance, relative to its diagonal."""


class Treatment(NamedTuple):
    """What is done to the target and to the balances against noise."""

    frames: int  # over which the target is smoothed, odd
    summed: bool  # whether the balances are summed twice over time


TREATMENTS = (
    Treatment(1, False),
    Treatment(1, True),
    Treatment(7, True),
    Treatment(15, True),
    Treatment(7, False),
    Treatment(15, False),
)
"""From exact targets to very noisy ones."""


def fit(
    objective: Objective,
    p: Array,
    fitted: Flags,
    treatment: Treatment = TREATMENTS[0],
    waiting: Callable[[], None] | None = None,
) -> Array:
    """Fit the masses and stiffnesses among the parameters p (P,) that are `fitted` (P,); the rest stays, and so do the
    factors of maps. A fit of thousands of values calls `waiting` now and then.

    What no complete balance determines stays as well: everything, where the target shows no three successive steps.
    """
    lower, upper = bounds(objective.scene)
    found = p.copy()
    for cloth in objective.cloths:
        own = [block for block in objective.blocks if block.cloth == cloth and is_linear(block)]
        places = np.concatenate([np.arange(b.start, b.start + b.count) for b in own] or [np.zeros(0, int)])
        places = places[fitted[places]]
        if not len(places):
            continue
        column = np.full(len(p), -1, np.int32)
        column[places] = np.arange(len(places))
        parts = [rows_of(objective, run, p, own, column, treatment) for run in objective.runs if run.cloth == cloth]
        whole = stacked(parts)
        found[places] = solve(whole, p[places], lower[places], upper[places], not treatment.summed, waiting)
    return found


def is_linear(block: Block) -> bool:
    """Whether the balances are linear in the parameters of a block: masses and stiffnesses, but for those of a map."""
    return block.name in LETTERED and block.mode != "M"


def fits(objective: Objective) -> bool:
    """Whether the balances fit into what an objective may hold."""
    sizes = (
        (run.steps * (3 * len(run.system.x0) + 6 * len(run.system.springs.rest)) for run in group)
        for group in ([run for run in objective.runs if run.cloth == cloth] for cloth in objective.cloths)
    )
    return ENTRY * max((sum(each) for each in sizes), default=0) <= objective.room


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
        own = [block for block in objective.blocks if block.cloth == run.cloth]
        column = np.full(len(p), -1, np.int32)
        for block in own:
            column[block.part] = np.where(fitted[block.part], (np.cumsum(fitted) - 1)[block.part], -1)
        rows = rows_of(objective, run, p, own, column, TREATMENTS[0], len(places))
        steps = run.steps - (1 if run.system.method == EXPLICIT else 0)
        if len(rows.r) < 3 * steps * int(run.system.vertex.free.sum()):
            return None
        rows = rows.only(in_balance(rows, np.zeros(len(places)))).times(factor[places])
        H += (rows.C.T @ rows.C).toarray()
        g -= rows.C.T @ rows.r
        squares, count = squares + float(rows.r @ rows.r), count + len(rows.r)
    return H, g, squares, count


def rows_of(
    objective: Objective,
    run: Run,
    p: Array,
    own: Sequence[Block],
    column: Indices,
    treatment: Treatment,
    width: int | None = None,
) -> Rows:
    """The rows of one run, by the parameters of its masses and stiffnesses; Q is `width`, or as many as
    `column` (P,) has.
    """
    system = run.changed(p)
    seen = track(run.comparison.goal, system)
    rows = balances(system, smoothed(seen, system.x0, treatment.frames) if treatment.frames > 1 else seen)
    given = matrix(summed_twice(rows, system.method) if treatment.summed else rows, system)
    wanted = columns(system, own, p, column, np.ones(len(p)), width or int(column.max()) + 1)
    return given._replace(C=given.C @ spread(wanted))


def spread(wanted: Columns) -> csr_array:
    """∂(masses, stiffnesses)/∂parameters (n + S, Q)."""
    from scipy.sparse import csr_array

    shares = (wanted.mass, wanted.stiffness)
    column, factor = (np.concatenate([getattr(share, name) for share in shares]) for name in ("column", "factor"))
    entries = np.concatenate([np.diff(share.start) for share in shares])
    row, moved = np.repeat(np.arange(len(entries)), entries), column >= 0
    return csr_array((factor[moved], (row[moved], column[moved])), shape=(len(entries), wanted.width))


def iterated(scaled: csr_array, r: Array) -> Array:
    """The least-squares solution q (Q,) of scaled q = r by LSMR, for problems too large for a dense matrix."""
    from scipy.sparse.linalg import lsmr

    q, *_ = lsmr(scaled, r, atol=1e-15, btol=1e-15, conlim=0.0, maxiter=4000)
    return np.asarray(q)


def solve(
    rows: Rows, p: Array, lower: Array, upper: Array, trim: bool, waiting: Callable[[], None] | None = None
) -> Array:
    """The parameters (Q,) within the bounds that make r − C (q − p) least, from p (Q,); with `trim` over the steps that
    can be in balance.

    What the rows do not determine stays as it is in p. Two rounds of refinement with the rows themselves undo what
    squaring the matrix costs.
    """
    size = np.sqrt(np.asarray(rows.C.multiply(rows.C).sum(axis=0)).reshape(-1))
    determined = size > 0
    scale = np.where(determined, size, 1.0)
    rows = rows.times(1.0 / scale)
    low, high = (lower - p) * scale, (upper - p) * scale
    if len(p) > DENSE:
        q = iterated(rows.C, rows.r)
        return np.asarray(np.where(determined, np.clip(p + q / scale, lower, upper), p))
    H = (rows.C.T @ rows.C).toarray()
    if trim:
        rows, H = trimmed(rows, H)
    q = np.zeros(len(p))
    for _ in range(3):
        g = -(rows.C.T @ (rows.r - rows.C @ q))
        q = q + bounded.solve(H, g, low - q, high - q, waiting=waiting)
    return np.asarray(np.where(determined, np.clip(p + q / scale, lower, upper), p))


def in_balance(rows: Rows, q: Array) -> Flags:
    """Which rows (N,) are of steps that are in balance at q (Q,): all, where too many would not be."""
    size = rows.residuals(q)
    good = size <= OUT_OF_BALANCE * np.median(size)
    return np.asarray((good if np.mean(good) >= 1.0 - MOST_OUT else np.ones(len(size), bool))[rows.step])


def trimmed(rows: Rows, H: Array) -> tuple[Rows, Array]:
    """The rows of the steps that can be in balance, and their CᵀC (Q, Q), from that of all, H: least trimmed squares.

    The half of the steps that is nearest to balance is balanced again and again, until it stays the same.
    """
    if len(rows.r) < 4 * len(H):
        return rows, H
    q = at_least_squares(rows, H)
    size = rows.residuals(q)
    if size.max() <= max(UNEVEN * np.median(size), NEGLIGIBLE * np.median(rows.terms(q))):
        return rows, H
    half: Flags = np.zeros(len(rows.r), bool)
    for _ in range(ROUNDS):
        size, before = rows.residuals(q), half
        half = np.asarray((size <= np.median(size))[rows.step])
        if np.array_equal(half, before):
            break
        nearest = rows.only(half)
        q = at_least_squares(nearest, (nearest.C.T @ nearest.C).toarray())
    good = rows.only(in_balance(rows, q))
    return good, (good.C.T @ good.C).toarray()


def at_least_squares(rows: Rows, H: Array) -> Array:
    """The minimum q (Q,) of |r − C q|², without bounds, H being CᵀC."""
    regular = bounded.shifted(H, RIDGE * float(H.diagonal().max(initial=0.0)) + np.finfo(float).tiny)
    return bounded.substitute(regular, rows.C.T @ rows.r)
