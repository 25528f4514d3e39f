"""The result of a fit: the fitted scene, how the fit ended, and how far its values can be trusted.

The verdict on the model: does the fitted motion explain the target but for noise, and if not, how much is left?

What is left counts as noise where `whiteness` finds no structure and no bias in it. Of what has structure, the share s
of the squares is no noise; the fraction of the motion that is not explained is then sqrt(s) RMSE / travel, with the
travel the RMS distance of the target's positions from the start.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.base.messages import counted, metres, owned
from clothfit.base.notebook import html_of
from clothfit.engine.fallbacks import NO_FALLBACKS, Fallbacks
from clothfit.fit.alternatives import Alternatives, alternatives, in_words
from clothfit.fit.confidence import Confidence, Samples, confidence, is_exact, residual_variance
from clothfit.fit.hints import Hint
from clothfit.fit.holdout import HeldOut, Judged
from clothfit.fit.inextensible import by_strains, hardly_stretching, levels
from clothfit.fit.step_choice import Step
from clothfit.motion.correspondence import Correspondence
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion
from clothfit.objective.identifiability import Correlation
from clothfit.objective.memory_needs import Needs
from clothfit.objective.objective import Objective
from clothfit.objective.whiteness import ResidualTest, residual_test
from clothfit.optimise.along_target import SingleSteps
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status
from clothfit.registration.record import Markers, Registration
from clothfit.scene.block import Block
from clothfit.scene.bounds import wider
from clothfit.scene.factors import geometric_mean
from clothfit.scene.fit_vector import at_lower, at_upper, bounds, parameters, with_parameters
from clothfit.scene.scene import Scene

ADEQUATE, DIFFERS, FAILS = "adequate", "differs", "fails"

NEGLIGIBLE = 1e-4
"""Unexplained fraction of the motion that nobody sees: 0.1 mm in a metre."""

ERROR_SECONDS = 0.5
"""Seconds for the error of positions where the fit was asked to end."""

WIDE = float(np.exp(2.0))
"""Ratio of the ends of an interval of a stiffness from which on it has no upper end."""

HARDLY = 2.0
"""Half the width of an interval, as a factor, beyond which its value means little."""

UNMOVED = 1e-9
"""Relative change up to which a parameter counts as not having moved: beyond the rounding of exp and log."""


@dataclass(frozen=True)
class FittedBlock:
    """The fitted values of one kind of one object; the lists hold indices within the block."""

    object: int | None  # None: of the scene as a whole
    name: str  # of the kind: "mass", "stiffness", "damping", … (`scene.kinds`)
    mode: str  # "F", "R", "M", "G" or "L"
    count: int  # of values
    at_bound: list[int]  # values at a bound of the fit
    unidentifiable: list[int]  # values that the motion does not determine; those that it does not show keep their start
    unmoved: list[int]  # of the others, those that ended where they started
    interval: list[tuple[float, float] | None]  # of 95 %, one per value, in its unit; None where there is none
    at_least: bool = False  # whether there are stiffnesses of which the motion shows only how large they are at least
    least: list[float | None] = field(default_factory=list)  # that, N/m, of each value; of others None
    groups: list[str] | None = None  # in modes F, R and M: the names of the groups
    modes: list[int] | None = None  # in mode M: the values of each group, one for each mode of its map
    values: list[float] | None = None  # in modes F, R and M: the factors, on the values of the scene that was given
    bounds: list[float] = field(default_factory=list)  # that the values of `at_bound` are at, as `values` are meant
    start: float | list[float] | None = None  # where the fit began, as `values` are meant; one number where all agree
    hardly_shown: list[int] = field(default_factory=list)  # values that the motion shows to a factor of 2 or worse


@dataclass(frozen=True)
class Scatter:
    """The spread that the prior found for one kind of value of one object."""

    object: int | None  # None: of the scene as a whole
    name: str  # of the kind
    tau: float  # standard deviation, of logarithms for masses, stiffnesses and rest lengths


@dataclass(frozen=True)
class Verdict:
    """Whether the model can reproduce the target."""

    model: str  # "adequate": what is left is noise, rounding or nothing; "differs": it is not; "fails": nor is it
    # nearer than the best still picture
    unexplained: float  # fraction of the motion, without noise

    @property
    def differs(self) -> bool:
        """Whether the model cannot reproduce the target."""
        return self.model != ADEQUATE

    @property
    def fails(self) -> bool:
        """Whether the fit leaves more of the motion than it explains."""
        return self.model == FAILS


@dataclass(frozen=True)
class Baselines:
    """What a fit must beat: root mean square distances from the target, m."""

    still: float  # of the target's mean frame
    start: float | None = None  # of the scene as it came; None: its motion diverges, or there was no time

@dataclass(frozen=True, eq=False)
class Fit:
    """The result of a fit."""

    scene: Scene  # with the best values found
    status: Status  # how it ended: "converged", "stalled", "limit", "diverged" or "interrupted"
    method: str  # that was asked for
    cost: float  # G, m² with the default objective; inf when nothing could be evaluated
    rmse: float  # root mean square distance of the positions, m, for any objective
    frames: int  # compared, of all targets together
    evaluations: int  # of cost and gradient
    seconds: float  # of tracking and search, without simulating the target, the search for a start and the intervals
    parameters: list[FittedBlock]  # the fitted values, block by block
    warnings: list[str]  # what the user should know, one sentence each
    rank: int | None = None  # independent combinations of the values that the motion shows; None: no intervals
    sigma: float | None = None  # standard deviation of a residual, m where positions are compared
    prior: list[Scatter] | None = None  # None: the result has no prior
    holdout: HeldOut | None = None  # None: nothing was kept out of the fit
    memory: Needs | None = None  # that was predicted, bytes
    travel: float | None = None  # root mean square distance of the compared positions from the start, m
    hints: list[Hint] = field(default_factory=list)  # what the target shows of its difference from the scene
    verdict: Verdict | None = None  # on the model; None: it was not looked at
    baselines: Baselines | None = None  # what it must beat; None: positions are not compared, or nothing was evaluated
    ladder: list[Judged] = field(default_factory=list)  # the models that were fitted from coarse to fine
    steps: list[Step] = field(default_factory=list)  # time steps that were tried
    substeps: int | None = None  # steps to a frame of the target, chosen or asked for; None: the step is the scene's
    windows: int | None = None  # frames of each window that the target was cut into; None: whole motions were compared
    whole: float | None = None  # m, the error over whole motions, where windows were compared
    registration: list[Registration] | None = None  # of each target; None: none was looked for
    followed: int = 0  # held vertices that follow the targets
    correspondence: Correspondence | None = None  # of the points of the first target; None: there is none
    tracks: list[Motion] | None = None  # the targets, where a scan is among them, as they were tracked
    markers: list[Markers] | None = None  # of each target, those that were mistaken; None: none was
    start: Scene | None = None  # where the fit began
    single_steps: SingleSteps | None = None  # how near it takes each step of the target, where it does so to rounding
    stage: str = ""  # of the search, the last one: a method, or what prepares it
    objective: dict[str, float] = field(default_factory=dict)  # what is compared, with the weights
    correlations: tuple[Correlation, ...] = ()  # of what is hard to tell apart, strongest first
    samples: Samples | None = None  # that the intervals are by; None: they are by the matrix, or there are none
    remedies: Fallbacks = NO_FALLBACKS  # its motion's steps that were solved directly, clamped, shortened or taken anew

    def __repr__(self) -> str:
        values = sum(block.count for block in self.parameters)
        error = f"RMSE {metres(self.rmse)}" if np.isfinite(self.rmse) else f"cost {self.cost:.3g}"
        sizes = f"{counted(self.frames, 'frame', 'frames')}, {counted(values, 'value', 'values')}"
        used = f"{counted(self.evaluations, 'evaluation', 'evaluations')} in {self.seconds:.3g} s"
        return f"<Fit of {self.scene.name}: {self.status}, {error} over {sizes}, {used}>"

    def _repr_html_(self) -> str:
        return html_of(self)

    @property
    def relative_rmse(self) -> float | None:
        """The error as a fraction of the distance travelled; None where nothing moves or the motion diverges."""
        return self.rmse / self.travel if self.travel and np.isfinite(self.rmse) else None


class Judgement(NamedTuple):
    """What is said of a result: nothing of its values without a verdict on its model."""

    verdict: Verdict | None
    known: Confidence | None
    hints: tuple[Hint, ...] = ()  # on what speaks against the model


UNKNOWN = Judgement(None, None)


def result(
    search: Search, given: Scene, status: Status, method: str, warnings: list[str], started: bool, judged: Judgement,
    seconds: float,
) -> Fit:  # fmt: skip
    """The result for the user of a search, whose scene was `given`; the user gave its start where `started`."""
    known = judged.known
    scene = search.objective.scene
    p, cost = (search.best.p, search.best.cost) if known is None else (known.p, known.cost)
    return Fit(
        scene=fitted_scene(search, p, started),
        status=status,
        method=method,
        cost=cost,
        rmse=position_rmse(search, p, cost),
        frames=search.objective.frames,
        evaluations=search.budget.evaluations,
        seconds=seconds,
        parameters=[fitted_block(search, given, block, p, known) for block in scene.blocks],
        warnings=warnings,
        rank=None if known is None else known.rank,
        sigma=None if known is None else known.sigma,
        prior=scatter(search),
        memory=search.objective.needs,
        hints=[*bound_hints(search, p), *judged.hints],
        verdict=judged.verdict,
        objective=dict(search.objective.weights),
        start=with_parameters(search.objective.scene, search.origin),
        stage=search.progress.stage,
        single_steps=search.proven,
        correlations=() if known is None else known.correlations,
        samples=None if known is None else known.samples,
    )


def with_lower_bounds(fit: Fit, objective: Objective) -> Fit:
    """The fit with lower bounds, by the strains, of stiffnesses of edges that hardly stretch where the model differs or
    nothing else is known of them: they have no interval, or one that 1/k = 0 is as near to as their best value.
    """
    blocks, p = list(fit.parameters), parameters(fit.scene, objective.scene)
    if fit.verdict is None or fit.verdict.fails or not any(block.name == "stiffness" for block in blocks):
        return fit
    stiff = hardly_stretching(objective)
    for i, (block, own) in enumerate(zip(objective.blocks, blocks, strict=True)):
        lost = {*own.unidentifiable, *(j for j, ends in enumerate(own.interval) if ends and ends[1] < WIDE * ends[0])}
        open_ = stiff[block.part] & ~np.isin(np.arange(block.count), list(lost))
        if open_.any() and not own.at_least:
            low = p[block.part] * by_strains(objective, block, p)
            blocks[i] = at_least(own, block, np.where(open_, low, np.nan))
    return replace(fit, parameters=blocks)


def at_least(found: FittedBlock, block: Block, low: Array) -> FittedBlock:
    """A block with lower bounds (count,) of its values, as they are meant; NaN where there is none."""
    if np.isnan(low).all():
        return found
    sizes = 1.0 if block.factors is None else sizes_of(block, block.factors.base)
    least = [None if np.isnan(each) else float(each) for each in low * sizes]
    return replace(found, at_least=True, least=least)


def sizes_of(block: Block, values: Array) -> Array:
    """The geometric mean (count,) of those of some values (E,) that have their level by a parameter of a block."""
    of = levels(block)
    return np.array([geometric_mean(values[of == j]) for j in range(block.count)])


def fitted_scene(search: Search, p: Array, started: bool) -> Scene:
    """The scene with the values p (P,) of a search; the user gave its start where `started`."""
    scene, kept = search.objective.scene, search.objective.identifiable
    lost = [block for block in scene.blocks if block.mode == "G" and not kept[block.part].all()]
    return with_parameters(scene, p, [] if started else lost)  # the scene's values, which may differ, not their mean


def with_fallbacks(fit: Fit, objective: Objective) -> Fit:
    """The fit with the fallbacks that the steps of its motion needed, and their warnings."""
    fallbacks = objective.remedies(parameters(fit.scene, objective.scene))
    texts = fallbacks.sentences(sum(run.steps for run in objective.runs))
    warnings = [*fit.warnings, *(f"the fitted motion: {text}" for text in texts)]
    return replace(fit, remedies=fallbacks, warnings=warnings)


def verdict(objective: Objective, p: Array, relative: float) -> Verdict | None:
    """The verdict on the motion of p (P,), whose error relative to the distance travelled is `relative`; None where
    only spectra are compared. Raises Diverged.
    """
    if relative <= NEGLIGIBLE:
        return Verdict(ADEQUATE, relative)
    test = residual_test(objective, p)
    return None if test is None else judged(test, relative)


def judged(test: ResidualTest, relative: float) -> Verdict:
    """The verdict on residuals whose size, relative to the motion, is `relative`."""
    unexplained = float(np.sqrt(test.unexplained)) * relative
    adequate = test.is_unbiased or unexplained <= NEGLIGIBLE
    return Verdict(ADEQUATE if adequate else DIFFERS, unexplained)


def judgement(search: Search, trial: bool) -> Judgement:
    """What is said of the best point of a search, as in `with_verdict`. Nothing where nothing moves, or only spectra
    are compared.
    """
    objective, p, cost = search.objective, search.best.p, search.best.cost
    rmse, travel = position_rmse(search, p, cost), objective.rms_displacement
    if not (travel > 0 and np.isfinite(rmse)):
        return UNKNOWN
    exact = bool(search.proven) or is_exact(search, cost)
    shown = search.proven.rmse if search.proven else rmse
    left = Verdict(ADEQUATE, shown / travel) if exact else verdict(objective, p, rmse / travel)
    if left is None:
        return UNKNOWN
    suffices = reproduced(objective, cost, search.rmse_tolerance, trial)
    others, hints = None, list[Hint]()
    if not (left.differs or trial or search.objective.own):
        others = alternatives(search)
        left, hints = with_alternatives(search, left, None if suffices or exact else others)
    known = confidence(search, left.differs, others)
    return Judgement(Verdict(ADEQUATE, rmse / travel) if suffices else left, known, tuple(hints))


def with_alternatives(search: Search, left: Verdict, others: Alternatives | None) -> tuple[Verdict, list[Hint]]:
    """A verdict by residuals as noise, and what other values of what is not fitted say against it."""
    objective, found = search.objective, [] if others is None else others.improbable(residual_variance(search))
    if not found:
        return left, []
    hint = Hint("hidden", in_words(found, objective.scene), before_fit=False)
    apart = float(np.sqrt(found[0].squares / max(objective.observations, 1)))
    unexplained = max(apart / objective.rms_displacement, left.unexplained)
    return Verdict(ADEQUATE if unexplained <= NEGLIGIBLE else DIFFERS, unexplained), [hint]


def reproduced(objective: Objective, cost: float, tolerance: float, trial: bool) -> bool:
    """Whether a cost is good enough, or the target is the scene's own motion and a model as free as that of the fit has
    the scene's own values.
    """
    own = partial(objective.cost_or_infinity, parameters(objective.scene))
    return objective.rmse(cost) <= tolerance or (trial and objective.rmse(own()) <= tolerance)


def position_rmse(search: Search, p: Array, cost: float) -> float:
    """Root mean square distance, m, of the observed positions at p (P,) of that cost, or of what else is compared where
    none is observed; inf where they diverge, NaN where a request or the time leaves no moment to look.
    """
    unseen = not (search.objective.own or search.objective.observations)
    if search.objective.plain or unseen or not np.isfinite(cost):
        return search.objective.rmse(cost)
    limit = ERROR_SECONDS if interrupts.requested() else None
    try:
        with interrupts.heard(), interrupts.grace(ERROR_SECONDS), interrupts.limited(limit):
            return search.objective.position_rmse(p)
    except Diverged:  # the cost saw only what is finite
        return np.inf
    except (interrupts.OutOfTime, KeyboardInterrupt):
        return np.nan


def with_verdict(fit: Fit, objective: Objective, tolerance: float, trial: bool) -> Fit:
    """The fit with the verdict on its model where it has none yet, without one where nothing moves. `tolerance`, m, is
    the error that is good enough; `trial`: the target is the scene's own motion.
    """
    if fit.verdict is not None or fit.relative_rmse is None:
        return fit
    if fit.single_steps and fit.travel:
        return replace(fit, verdict=Verdict(ADEQUATE, fit.single_steps.rmse / fit.travel))
    if reproduced(objective, fit.cost, tolerance, trial):
        return replace(fit, verdict=Verdict(ADEQUATE, fit.relative_rmse))
    try:
        p = parameters(fit.scene, objective.scene)
        return replace(fit, verdict=verdict(objective, p, fit.relative_rmse))
    except Diverged:
        return fit


def without_intervals(fit: Fit) -> Fit:
    """The fit without what its values' intervals say."""
    blocks = [
        replace(block, interval=[None] * block.count, at_least=False, least=[], hardly_shown=[])
        for block in fit.parameters
    ]
    return replace(fit, parameters=blocks, rank=None, sigma=None, correlations=(), samples=None)


