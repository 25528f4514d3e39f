"""Find the flagged parameters whose motion matches a target: the outer loop around the exact gradient.

The default method is `auto`; SciPy's minimisers go by their names. Whatever ends the search, its budget, an interrupt
or a stalled line search, the best point that it visited is the result.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
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
from clothfit.fit.flags import reflagged
from clothfit.fit.hints import Hint, early_hints
from clothfit.fit.holdout import HeldOut, error_of, judged, nearer, split
from clothfit.fit.options import AUTO, FitOptions, Keywords, options_of, settled
from clothfit.fit.preparation import flagged, followed, in_time, in_windows, with_start_velocity, with_whole
from clothfit.fit.registered_fit import SAME_FALL, Look, begun, put_right
from clothfit.fit.residual_hints import with_own_motion, with_residual_hints, with_stall_hint, with_start, with_still
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
from clothfit.objective.memory_needs import Needs, check_own
from clothfit.objective.objective import Compared, Objective
from clothfit.optimise.checkpoint import Checkpoint, identity, opened
from clothfit.optimise.progress import Progress, bar
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status
from clothfit.registration.record import Registration
from clothfit.registration.tracking import placed
from clothfit.scene.bounds import from_user
from clothfit.scene.fit_vector import fitted_cloths, parameters
from clothfit.scene.kinds import REST
from clothfit.scene.scene import Scene, check_is_scene, load
from clothfit.strategy import step_choice

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
    budget: str | float | None = None,
    max_evaluations: int | None = None,
    rmse: float | None = None,
    tolerance: float | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    objective: Compared = "position",
    loss: str = "linear",
    loss_scale: float | None = None,
    prior: float | str = "auto",
    checkpoint: str | os.PathLike[str] | Checkpoint | None = None,
    resume: bool = False,
    holdout: float | None = None,
    holdout_of: str = "frames",
    intervals: bool = True,
    memory: int | str | None = None,
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None,
    model: str | None = None,
    substeps: int | str | None = None,
    keep_step: bool = False,
    windows: int | None = None,
    fit_time: bool = False,
    fit_placement: bool = False,
    fit_scale: bool = False,
    keep_markers: bool = False,
    hold: bool = False,
    fit: str | Sequence[str] | None = None,
    on_memory: Callable[[Needs], None] | None = None,
    on_hint: Callable[[Hint], None] | None = None,
    on_found: Callable[[Scene], None] | None = None,
) -> Fit:
    """Fit the flagged values of a scene to one target motion or to several. The arguments have the names of the
    options of the command `clothfit estimate`.

    `target`, `objective`, `loss`, `loss_scale` and `memory` are those of `Objective`. The fit compares the scene's
    `frames` of each target; of a target with its own scene, as many as that scene says. Without a target the fit is a
    trial: the target is simulated with the scene's own values, and the fit starts from values that do not depend on
    them.

    `objective` may also be a cost of one's own: a function that takes a `Motion` of F frames and N vertices and returns
    the cost, at least 0, and its derivative (F, N, 3) by the positions; it sees the motion at the times of the target's
    frames, or without a target at those of the scene. It is minimised by "l-bfgs-b" or another minimiser of SciPy; as
    `Residuals` also by "gauss-newton". The fit then starts from the scene's values as with a target, and knows no
    hold-out, clock, placement or loss; `rmse` is the root of the cost.

    With a target the fit starts from the scene's values. `start` replaces them: a number for all masses and
    stiffnesses (for all values, where neither are fitted), an array (P,), or a scene, or the path of one,
    whose values to take. `method` is "auto", "momentum", "gauss-newton", or the name of a minimiser of SciPy. The fit
    ends after `max_evaluations` of cost and gradient (default: 1000), or below an error of `rmse`, m (with other
    objectives in the unit of what they compare; default: 1e-8, or half a unit in the last place of the target's numbers
    where they are float32 or text).
    `tolerance` is that of the linear systems, relative. `on_progress` is called with a `Progress` after each
    evaluation, and now and then while a step of thousands of values is computed.

    After the time of `budget`, a text such as "30s", "2m" or "1h", or a number of seconds, the fit ends with status
    "limit" and the best result so far; the intervals take the time that the search leaves.

    `prior` is for the methods "auto" and "gauss-newton": the values of one kind scatter around those of a fabric, as
    widely as the data say ("auto"), or around the start with this standard deviation of the logarithm; "none" assumes
    nothing. `holdout` keeps this fraction of the frames, the last ones, or of the vertices (`holdout_of` "vertices")
    out of the fit, to judge it by. `intervals` False leaves out the 95 % intervals, which take about as long as a step
    of Gauss–Newton.

    With a file as `checkpoint` a fit that was killed goes on from there when `resume` is true; `max_evaluations`,
    `rmse` and `on_progress` may differ then. KeyboardInterrupt ends the fit with status "interrupted" and the best
    result so far; before the first evaluation it passes through. `on_found` is called with the best scene when the
    search has ended, before anything else is looked at. Whatever ends a fit, its result costs no more than its start.

    `on_memory` is called with the memory that the fit will need, before it begins, `on_hint` with each hint that the
    targets give before a fit. Where matrices do not fit into `memory`, another method takes over, with a warning.

    `bounds` replaces those of the scene: for a kind, such as "stiffness", its lower and upper bound in its unit, None
    where the default is to hold.

    `fit` takes the place of the scene's flags: kinds such as "wind", "stiffness=R" or ["nR", "damping"], or "auto",
    with which the fit chooses them by itself, as it does for scenes that say so.

    `model` takes the place of the modes of all masses, stiffnesses and rest lengths that are flagged: "F", "R", "M",
    "G", "L", or "auto", the smallest of F, R, M and L that no finer one beats on what is kept out of the fit.
    `substeps` is the number of time steps to a frame of the target, by the scene's integrator or by BDF2, whichever
    comes nearer, or "auto", as many as pay; scenes with BDF2 are fitted so unless `keep_step` is true. `Fit.scene` has
    the step with which it is to be played.

    With `windows` the target is cut into windows of so many frames, each of which begins in the target's own state: its
    positions, and the velocities of the frames around. What the model lacks, or chaos, does not add up then: forces,
    such as those of wind, come out as single frames show them. The error is that over the windows; `Fit.whole` has that
    of the whole motion.

    `fit_time` finds the rate and the offset of each target's clock with the values, `fit_placement` its place: the
    rotation and the translation that bring it into the scene, `fit_scale` its scale. The fit then compares with the
    target at the scene's times and in its place; `Fit.registration` says what was found.

    Markers of a target that are swapped are exchanged, and what shows no vertex is left out, as `Fit.markers` says,
    unless `keep_markers` is true: only where the target shows it plainly, at its start or from one frame to the next.

    Fixed vertices that move in a target, by more than noise, follow it: `Fit.scene` has pins for them. With `hold` they
    stay where they are. In windows, and where the paths of pins are fitted, they stay as well.

    Raises InvalidInput when nothing is flagged, or an argument, the target or the checkpoint does not fit; Diverged
    when the scene's own motion, needed as the target, diverges.
    """
    given = locals()
    check_is_scene(scene)
    named = {name: given[name] for name in Keywords.__annotations__ if name in given}
    options = replace(options_of("estimate", named), checkpoint=checkpoint, resume=resume)
    first = load(start) if isinstance(start, (str, os.PathLike)) else start
    with bar(options.on_progress) as told:
        return by_options(scene, target, first, replace(options, on_progress=told))


def by_options(scene: Scene, target: Targets | None, start: float | Array | Scene | None, options: FitOptions) -> Fit:
    """Do what `estimate` says, with its options as one object."""
    target, options = settled(scene, target, options.checked())
    hidden, began = target is None, interrupts.now()
    if hidden and (options.substeps is not None or options.model == AUTO):
        what = "substeps" if options.substeps is not None else "model auto"
        raise InvalidInput(f"{what}: a target is needed; without one, the model and the step are the scene's")
    if hidden and options.windows is not None:
        raise InvalidInput("windows: a target is needed, in whose states they begin")
    options = replace(options, auto=options.auto or (scene.auto and not options.fit))
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
    clouds, start, short, places = with_scans(scene, raw, start, options)
    tracking, given = interrupts.now() - before, places or clouds
    tracks = [motion for motion, _ in clouds] if clouds is not raw else None
    if not (options.keep_markers or callable(options.objective)):
        given, markers, mended = put_right(scene, given, options)
        say(mended, options)
        hints = [*hints, *mended]
    if options.registers:
        if options.objective == "position":  # turned positions show no rounding
            options = options.within(max(rounding(each.motion) for each in given))
        found = registered_fit(Look.first(scene, given, options), start, options, began)
    else:
        given, starts, late = begun(given)
        say(late, options)
        found = one_fit(scene, given, start, options, began)
        if places and not (starts or ended(found) or leaves_more(found.scene, clouds[0].motion)):
            found = one_fit(scene, clouds, found.scene, options, began, found)
        found = replace(found, registration=starts)
        hints = [*hints, *late]
    corresponds = Correspondence(*given[0].motion.correspondence[:2])
    hints = [*hints, Hint("untracked", short, early=False)] if short else hints
    found = replace(
        found, seconds=found.seconds + tracking, hints=[*hints, *found.hints], markers=markers,
        correspondence=corresponds, tracks=tracks,
    )  # fmt: skip
    if tracks is None or raw[0].scene is not scene:
        return found
    known = found.registration[0] if found.registration else Registration()
    shown = (known.applied(each, scene.delta) for each in (raw[0].motion, tracks[0]))
    return looked_at(found, with_figures, *shown, options=options)


def registered_fit(look: Look, start: float | Array | Scene | None, options: FitOptions, began: float) -> Fit:
    """The fit to targets whose clock or place is found with its values; done again with what a look after it promises,
    and kept unless its error is larger. With all values clocks have the rate 1 where the data show no other.
    """
    report, found = options.on_progress, one_fit(look.scene, look.registered(), start, options, began)
    again = replace(options, on_memory=None, on_hint=None, on_found=None, checkpoint=None, resume=False)
    for _ in range(ROUNDS):
        other = None if ended(found) else look.another(found, left(options, began))
        if other is None:
            break
        again = replace(again, on_progress=report and partial(report_best, report, found))
        fit = one_fit(look.scene, other.registered(), start, again, began, found)
        if not fit.rmse < ALIKE_ERROR * found.rmse:
            found = replace(found, evaluations=fit.evaluations, seconds=fit.seconds)
            break
        look, found = other, replace(fit, hints=[*(hint for hint in found.hints if hint.early), *fit.hints])
    if options.intervals and not ended(found):
        look = look.with_intervals(found, left(options, began))
    if options.fit_time and look.scene.mode("gravity") != "n":
        found = replace(found, warnings=[*found.warnings, SAME_FALL])
    return replace(found, registration=list(look.known))


def ended(found: Fit) -> bool:
    """Whether a fit has ended so that nothing more is looked at."""
    return found.status in (Status.INTERRUPTED, Status.DIVERGED)


def report_best(report: Callable[[Progress], None], found: Fit, progress: Progress) -> None:
    """Report progress after a fit, which may be the better one so far."""
    cost, rmse = min((found.cost, found.rmse), (progress.cost, progress.rmse))
    report(replace(progress, cost=cost, rmse=rmse))


def left(options: FitOptions, began: float) -> float | None:
    """The seconds that are left of a fit; None: no limit."""
    return None if options.budget is None else options.budget - (interrupts.now() - began)


def say(hints: Sequence[Hint], options: FitOptions) -> None:
    """Hand on hints that come before a fit."""
    if options.on_hint:
        for hint in hints:
            options.on_hint(hint)


def one_fit(
    scene: Scene, target: Targets | None, start: float | Array | Scene | None, options: FitOptions, began: float,
    before: Fit | None = None,
) -> Fit:  # fmt: skip
    """The fit to targets as they are: pins, objectives, what it settles before it begins, search, and what its motion
    says; with the time and the evaluations of one `before` it.
    """
    hidden, pinned, speed = target is None, 0, 0.0
    if target is not None and options.auto:
        scene, speed = with_start_velocity(scene, target)
    if target is not None and not (options.hold or options.windows or callable(options.objective)):
        scene, target, pinned = followed(scene, target)
    scene = flagged(scene, options.model)
    objective, kept_out = objectives(scene, target, options)
    options = options.within(objective.rounding)
    timeless = hidden or objective.own or scene.method == REST
    hints = [] if timeless else early_hints(objective.experiments)
    same = {}
    if options.checkpoint:  # digests of all arrays
        same = identity(scene, None if hidden else objective.experiments, start, **options.identity)
    whole = None if options.windows is None else objective
    objective = objective if options.windows is None else in_windows(objective, options.windows)
    if options.on_memory:
        options.on_memory(objective.needs)
    checkpoint, state = opened(options.checkpoint, options.resume, same, len(parameters(scene)))
    say(hints, options)
    with interrupts.deferred():
        with interrupts.limited(left(options, began)):
            fit = Fitting.of(objective, start, options, hidden, kept_out, checkpoint, state)
            if before:
                fit.search.budget.beside += before.evaluations
                fit.search.progress.began -= before.seconds
            found = searched(fit)
            notes = (*beginning(speed), *fit.notes, *(each.text for each in fit.kinds))
            chosen = [Hint("auto", text, early=False) for text in notes]
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
    found = looked_at(replace(found, travel=objective.travel), with_fallbacks, objective, options=options)
    found = looked_at(found, with_verdict, objective, options.enough, fit.hidden, options=options)
    if options.intervals:
        found = looked_at(found, with_lower_bounds, objective, options=options)
    found = with_still(replace(found, windows=options.windows), whole or objective)
    found = with_own_motion(found, fit.search)
    found = looked_at(found, with_residual_hints, objective, options=options)
    if whole is not None:
        found = looked_at(found, with_whole, whole, options=options)
    found = looked_at(found, with_stall_hint, objective, options=options)
    if options.method == AUTO and not (fit.hidden or fit.tried or options.resume):
        found = looked_at(found, with_step_hint, objective, options=options)
    if kept_out is None:
        return found
    known = looked_at(found, with_holdout, kept_out, options, options=options)
    if known is found:
        return replace(found, warnings=[*found.warnings, "no holdout, as the fit was ended"])
    return known


def searched(fit: Fitting) -> Fit:
    """The result of a search."""
    options, hidden, given = fit.options, fit.hidden, fit.start is not None
    status = by_routes(fit)
    search = fit.search
    flattened = status != Status.DIVERGED and fit.as_it_is < search.best.cost
    if options.on_found and status != Status.DIVERGED:
        options.on_found(search.objective.scene if flattened else fitted_scene(search, search.best.p, given))
    seconds, warnings = search.progress.seconds, [*search.warnings]
    if fit.checkpoint and fit.checkpoint.fault:
        warnings.append(fit.checkpoint.fault)
    known = assess(search, status, warnings, hidden) if options.intervals else UNKNOWN
    found = result(search, status, options.method, warnings, given, known, seconds)
    if flattened:
        found = unflattened(found, search.objective, fit.as_it_is)
    models = judged(search.rungs, fit.like(fit.kept_out)) if fit.judged is None else fit.judged
    if fit.judged is not None and (hint := nearer(fit.judged, fit.model)) is not None:
        found = replace(found, hints=[*found.hints, hint])
    asked = options.substeps if isinstance(options.substeps, int) and not hidden else None
    return replace(found, ladder=models, steps=list(fit.tried), substeps=fit.step[0] if fit.step else asked)


def unflattened(found: Fit, objective: Objective, cost: float) -> Fit:
    """The scene as it was, of that cost, in place of a fit by equal values that comes no nearer."""
    text = (
        f"the scene's own values, which differ from each other, come nearer as they are, to "
        f"{metres(objective.rmse(cost))}, than equal ones (G), to {metres(found.rmse)}, and are kept; --model F keeps "
        "their pattern"
    )
    hints = [*found.hints, Hint("pattern", text, early=False)]
    found = replace(without_intervals(found), hints=hints, verdict=None)
    return replace(found, scene=objective.scene, cost=cost, rmse=objective.rmse(cost))


def with_step_hint(found: Fit, objective: Objective) -> Fit:
    """The fit with a hint where its model differs and a finer step would come nearer."""
    if found.verdict is None or not found.verdict.differs:
        return found
    nearer = step_choice.finer(objective, parameters(found.scene, objective.scene))
    if nearer is None:
        return found
    text = (
        f"with {step_choice.LOOK} steps of BDF2 to a frame, one factor alone would bring the error from "
        f"{metres(found.rmse)} to {metres(nearer)}; --substeps auto fits so, and changes the scene's step"
    )
    return replace(found, hints=[*found.hints, Hint("time_step", text, early=False)])


def looked_at(found: Fit, look: Callable[..., Fit], *given: Any, options: FitOptions) -> Fit:
    """What `look` makes of a fit and what is `given`, within a moment where the time of the fit is limited; the fit as
    it is where a request or the time ends it, and with a warning where equations have no solution.
    """
    if found.status == Status.INTERRUPTED or interrupts.requested():
        return found
    try:
        seconds = None if options.budget is None else GRACE
        return in_time(partial(look, found, *given), found, seconds, known=True)
    except np.linalg.LinAlgError as error:
        return replace(found, warnings=[*found.warnings, f"the fit could not be looked at in full: {in_words(error)}"])


def objectives(scene: Scene, target: Targets | None, options: FitOptions) -> tuple[Objective, Objective | None]:
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


def assess(search: Search, status: Status, warnings: list[str], hidden: bool) -> Judgement:
    """The verdict on the result of a search and the confidence in it, or a warning why there is none; `hidden`: the
    target is the scene's own motion.
    """
    if status == Status.DIVERGED or not search.fitted.any():
        return UNKNOWN
    if status == Status.INTERRUPTED:
        warnings.append("no intervals, as the fit was interrupted")
        return UNKNOWN
    try:
        found = in_time(partial(judgement, search, hidden), None, known=True)
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


def with_holdout(found: Fit, kept_out: Objective, options: FitOptions) -> Fit:
    """The fit with how far its motion is from what was kept out of it."""
    rmse = error_of(kept_out, parameters(found.scene, kept_out.scene))
    return replace(found, holdout=HeldOut(options.holdout_of, options.holdout or 0.0, kept_out.observations, rmse))
