"""Find the flagged parameters whose motion matches a target: the outer loop around the exact gradient.

The default method is `auto`; SciPy's minimisers go by their names. Whatever ends the search, its budget, an interrupt
or a stalled line search, the best point that it visited is the result.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import FIT_TOLERANCE, checked_tolerance
from clothfit.base.memory import budget as memory_budget
from clothfit.base.memory import check_memory
from clothfit.base.messages import metres
from clothfit.engine.system import build
from clothfit.fit import step_choice
from clothfit.fit.flags import reflagged
from clothfit.fit.hints import Hint, hints_before_fit, other_step
from clothfit.fit.holdout import HeldOut, error_of, judged, nearer, split
from clothfit.fit.observer import Observer, bar
from clothfit.fit.options import AUTO, FitOptions, Request, requested, resolved
from clothfit.fit.preparation import flagged, followed, in_time, in_windows, with_start_velocity, with_whole
from clothfit.fit.registered_fit import SAME_FALL, Refinement, begun, put_right
from clothfit.fit.residual_hints import (
    picture_error,
    with_floor,
    with_own_motion,
    with_picture,
    with_residual_hints,
    with_stall_hint,
    with_start,
)
from clothfit.fit.result import (
    UNKNOWN,
    Fit,
    Judgement,
    fitted_scene,
    judgement,
    result,
    with_fallbacks,
    with_lower_bounds,
    with_verdict,
    without_intervals,
)
from clothfit.fit.routes import Fitting, by_routes, in_words
from clothfit.fit.tracked_fit import leaves_more, left_behind, with_figures, with_scans
from clothfit.motion.correspondence import Correspondence
from clothfit.motion.degrade import rounding
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate, simulate_cloths
from clothfit.objective.experiment import Experiment, Targets, experiments
from clothfit.objective.memory_needs import check_own
from clothfit.objective.objective import Objective
from clothfit.optimise.checkpoint import identity, opened
from clothfit.optimise.progress import Progress
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status
from clothfit.registration.record import Registration
from clothfit.registration.tracking import placed
from clothfit.scene.bounds import from_user
from clothfit.scene.fit_vector import fitted_cloths, parameters
from clothfit.scene.kinds import REST
from clothfit.scene.scene import Scene, check_is_scene, load

GRACE = 0.5
"""Seconds for each look at a result whose time is up."""

ROUNDS, ALIKE_ERROR = 2, 1.002
"""How often a fit is done again with another registration, and its error relative to the one before up to which it is
kept: the values that both leave open differ by more.
"""


def record_target(scene: Scene, frames: int | None = None, tolerance: float | None = None) -> Motion:
    """The motion of the scene's own parameters, solved as tightly as a fit does. Raises Diverged."""
    return simulate(scene, frames, checked_tolerance(tolerance, FIT_TOLERANCE))


def estimate(
    scene: Scene,
    target: Targets | None = None,
    start: float | Array | Scene | str | os.PathLike[str] | None = None,
    method: str = "auto",
    *,
    model: str | None = None,
    time_limit: str | float | None = None,
    options: FitOptions = FitOptions(),  # noqa: B008 (it is frozen)
    observer: Observer | None = None,
) -> Fit:
    """Fit the flagged values of a scene to one target motion or to several.

    `target` is that of `Objective`. The fit compares the scene's `frames` of each target; of a target with its own
    scene, as many as that scene says. It starts from the scene's values. Without a target the fit is a trial: the
    target is simulated with the scene's own values, and the fit starts from values that do not depend on them.

    `start` replaces the values to start from: a number for all masses and stiffnesses (for all values, where neither
    are fitted), an array (P,), or a scene, or the path of one, whose values to take. `method` is "auto", "momentum",
    "gauss-newton", or the name of a minimiser of SciPy. `model` takes the place of the modes of all masses, stiffnesses
    and rest lengths that are flagged: "F", "R", "M", "G", "L", or "auto", the smallest of F, R, M and L that no finer
    one beats on what is kept out of the fit.

    After `time_limit`, a text such as "30s", "2m" or "1h", or a number of seconds, the fit ends with status "limit" and
    the best result so far; the intervals take the time that the search leaves. KeyboardInterrupt ends it with status
    "interrupted" and the best result so far; before the first evaluation it passes through. Whatever ends a fit, its
    result costs no more than its start.

    `options` has all else; `observer` is called while the fit runs.

    Raises InvalidInput when nothing is flagged, or an argument, the target or the checkpoint does not fit; Diverged
    when the scene's own motion, needed as the target, diverges.
    """
    check_is_scene(scene)
    first = load(start) if isinstance(start, (str, os.PathLike)) else start
    with bar(observer) as watching:
        request = requested(options, method=method, model=model, time_limit=time_limit, observer=watching)
        return by_request(scene, target, first, request)