def fitted_block(search: Search, given: Scene, block: Block, p: Array, known: Confidence | None) -> FittedBlock:
    """The result of a block that ended at p (P,). Its factors, which may multiply values that a scan was tracked by,
    become those on the scene that was `given`.
    """
    part, size = block.part, np.ones(block.count)
    if block.factors is not None and block.cloth is not None:
        own = np.ravel(getattr(given.cloths[block.cloth], block.name))
        size = sizes_of(block, block.factors.base) / sizes_of(block, own)
    lower, upper = (end[part] for end in bounds(search.objective.scene))
    lost = ~search.fitted[part]
    interval: list[tuple[float, float] | None] = [None] * block.count
    hardly = list[int]()
    if known is not None:
        lost |= known.undetermined[part]
        low, high = known.low[part], known.high[part]
        hardly = np.flatnonzero(block.kind.log & (high > HARDLY**2 * low)).tolist()
        ends = zip((low * size).tolist(), (high * size).tolist(), strict=True)
        interval = [None if np.isnan(low) else (low, high) for low, high in ends]
    bound = (at_lower(p[part], lower) | at_upper(p[part], upper)) & ~lost
    start = search.origin
    still = np.abs(p - start) <= UNMOVED * np.maximum(np.abs(start), search.coordinates.change(start))
    reached = (np.where(at_lower(p[part], lower), lower, upper) * size)[bound]
    at_bound, undetermined, unmoved = (np.flatnonzero(each).tolist() for each in (bound, lost, still[part] & ~lost))
    began = (start[part] * size).tolist()
    found = FittedBlock(
        block.cloth, block.name, block.mode, block.count, at_bound, undetermined, unmoved, interval,
        bounds=reached.tolist(), start=began[0] if len(set(began)) == 1 else began, hardly_shown=hardly,
    )  # fmt: skip
    if known is not None and known.least is not None:
        found = at_least(found, block, known.least[part])
    if block.factors is None:
        return found
    modes = list(block.factors.modes) if block.mode == "M" else None
    return replace(found, groups=list(block.factors.names), modes=modes, values=(p[part] * size).tolist())


