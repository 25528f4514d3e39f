"""From coarse to fine: the models of a scene, from one factor on its values to each value by itself.

    F one factor  →  R families and regions  →  M smooth maps  →  L single values

beside the values of whole cloths and of the scene (damping, drag, wind, gravity), which belong to all of them. Each
model contains those before it, and its stage starts at their best point and keeps that unless it finds a better one:
no model ends above a smaller one. This is the way to targets that no values reproduce, where single values follow the
first frames into a bad corner, and where most of the error is in a few common values.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.fit import continuation, frame_blocks
from clothfit.fit.few_values import FEW_VALUES, in_a_round, may_touch, minimised, through_windows, to_the_minimum
from clothfit.fit.start import is_steady, steadied, values_by
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.optimise.status import ModelFit, Status, Stop
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.cloth import Cloth
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.kinds import CLOTH_KINDS, MODEL_NAMES, MODELS
from clothfit.scene.scene import Scene

STARTED = 2.0
"""Times what the windows from one start took, that must be left for those from the next one."""

QUICK = 2e11
"""Operations of a dense model that a step of Gauss–Newton may take, some seconds."""

STAGE_TOLERANCE = 1e-7
"""Of the linear systems: its error is far below what a model that differs leaves."""

LOCAL_ERROR = 0.05
"""Error relative to how far the target moves, above which motions are nudged."""

NEARBY = 1.0
"""How far from the end of a fit points are drawn, in units of the coordinates of `continuation`."""

COST_SECONDS = 0.5
"""Seconds for the cost of what a stage has found that is ended."""


def model_of(scene: Scene) -> str:
    """The finest model among the scene's flags: one of `MODELS`, else G."""
    found = [letter for cloth in scene.cloths for letter in letters(cloth).values()]
    return max((each for each in found if each in MODELS), key=MODELS.index, default="G")


def letters(cloth: Cloth) -> dict[str, str]:
    """The modes of what a cloth flags, by the names of the kinds."""
    modes = {kind.name: cloth.mode(kind.name) for kind in CLOTH_KINDS}
    return {name: mode for name, mode in modes.items() if mode != "n"}


def as_model(scene: Scene, model: str, exactly: bool = False) -> Scene:
    """The scene flagged with a model: finer flags of masses, stiffnesses and lengths become that, all of them where
    `exactly`. Velocities of single vertices have no such mode and are not fitted by coarser models than L.
    """
    return replace(scene, cloths=tuple(_cloth_as(cloth, model, exactly) for cloth in scene.cloths))


def _cloth_as(cloth: Cloth, model: str, exactly: bool) -> Cloth:
    modes = dict(letters(cloth))
    for kind in CLOTH_KINDS:
        mode = modes.get(kind.name, "n")
        if mode == "n" or kind.modes == "G":
            continue
        finer = mode in MODELS and MODELS.index(mode) > MODELS.find(model)
        if finer or (exactly and "F" in kind.modes):
            modes[kind.name] = model if model in kind.modes else "n"
    settings = "".join(modes.pop(name, "n") for name in ("mass", "stiffness"))
    return replace(cloth, settings=settings, fits=modes)


def models(scene: Scene) -> list[str]:
    """The models of a scene from coarse to fine, up to its own. One that has no more values than a coarser one is left
    out; the scene's own stays in its place.
    """
    own = model_of(scene)
    if own not in MODELS:
        return [own]
    found: list[str] = []
    for each in MODELS[: MODELS.index(own) + 1]:
        if not found or count(as_model(scene, each)) > count(as_model(scene, found[-1])):
            found.append(each)
    return found if own in found else [*found[:-1], own]


def remaining_models(scene: Scene) -> list[str]:
    """The models that are left of a scene where a choice of the step has fitted those that maps or regions contain."""
    found = models(scene)
    few = [model for model in found if model != "L"]
    return [*few[-1:], *found[len(few):]]


def count(scene: Scene) -> int:
    """Number of values that a scene flags."""
    return sum(block.count for block in scene.blocks)


def refine(search: Search, wanted: Sequence[str], starts: Sequence[Array] = ()) -> None:
    """Fit models of a search one after the other, until it is late, each from the best point before; the windows of the
    first go from `starts` (P,), where there are any. Raises Stop.
    """
    for number, model in enumerate(wanted):
        if number and search.is_late:
            break
        fit_level(search, model, () if number else starts)


def warn_where_late(search: Search, status: Status) -> None:
    """Warn where the time ended models that had not come to a minimum."""
    if search.levels and search.is_late and status == Status.STALLED:
        ended = f"the fit ended after {search.longest:.0f} s of computing, before it came to a minimum"
        search.warn(f"{ended}; --budget gives it more")


def fit_level(search: Search, model: str, starts: Sequence[Array] = ()) -> None:
    """Fit one model as `stage` does, and note what it has come to. Raises Stop."""
    began = time.monotonic()
    stage(search, model, starts)
    search.add_level(level_result(search, model, time.monotonic() - began))


def level_result(search: Search, model: str, seconds: float = 0.0) -> ModelFit:
    """What a model has come to."""
    values = count(as_model(search.objective.scene, model))
    return ModelFit(model, values, search.objective.rmse(search.best.cost), search.best.p, seconds)