def by_request(scene: Scene, target: Targets | None, start: float | Array | Scene | None, options: Request) -> Fit:
    """Do what `estimate` says, with all that it is asked for as one object."""
    target, options = resolved(scene, target, options.checked())
    twin, began = target is None, interrupts.now()
    if twin and (options.substeps is not None or options.model == AUTO):
        what = "substeps" if options.substeps is not None else "model auto"
        raise InvalidInput(f"{what}: a target is needed; without one, the model and the step are the scene's")
    if twin and options.windows is not None:
        raise InvalidInput("windows: a target is needed, in whose states they begin")
    options = replace(options, fit=options.fit or ((AUTO,) if scene.auto else ()))
    scene = reflagged(scene.with_bounds(from_user(options.bounds or {})), options)
    if not scene.blocks:
        raise InvalidInput(
            f"{scene.name}: nothing to fit: no object flags anything; use --fit auto or --fit nF, or set its "
            "optimizationSettings"
        )
    if target is None:
        if options.registers:
            what = "the clock and the place of a target"
            raise InvalidInput(f"{what} can be found only where one is given; give a target")
        return one_fit(scene, None, start, options, began)
    raw, markers = experiments(scene, target), None
    moved = next((placed(each) for each in raw if each.scene is scene), scene)
    raw = [Experiment(motion, moved if own is scene else own) for motion, own in raw] if moved is not scene else raw
    scene = moved
    hints = left_behind(raw)
    say(hints, options)
    before = interrupts.now()
    clouds, start, short, places, steps = with_scans(scene, raw, start, options)
    options = options if steps is None else replace(options, substeps=steps)
    tracking, given = interrupts.now() - before, places or clouds
    tracks = [motion for motion, _ in clouds] if clouds is not raw else None
    if not (options.keep_markers or callable(options.objective)):
        given, markers, mended = put_right(scene, given, options)
        say(mended, options)
        hints = [*hints, *mended]
    if options.registers:
        if options.objective == "position":  # turned positions show no rounding
            options = options.within(max(rounding(each.motion) for each in given))
        fit = registered_fit(Refinement.first(scene, given, options), start, options, began)
    else:
        given, starts, late = begun(given)
        say(late, options)
        fit = one_fit(scene, given, start, options, began)
        if places and not (starts or ended(fit) or leaves_more(fit.scene, clouds[0].motion)):
            fit = one_fit(scene, clouds, fit.scene, options, began, fit)
        fit = replace(fit, registration=starts)
        hints = [*hints, *late]
    corresponds = Correspondence(*given[0].motion.correspondence[:2])
    hints = [*hints, Hint("untracked", short, before_fit=False)] if short else hints
    fit = replace(
        fit, seconds=fit.seconds + tracking, hints=[*hints, *fit.hints], markers=markers,
        correspondence=corresponds, tracks=tracks,
    )  # fmt: skip
    if tracks is None or raw[0].scene is not scene:
        return fit
    known = fit.registration[0] if fit.registration else Registration()
    shown = (known.applied(each, scene.delta) for each in (raw[0].motion, tracks[0]))
    return looked_at(fit, with_figures, *shown, options=options)