def bound_hints(search: Search, p: Array) -> list[Hint]:
    """What widens the bounds at which values of p (P,) lie."""
    found = []
    lower, upper = bounds(search.objective.scene)
    for block in search.objective.blocks:
        own = block.part
        ends = [(at & search.fitted)[own] for at in (at_lower(p, lower), at_upper(p, upper))]
        if any(end.any() for end in ends):
            found.append(Hint("bounds", beyond(block, bool(ends[0].any()), bool(ends[1].any())), before_fit=False))
    return found


def beyond(block: Block, down: bool, up: bool) -> str:
    """A sentence on a block with values at its lower or upper bound, with the option that widens them."""
    kind, (low, high) = block.kind, wider(block.kind, *block.value_ends)
    left = [f"{low:g}" if down and low is not None else "", f"{high:g}" if up else ""]
    which = " and ".join([*["lower"] * down, *["upper"] * up])
    text = f"{owned(block.cloth, kind.title)}: values lie at the {which} bound of the fit"
    if not any(left):
        return f"{text}, {block.value_ends[0]:g}{kind.suffix}, and cannot be less"
    return f"{text}; --bounds {kind.name}={':'.join(left)} widens it"


def scatter(search: Search) -> list[Scatter] | None:
    """The widths of the prior of a search, one for each of its blocks; None where there is no prior."""
    if search.best.prior is None or not search.best.prior.groups or search.best.prior.guards:
        return None
    places = np.flatnonzero(search.fitted)
    found = []
    for group, tau in zip(search.best.prior.groups, search.best.prior.scatter, strict=True):
        if not np.isfinite(tau):
            return None
        (block,) = (b for b in search.objective.blocks if b.part.start <= places[group[0]] < b.part.stop)
        found.append(Scatter(block.cloth, block.name, float(tau)))
    return found
