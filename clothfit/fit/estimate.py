"""Find the flagged parameters whose motion matches a target: the outer loop around the exact gradient.

The default is L-BFGS-B on scaled coordinates (`search`); SciPy's other minimisers go by their names. Whatever ends
the loop, its budget, an interrupt, a stalled line search, the best point it visited is the result.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import checked_tolerance
from clothfit.base.memory import budget as budgeted
from clothfit.base.messages import meant, owned
from clothfit.fit import auto
from clothfit.fit import holdout as holdouts
from clothfit.fit.confidence import Confidence, confidence
from clothfit.fit.result import Fit, result
from clothfit.fit.start import fabric, neutral, neutral_start
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate, simulate_cloths
from clothfit.objective.experiment import Targets, experiments
from clothfit.objective.memory_needs import Needs
from clothfit.objective.objective import Objective
from clothfit.optimise import momentum
from clothfit.optimise.checkpoint import Checkpoint, identity
from clothfit.optimise.journal import opened
from clothfit.optimise.scipy_methods import METHODS, minimise
from clothfit.optimise.search import Progress, Search
from clothfit.optimise.status import Status, Stop
from clothfit.scene.fit_vector import blocks, bounds, feels_air, fitted_cloths, identifiable, parameters
from clothfit.scene.kinds import LETTERED
from clothfit.scene.scene import Scene

OWN = ("auto", "momentum", "gauss-newton")
"""The methods of this package, besides SciPy's `METHODS`."""

RMSE_TOLERANCE = 1e-8  # m: far below what a file in float32 can hold
FIT_TOLERANCE = 1e-10  # linear systems, relative
BUDGET = 1000  # evaluations


def record_target(scene: Scene, frames: int | None = None, tolerance: float | None = None) -> Motion:
    """The motion of the scene's own parameters, solved as tightly as a fit does. Raises Diverged."""
    return simulate(scene, frames, checked_tolerance(tolerance, FIT_TOLERANCE))