def registered_fit(refinement: Refinement, start: float | Array | Scene | None, options: Request, began: float) -> Fit:
    """The fit to targets whose clock or place is found with its values; done again with what a look after it promises,
    and kept unless its error is larger. With all values clocks have the rate 1 where the data show no other.
    """
    found = one_fit(refinement.scene, refinement.registered(), start, options, began)
    for _ in range(ROUNDS):
        other = None if ended(found) else refinement.another(found, left(options, began))
        if other is None:
            break
        again = replace(options, observer=Again(options.observer, found), checkpoint=None, resume=False)
        fit = one_fit(refinement.scene, other.registered(), start, again, began, found)
        if not fit.rmse < ALIKE_ERROR * found.rmse:
            found = replace(found, evaluations=fit.evaluations, seconds=fit.seconds)
            break
        refinement, found = other, replace(fit, hints=[*(hint for hint in found.hints if hint.before_fit), *fit.hints])
    if options.intervals and not ended(found):
        refinement = refinement.with_intervals(found, left(options, began))
    if options.fit_time and any(block.name == "gravity" for block in found.parameters):
        found = replace(found, warnings=[*found.warnings, SAME_FALL])
    return replace(found, registration=list(refinement.known))


def ended(fit: Fit) -> bool:
    """Whether a fit has ended so that nothing more is looked at."""
    return fit.status in (Status.INTERRUPTED, Status.DIVERGED)


class Again(Observer):
    """Hands on the progress of a fit after another one, which may be the better one so far."""

    def __init__(self, observer: Observer, before: Fit) -> None:
        self.observer, self.best = observer, (before.cost, before.rmse)

    def progress(self, progress: Progress) -> None:
        cost, rmse = min(self.best, (progress.cost, progress.rmse))
        self.observer.progress(replace(progress, cost=cost, rmse=rmse))


def left(options: Request, began: float) -> float | None:
    """The seconds that are left of a fit; None: no limit."""
    return None if options.time_limit is None else options.time_limit - (interrupts.now() - began)


def say(hints: Sequence[Hint], options: Request) -> None:
    """Hand on hints that come before a fit."""
    for hint in hints:
        options.observer.hint(hint)


def one_fit(
    scene: Scene, target: Targets | None, start: float | Array | Scene | None, options: Request, began: float,
    before: Fit | None = None,
) -> Fit:  # fmt: skip
    """The fit to targets as they are: pins, objectives, what it settles before it begins, search, and what its motion
    says; with the time and the evaluations of one `before` it.
    """
    twin, pinned, speed = target is None, 0, 0.0
    if target is not None and options.auto:
        scene, speed = with_start_velocity(scene, target)
    if target is not None and not (options.hold or options.windows or callable(options.objective)):
        scene, target, pinned = followed(scene, target)
    scene = flagged(scene, options.model)
    objective, kept_out = objectives(scene, target, options)
    options = options.within(objective.rounding)
    timeless = twin or objective.own or scene.method == REST
    hints = [] if timeless else hints_before_fit(objective.experiments)
    hints += [] if before else other_step(scene, start)
    same = {}
    if options.checkpoint:  # digests of all arrays
        same = identity(scene, None if twin else objective.experiments, start, **options.identity)
    whole = None if options.windows is None else objective
    objective = objective if options.windows is None else in_windows(objective, options.windows)
    options.observer.memory(objective.needs)
    checkpoint, state = opened(options.checkpoint, options.resume, same, len(parameters(scene)))
    say(hints, options)
    with interrupts.deferred():
        with interrupts.limited(left(options, began)):
            fit = Fitting.of(objective, start, options, twin, kept_out, checkpoint, state)
            if before:
                fit.search.budget.extra += before.evaluations
                fit.search.progress.began -= before.seconds
            found = searched(fit)
            notes = (*beginning(speed), *fit.notes, *(each.text for each in fit.kinds))
            chosen = [Hint("auto", text, before_fit=False) for text in notes]
            found = replace(found, hints=[*hints, *chosen, *found.hints])
        found = assessed(found, fit, whole)
        return replace(looked_at(found, with_start, whole or objective, options=options), followed=pinned)


def beginning(speed: float) -> list[str]:
    """What a fit that chooses by itself says of a start at some speed, m/s."""
    text = "start velocity: that of the target, which moves at {:.2g} m/s (RMS) in its first frames"
    return [text.format(speed)] if speed else []


