"""Which steps of a motion can be in balance, and how they were taken.

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

import itertools
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.optimise import trust_region
from clothfit.optimise.balances import Equations, Patch, Rows, anchor, relative

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

REFINEMENTS = 3
"""Solutions for what the one before left: the first loses half of the digits, as CᵀC is badly conditioned."""

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

ROUGH, ROUGH_SHARE = 5e-3, 0.1
"""The same of the steps that agree on one factor for each family of springs of a patch: so few values of so many rows
follow no noise, and of fine meshes rounding leaves much.
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
        rows.own = rows.sure = True
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
            rows.agreed[:] = rows.own = rows.sure = True
            return rows.agreed & known
        for before, patches in rows.patches(PATCH, PATCHES):
            for rough, patch in itertools.product((False, True), patches):
                found = agreeing(patch.by_families if rough else patch, rough, len(rows.anchor) > 0)
                rows.own |= found.own and not rough
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
    """Which of the known steps (S,) are in balance beside those that have agreed in a patch, and that no others of them
    leave out of balance in the cloth as a whole.
    """
    for _ in range(ROUNDS):
        away = relative(*rows.sizes(balanced(rows, agreed)))
        rows.sure = bool(away[agreed].max() <= EXACT)
        even = agreed & (away <= max(UNEVEN * float(np.median(away[agreed])), SHARP))
        if np.array_equal(even, agreed):
            break
        agreed = even
    return known & is_sharp(away, away[agreed])


class Squares(NamedTuple):
    """A patch, the rows of its steps by its values, and their squares."""

    patch: Patch
    C: Array  # (T, R, Q)
    gram: Array  # (T, Q, Q)
    anchor: Array  # (Q,), by which the mass of the patch is held

    @classmethod
    def of(cls, patch: Patch, anchored: bool) -> Squares:
        """Those of a patch; `anchored`: its mass is held."""
        C = patch.entries @ patch.spread
        gram = C.swapaxes(1, 2) @ C
        largest = np.diagonal(gram, axis1=1, axis2=2).max(initial=0.0)
        return cls(patch, C, gram, anchor(patch.spread[(patch.family < 0) & anchored], largest))

    def solved(self, steps: slice | Flags) -> Array:
        """The minimum q (Q,) of |r − C q|² of some steps, but for what their rows hardly determine."""
        from scipy.linalg import cho_factor, cho_solve

        C, r, held = self.C[steps], self.patch.residual[steps], self.anchor
        H = self.gram[steps].sum(axis=0) + np.outer(held, held)
        size = np.sqrt(H.diagonal())
        size[size == 0.0] = 1.0
        factor, q = cho_factor(H / np.outer(size, size) + DAMPED * np.eye(len(size))), np.zeros(len(size))
        for _ in range(REFINEMENTS):
            x = q / size
            q = q + cho_solve(factor, (np.tensordot(r - C @ x, C, 2) - held * (held @ x)) / size)
        return np.asarray(q / size)


class Agreeing(NamedTuple):
    """Which steps of a patch agree on its values."""

    steps: Flags  # (T,); none where they are too few
    own: bool  # whether some, however few, show that they are those of the model


def agreeing(patch: Patch, rough: bool = False, anchored: bool = False) -> Agreeing:
    """The most steps of a patch that are in balance with the same values, which some that follow one another determine
    (M. A. Fischler, R. C. Bolles, Random sample consensus, Communications of the ACM 24, 1981): as few as can, as a
    motion may have no more between exceptions, or else more, and twice as many, by which rounding of the target hardly
    scatters them. `rough`: where rounding may leave more of each of them; `anchored`: the mass of the patch is held.
    """
    T, R, Q = len(patch.steps), patch.entries.shape[1], patch.spread.shape[1]
    fewest, enough = (max(RUN, int(np.ceil(each * Q / max(R, 1)))) for each in (BEGIN, SURELY))
    own, rows = False, Squares.of(patch, anchored)
    for steps in sorted({fewest, enough, 2 * enough}) if Q else ():
        if steps <= T:
            found = agreeing_with_runs(rows, steps, rough)
            own |= found.own
            if found.steps.any():
                return found
    return Agreeing(np.zeros(T, bool), own)


def agreeing_with_runs(rows: Squares, length: int, rough: bool) -> Agreeing:
    """The same with runs of so many steps."""
    patch, C = rows[:2]
    (T, R, Q), best = C.shape, np.zeros(len(C), bool)
    sharp, share = (ROUGH, ROUGH_SHARE) if rough else (SHARP, SHARE)

    def beside(away: Array, others: Array) -> Flags:
        sharply = np.median(others) <= sharp
        return (away <= sharp if rough else is_sharp(away, others)) & sharply

    runs = [slice(first, first + length) for first in range(T - length + 1)]
    found = patch.away(np.array([rows.solved(run) for run in runs]).reshape(len(runs), Q).T)
    own = any(away[run].max() <= EXACT and shows_more(C[run]) for away, run in zip(found.T, runs, strict=True))
    for away, run in zip(found.T, runs, strict=True):
        best = max(best, beside(away, away[run]), key=np.sum)
    for _ in range(ROUNDS if best.any() else 0):
        away = patch.away(rows.solved(best)[:, None])[:, 0]
        before, best = best, beside(away, away[best])
        if not best.any() or np.array_equal(best, before):
            break
    sure = best.any() and away[best].max() <= EXACT and shows_more(C[best])
    suffices = best.sum() * R >= ROWS_EACH * Q and (sure or best.mean() >= share)
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