def estimate(
    scene: Scene,
    target: Targets | None = None,
    start: float | Array | Scene | None = None,
    method: str = "auto",
    *,
    budget: int = BUDGET,
    rmse_tolerance: float = RMSE_TOLERANCE,
    tolerance: float | None = None,
    report: Callable[[Progress], None] | None = None,
    objective: str | Mapping[str, float] = "position",
    loss: str = "linear",
    loss_scale: float | None = None,
    prior: float | str = "auto",
    checkpoint: str | os.PathLike[str] | Checkpoint | None = None,
    resume: bool = False,
    holdout: float | None = None,
    holdout_of: str = "frames",
    intervals: bool = True,
    memory: int | str | None = None,
    foreseen: Callable[[Needs], None] | None = None,
) -> Fit:
    """Fit the flagged values of a scene to one target motion or to several.

    `target`, `objective`, `loss`, `loss_scale` and `memory` are those of `Objective`. The fit compares the scene's
    `frames` of each target; of a target with its own scene, as many as that scene says. Without a target the fit is a
    trial: the target is simulated with the scene's own values, and the fit starts from values that do not depend on
    them.

    With a target the fit starts from the scene's values. `start` replaces them: a number for all masses and
    stiffnesses (for all values, where neither are fitted), an array (P,), or a scene whose values to take. `method` is
    "auto", "momentum", "gauss-newton", or the name of a minimiser of SciPy. The fit ends after `budget` evaluations of
    cost and gradient, or below `rmse_tolerance`, m (with other objectives in the unit of what they compare).
    `tolerance` is that of the linear systems, relative. `report` is called after each evaluation.

    `prior` is for the methods "auto" and "gauss-newton": the values of one kind scatter around those of a fabric, as
    widely as the data say ("auto"), or around the start with this standard deviation of the logarithm; "none" assumes
    nothing. `holdout` keeps this fraction of the frames, the last ones, or of the vertices (`holdout_of` "vertices")
    out of the fit, to judge it by. `intervals` False leaves out the 95 % intervals, which take about as long as a step
    of Gauss–Newton.

    With a file as `checkpoint` a fit that was killed goes on from there when `resume` is true; `budget`,
    `rmse_tolerance` and `report` may differ then. KeyboardInterrupt ends the fit with status "interrupted" and the best
    result so far; before the first evaluation it passes through. `foreseen` is called with the memory that the fit will
    need, before it begins. Where matrices do not fit into `memory`, another method takes over, with a warning.

    Raises InvalidInput when nothing is flagged, or an argument, the target or the checkpoint does not fit; Diverged
    when the scene's own motion, needed as the target, diverges.
    """
    check_method(method)
    holdouts.check(holdout, holdout_of)
    tau = prior_width(prior)
    if not blocks(scene):
        raise InvalidInput(
            f"{scene.name}: nothing to fit: no object flags anything; set its optimizationSettings, for example to "
            "'nL', or its fit"
        )
    if budget < 1:
        raise InvalidInput(f"budget: {budget} evaluations are too few, at least 1 is needed")
    tight = checked_tolerance(tolerance, FIT_TOLERANCE)
    hidden = target is None
    if target is None:
        target = simulate_cloths(scene, fitted_cloths(scene), tolerance=tight)
    asked: dict[str, Any] = {"objective": objective, "loss": loss, "loss_scale": loss_scale}
    options = {**asked, "memory": budgeted(memory)}
    given, kept_out = experiments(scene, target), None
    ends = [e.scene.frames for e in given]
    if holdout is not None:
        given, rest = holdouts.split(scene, given, holdout, holdout_of)
        target, kept_out = given, Objective(scene, rest, tight, ends, memory=options["memory"])
    aim = Objective(scene, target, tight, ends, **options)
    if not aim.shows_motion:
        raise InvalidInput(
            f"{given[0].motion.name}: shows nothing after the start that can move, within {given[0].scene.frames} "
            "frames, so there is nothing to fit to"
        )
    needs = aim.needs
    if foreseen:
        foreseen(needs)
    tells = {"method": method, "prior": prior, "tolerance": tight, "holdout": holdout, "of": holdout_of, **asked}
    journal = opened(checkpoint, resume, identity(scene, None if hidden else given, start, **tells))
    with journal.trusted():
        direct = method in ("auto", "momentum") and hidden and start is None  # these look for a start of their own
        if direct:
            p = np.where(aim.identifiable, fabric(scene), parameters(scene))
        else:
            p = journal.recall("start", partial(choose_start, scene, target, start, hidden, **options))
        warnings = [*undetermined(scene), *outside_bounds(scene, p)]
        if not direct and not np.isfinite(aim.cost_or_infinity(p)):
            instead = "the fit starts from the best of a coarse search instead"
            warnings.append(f"the simulation diverges at the start; {instead}")
            coarse = partial(neutral_start, scene, target, scene.frames, [p], **options)
            p = journal.recall("second start", lambda: coarse()[0])
        search = Search(aim, p, rmse_tolerance, budget, report, journal)
        first = search.best  # within the bounds
        patterns = None if hidden else [p, *(np.where(lettered(scene), q, p) for q in (fabric(scene), neutral(scene)))]
        others = partial(neutral_start, scene, target, scene.frames, patterns, **options)
        status = run(search, method, p, None if start is not None else others, tau)
        seconds, warnings = search.seconds, [*warnings, *search.notes, *journal.warnings]
        known = look(search, status, first, warnings) if intervals else None
        found = result(search, status, method, warnings, start is not None, first, known, seconds)
    found = replace(found, memory=needs)
    if status not in (Status.DIVERGED, Status.INTERRUPTED):  # who has asked for the end waits for no more steps
        remedies = aim.remedies(parameters(found.scene))
        told = [f"the fitted motion: {text}" for text in remedies.sentences(sum(run.steps for run in aim.runs))]
        found = replace(found, remedies=remedies, warnings=[*found.warnings, *told])
    if kept_out is None or holdout is None or status == Status.DIVERGED:
        return found
    return replace(found, holdout=holdouts.judged(kept_out, parameters(found.scene), holdout_of, holdout))


def run(
    search: Search, method: str, start: Array, others: Callable[[], list[Array]] | None, tau: float | None
) -> Status:
    """Search by a method until it or the user ends it; returns the status."""
    try:
        with threads.single(), interrupts.heard():
            status = found_by(search, method, start, others, tau)
    except Stop as stop:
        status = stop.status
    except KeyboardInterrupt:
        search.take_known()
        if not np.isfinite(search.best_cost):
            raise  # there is no result yet
        status = Status.INTERRUPTED
    finally:
        search.journal.write()
    search.take_known()
    return status if np.isfinite(search.best_cost) else Status.DIVERGED


def look(search: Search, status: Status, start: Array, warnings: list[str]) -> Confidence | None:
    """What the data say of the result of a search that began at `start` (P,); a warning where that is left out."""
    if status == Status.DIVERGED or not search.fitted.any():
        return None
    if status == Status.INTERRUPTED:
        warnings.append("no intervals, as the fit was interrupted")
        return None
    try:
        with threads.single(), interrupts.heard():
            known = confidence(search, start)
    except KeyboardInterrupt:
        warnings.append("no intervals, as looking for them was interrupted")
        return None
    if known is None:
        warnings.append("no intervals: for so many parameters they would take minutes or more, or too much memory")
    return known