def assessed(found: Fit, fit: Fitting, whole: Objective | None) -> Fit:
    """The fit with what its motion says: fallbacks, the verdict on its model, and how far it is from what was kept out
    of it; `whole`: the objective of whole motions, where windows were compared.
    """
    if found.status == Status.DIVERGED:
        return found
    options, objective = fit.options, fit.search.objective
    kept_out, whole = fit.like(fit.kept_out), fit.like(whole)
    found = looked_at(replace(found, travel=objective.rms_displacement), with_fallbacks, objective, options=options)
    found = looked_at(found, with_verdict, objective, options.rmse_tolerance, fit.twin, options=options)
    if options.intervals:
        found = looked_at(found, with_lower_bounds, objective, options=options)
    found = with_picture(replace(found, windows=options.windows), whole or objective)
    found = with_own_motion(found, fit.search)
    found = looked_at(found, with_residual_hints, objective, options=options)
    if whole is not None:
        found = looked_at(found, with_whole, whole, options=options)
    found = looked_at(found, with_floor, objective, options=options)
    found = looked_at(found, with_stall_hint, objective, options=options)
    if options.method == AUTO and not (fit.twin or fit.tried or options.resume):
        found = looked_at(found, with_step_hint, objective, options=options)
    if kept_out is None:
        return found
    known = looked_at(found, with_holdout, kept_out, whole or objective, options, options=options)
    if known is found:
        return replace(found, warnings=[*found.warnings, "no holdout, as the fit was ended"])
    return known


def searched(fit: Fitting) -> Fit:
    """The result of a search."""
    options, twin, given = fit.options, fit.twin, fit.start is not None
    status = by_routes(fit)
    search = fit.search
    flattened = status != Status.DIVERGED and fit.as_it_is < search.best.cost
    if status != Status.DIVERGED:
        options.observer.result(search.objective.scene if flattened else fitted_scene(search, search.best.p, given))
    seconds, warnings = search.progress.seconds, [*search.warnings]
    if fit.checkpoint and fit.checkpoint.fault:
        warnings.append(fit.checkpoint.fault)
    known = assess(search, status, warnings, twin) if options.intervals else UNKNOWN
    found = result(search, fit.own.scene, status, options.method, warnings, given, known, seconds)
    if flattened:
        found = unflattened(found, search.objective, fit.as_it_is)
    models = judged(search.levels, fit.like(fit.kept_out)) if fit.judged is None else fit.judged
    if fit.judged is not None and (hint := nearer(fit.judged, fit.model)) is not None:
        found = replace(found, hints=[*found.hints, hint])
    asked = options.substeps if isinstance(options.substeps, int) and not twin else None
    return replace(found, ladder=models, steps=list(fit.tried), substeps=fit.step[0] if fit.step else asked)


def unflattened(found: Fit, objective: Objective, cost: float) -> Fit:
    """The scene as it was, of that cost, in place of a fit by equal values that comes no nearer."""
    text = (
        f"the scene's own values, which differ from each other, come nearer as they are, to "
        f"{metres(objective.rmse(cost))}, than equal ones (G), to {metres(found.rmse)}, and are kept; --model F keeps "
        "their pattern"
    )
    hints = [*found.hints, Hint("pattern", text, before_fit=False)]
    found = replace(without_intervals(found), hints=hints, verdict=None)
    return replace(found, scene=objective.scene, cost=cost, rmse=objective.rmse(cost))


def with_step_hint(fit: Fit, objective: Objective) -> Fit:
    """The fit with a hint where its model differs and a finer step would come nearer."""
    if fit.verdict is None or not fit.verdict.differs:
        return fit
    nearer = step_choice.finer(objective, parameters(fit.scene, objective.scene))
    if nearer is None:
        return fit
    text = (
        f"with {step_choice.FINE_SUBSTEPS} steps of BDF2 to a frame, one factor alone would bring the error from "
        f"{metres(fit.rmse)} to {metres(nearer)}; --substeps auto fits so, and changes the scene's step"
    )
    return replace(fit, hints=[*fit.hints, Hint("time_step", text, before_fit=False)])