def stage(search: Search, model: str, starts: Sequence[Array] = (), rough: bool = False) -> None:
    """Fit one model from the best point of a search, by a short round, enough for a comparison, where `rough`. First a
    model of few values goes through windows of the first frames from each of `starts` (P,). Raises Stop.
    """
    if not np.isfinite(search.best.cost):
        search.visit(search.start)
    steady_wind(search, model)
    began = search.progress.computing
    for number, start in enumerate(starts):
        if number and not search.has_time(STARTED * (search.progress.computing - began) / number):
            break
        part = subproblem(search, model, start)
        if part.fitted.sum() <= FEW_VALUES:
            run_subproblem(search, part, through_windows)
    coarsest = model == models(search.objective.scene)[0]
    part = subproblem(search, model, search.best.p)
    if not (rough or coarsest) and is_quick(part):
        run_subproblem(search, part, continuation.through_weak_nudging)
        part = subproblem(search, model, search.best.p)
    method = in_a_round if rough else to_the_minimum
    run_subproblem(search, part, method)
    if not rough and coarsest and may_be_local(search):
        for start in starts:
            # windows may lead farther off than none
            run_subproblem(search, subproblem(search, model, start), to_the_minimum)
        if starts:
            run_subproblem(search, subproblem(search, model, search.origin), continuation.by_coarse_steps)
            run_subproblem(search, subproblem(search, model, search.best.p), to_the_minimum)
    if not rough and turning_pays(search):
        part = subproblem(search, model, search.best.p, turned=True)
        if part.fitted.sum() <= FEW_VALUES:
            run_subproblem(search, part, through_windows)
        run_subproblem(search, subproblem(search, model, search.best.p, turned=True), method)


def hop(search: Search, model: str, took: float) -> None:
    """Begin anew from points around the best one, as far as there is time for what `took` so many seconds before.
    Raises Stop.
    """
    part = subproblem(search, model, search.best.p)
    if is_quick(part):
        run_subproblem(search, part, lambda own: continuation.hops(own, took, 1.0, 0.0, NEARBY))


def is_quick(part: Search) -> bool:
    """Whether a step of Gauss–Newton by the model of a part takes some seconds at most."""
    return Trajectory(part, part.objective).operations() <= QUICK


def may_be_local(search: Search) -> bool:
    """Whether other minima may be nearer to the target than the best point is, and motions can be nudged."""
    objective = search.objective
    return search.best.cost > LOCAL_ERROR**2 * objective.cost_at_rest and continuation.can_nudge(objective)


def steady_wind(search: Search, model: str) -> None:
    """Fit one steady wind before its keys, where all of them have the same value (`start`). Raises Stop."""
    whole = search.objective
    if any(each.scene is not whole.scene for each in whole.experiments):
        return
    if is_steady(with_parameters(whole.scene, search.best.p)):
        run_subproblem(search, subproblem(search, model, search.best.p, steady=True), through_windows)
        run_subproblem(search, subproblem(search, model, search.best.p, steady=True), minimised)


def turning_pays(search: Search) -> bool:
    """Whether another direction of gravity saves enough at the best point, beside the values of the coarsest model."""
    scene = with_parameters(search.objective.scene, search.best.p)
    if not frame_blocks.held(scene).any():
        return False
    try:
        return frame_blocks.pays(subproblem(search, models(scene)[0], search.best.p, turned=True))
    finally:
        search.progress.p = search.best.p


def subproblem(search: Search, model: str, p: Array, turned: bool = False, steady: bool = False) -> Search:
    """A search by the parameters of a model, from the values p (P,) of the whole search; gravity keeps its direction
    unless it may be `turned`; the wind may be `steady` (`start`).
    """
    whole = search.objective
    scene = as_model(with_parameters(whole.scene, p), model)
    tolerance = whole.tolerance if may_touch(whole) else max(STAGE_TOLERANCE, whole.tolerance)
    objective = whole.flagging(steadied(scene) if steady else scene, tolerance)
    scene = objective.scene
    part = search.subsearch(objective, parameters(scene), search.best.cost if p is search.best.p else np.inf)
    part.origin = values_by(with_parameters(whole.scene, search.origin), flags=scene)
    if not turned:
        part.fitted = part.fitted & ~frame_blocks.held(scene)
    part.enter(MODEL_NAMES[model])
    return part


def run_subproblem(search: Search, part: Search, method: Callable[[Search], object]) -> None:
    """Run a method on a part of a search, which gets its best point whatever ends it. Raises Stop where that ends the
    whole.
    """
    scene, ended = search.objective.scene, Status.STALLED
    try:
        part.visit(part.start)
        method(part)
    except Stop as stop:
        ended = stop.status
    except BaseException:
        if np.isfinite(part.best.cost):
            p = as_flagged(part, scene)
            search.best.offer(p, cost_in_time(search.objective, p, part.best.cost))
        raise
    finally:
        search.progress.p = search.best.p
    p = as_flagged(part, scene)
    if not np.array_equal(p, search.best.p):
        search.visit(p)
    if part.is_stationary and len(part.best.p) == len(p):  # by all values of the search
        search.stationary = p
    if ended == Status.LIMIT:
        raise Stop(ended)


def cost_in_time(objective: Objective, p: Array, known: float) -> float:
    """The cost at p (P,), or what is known of it where a moment is not enough: a motion near a step that the guard
    shortens may be another one where its systems are solved more tightly.
    """
    with contextlib.suppress(interrupts.OutOfTime), interrupts.grace(COST_SECONDS), interrupts.limited(COST_SECONDS):
        return objective.cost_or_infinity(p)
    return known


def as_flagged(own: Search, scene: Scene) -> Array:
    """The best point of a search as parameters (P,) of another scene's flags."""
    return as_whole(own, own.best.p, scene)


def as_whole(own: Search, p: Array, scene: Scene) -> Array:
    """The values p (P′,) of a search as parameters (P,) of another scene's flags."""
    return values_by(with_parameters(own.objective.scene, p), flags=scene)