def lettered(scene: Scene) -> Flags:
    """Which parameters (P,) are masses or stiffnesses."""
    found = blocks(scene)
    return np.repeat(np.array([block.name in LETTERED for block in found], bool), [block.count for block in found])


def found_by(
    search: Search, method: str, start: Array, others: Callable[[], list[Array]] | None, tau: float | None
) -> Status:
    """Search by a method; returns the status. Raises Stop."""
    if not search.fitted.any():
        search(search.y)
        return search.verdict()
    if method in METHODS:
        return minimise(search, method)
    if method == "momentum":
        if not momentum.fits(search.objective):
            raise InvalidInput("memory: too little for the balance of momentum; use another method, or allow more")
        auto.by_momentum(search, start)
        return search.verdict()
    if method == "gauss-newton":
        return auto.by_gauss_newton(search, start, start, tau)
    return auto.find(search, start, others, tau)


def undetermined(scene: Scene) -> list[str]:
    """Warnings of cloths whose fitted masses and stiffnesses the motion shows only up to a common factor.

    Weight, inertia, node damping and springs all scale with them, and so does air drag where it is fitted, too; only
    air drag that is known, and spheres, do not.
    """
    if scene.spheres:
        return []
    found = []
    for i, cloth in enumerate(scene.cloths):
        if "n" not in cloth.settings and not feels_air(cloth):
            what = "feels neither air nor spheres, so its motion shows masses and stiffnesses"
            found.append(f"objects[{i}] {what} only up to one common factor")
        elif "n" not in cloth.settings and cloth.mode("drag") != "n":
            what = "feels no spheres, so its motion shows masses, stiffnesses and drag"
            found.append(f"objects[{i}] {what} only up to one common factor")
    return found


def outside_bounds(scene: Scene, p: Array) -> list[str]:
    """Warnings of starting values (P,) that the bounds will move."""
    lower, upper = bounds(scene)
    outside = identifiable(scene) & ((p < lower) | (p > upper))
    counts = [(block, int(outside[block.part].sum())) for block in blocks(scene)]
    return [
        f"{owned(block.cloth, block.name)}: {count} of {block.count} starting values lie outside the bounds "
        f"{block.kind.lower:g} … {block.kind.upper:g} and start at the bound; the truth may lie outside as well"
        for block, count in counts
        if count
    ]


def prior_width(prior: float | str) -> float | None:
    """The width τ of a prior: "auto" learns it (None), "none" or 0 leaves it out (inf). Raises InvalidInput."""
    if prior == "auto":
        return None
    if prior in ("none", 0):
        return np.inf
    try:
        width = float(prior)
    except ValueError:
        width = np.nan
    if not width > 0:
        raise InvalidInput(f"prior must be auto, none or a width in log parameters above 0; {prior!r} was given")
    return width


def check_method(method: str) -> None:
    """Raise InvalidInput when there is no such method."""
    if method not in OWN and method not in METHODS:
        known = (*OWN, *METHODS)
        raise InvalidInput(f"method: there is no {method!r}; use {', '.join(known)}{meant(method, known)}")


def choose_start(
    scene: Scene, goal: Targets, start: float | Array | Scene | None, hidden: bool, **options: Any
) -> Array:
    """Starting values (P,) of all parameters; `options` are those of Objective. Raises InvalidInput when they are not
    numbers within the bounds.
    """
    if start is None and hidden:
        own = parameters(scene)
        return np.where(identifiable(scene), neutral_start(scene, goal, scene.frames, **options)[0], own)
    if start is None:
        return parameters(scene)
    if isinstance(start, Scene):
        return parameters(start, flags=scene)
    count = len(parameters(scene))
    try:
        values = np.asarray(start, float)
    except (TypeError, ValueError):
        raise InvalidInput(f"start: {start!r} is not a number, an array of numbers or a scene") from None
    if values.ndim > 1 or values.size not in (1, count):
        raise InvalidInput(f"start: {values.size} values given, {scene.name} has {count} parameters")
    lower, upper = bounds(scene)
    p, given = np.broadcast_to(values.reshape(-1), (count,)).copy(), np.ones(count, bool)
    if values.ndim == 0 and any(block.name in LETTERED for block in blocks(scene)):
        given = lettered(scene)
        p = np.where(given, p, neutral(scene) if hidden else parameters(scene))
    wrong = given & ~((p >= lower) & (p <= upper))  # True for NaN
    if wrong.any():
        i = int(np.argmax(wrong))
        raise InvalidInput(f"start: {p[i]:g} is not within the bounds {lower[i]:g} … {upper[i]:g}")
    return p