def looked_at(fit: Fit, refinement: Callable[..., Fit], *given: Any, options: Request) -> Fit:
    """What `refinement` makes of a fit and what is `given`, within a moment where the time of the fit is limited; the
    fit as it is where a request or the time ends it, and with a warning where equations have no solution.
    """
    if fit.status == Status.INTERRUPTED or interrupts.requested():
        return fit
    try:
        seconds = None if options.time_limit is None else GRACE
        return in_time(partial(refinement, fit, *given), fit, seconds, known=True)
    except np.linalg.LinAlgError as error:
        return replace(fit, warnings=[*fit.warnings, f"the fit could not be looked at in full: {in_words(error)}"])


def objectives(scene: Scene, target: Targets | None, options: Request) -> tuple[Objective, Objective | None]:
    """The objective of the fit, and that of what is kept out of it, if anything. Raises InvalidInput, Diverged."""
    if target is None:
        check_memory(scene.frames, sum(scene.vertex_counts), 0)  # without --memory, what is free is what is short
        systems = [build(scene, cloth) for cloth in fitted_cloths(scene)]
        check_own(systems, scene.frames, memory_budget(options.memory))
        target = simulate_cloths(scene, fitted_cloths(scene), tolerance=options.tolerance)
    given, kept_out = experiments(scene, target), None
    frames = [experiment.scene.frames for experiment in given]
    if options.holdout is not None:
        given, rest = split(scene, given, options.holdout, options.holdout_of)
        kept_out = Objective(scene, rest, options.tolerance, frames, memory=options.memory)
    objective = Objective(
        scene, given, options.tolerance, frames,
        objective=options.objective, loss=options.loss, loss_scale=options.loss_scale, memory=options.memory,
    )  # fmt: skip
    if not objective.shows_motion:
        raise InvalidInput(
            f"{given[0].motion.name}: shows nothing after the start that can move, within {frames[0]} frames, so there "
            f"is nothing to fit to{frames_of_one(given[0].motion)}"
        )
    return objective, kept_out


def frames_of_one(motion: Motion) -> str:
    """What to name in the place of one frame."""
    numbered = re.fullmatch(r"(.*?)\d+(\.\w+)", motion.name)
    name = f"all its sequence, as {numbered[1]}*{numbered[2]}" if numbered else "a file with a motion"
    return f"; it has one frame: name {name}" if len(motion.times) == 1 else ""


def assess(search: Search, status: Status, warnings: list[str], twin: bool) -> Judgement:
    """The verdict on the result of a search and the confidence in it, or a warning why there is none; `twin`: the
    target is the scene's own motion.
    """
    if status == Status.DIVERGED or not search.fitted.any():
        return UNKNOWN
    if status == Status.INTERRUPTED:
        warnings.append("no intervals, as the fit was interrupted")
        return UNKNOWN
    try:
        found = in_time(partial(judgement, search, twin), None, known=True)
    except Diverged:
        return UNKNOWN
    if found is None:
        ended = "their computation was interrupted" if interrupts.requested() else "the time was used up"
        warnings.append(f"no intervals, as {ended}")
        return UNKNOWN
    if found.verdict is None:
        warnings.append("no intervals: whether the model differs from the target cannot be said")
    elif found.known is None:
        warnings.append("no intervals: for so many parameters they would take minutes or more, or too much memory")
    elif found.known.warning:
        warnings.append(found.known.warning)
    return found


def with_holdout(fit: Fit, kept_out: Objective, fitted: Objective, options: Request) -> Fit:
    """The fit with how far its motion, and the best still picture of what is `fitted`, are from what was kept out."""
    rmse = error_of(kept_out, parameters(fit.scene, kept_out.scene))
    still = picture_error(kept_out, fitted) if fit.baselines and options.holdout_of == "frames" else None
    held = HeldOut(options.holdout_of, options.holdout or 0.0, kept_out.observations, rmse, still)
    if still is None or rmse < still:
        return replace(fit, holdout=held)
    text = (
        f"frames kept out are {metres(rmse)} from the fitted motion, and {metres(still)} from the best still picture "
        "of the fitted ones: the motion is not to be trusted after the frames that it is fitted to"
    )
    return replace(fit, holdout=held, warnings=[*fit.warnings, text])
