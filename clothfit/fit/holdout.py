"""Keep a part of the targets out of a fit, to see how well the fit predicts it.

Model only what a scene needs: of the models from coarse to fine, the smallest that more freedom does not beat.

Each model (`hierarchy`) is fitted to a part of the targets, the first frames or some vertices, and judged by the rest:
a finer one always comes nearer to what it is fitted to, but only one that is nearer to what it has not seen has found
something of the cloth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import metres
from clothfit.fit import hierarchy
from clothfit.fit.hints import Hint
from clothfit.fit.trajectory_fit import leaves_noise
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion, at_frames
from clothfit.motion.times import frame_places
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.optimise.status import ModelFit, Status, Stop
from clothfit.scene.fit_vector import fitted_cloths, parameters, with_parameters
from clothfit.scene.scene import Scene

SEED = 0


@dataclass(frozen=True)
class HeldOut:
    """How far the fitted motion is from what was kept out of the fit."""

    of: str  # "frames" or "vertices"
    fraction: float  # that was asked for
    observations: int  # positions kept out
    rmse: float  # m, over them; inf where the fitted motion does not stay finite
    still: float | None = None  # m, of frames: RMS distance of the mean of the fitted ones; None: vertices are kept out


def split(
    scene: Scene, given: Sequence[Experiment], fraction: float, of: str
) -> tuple[list[Experiment], list[Experiment]]:
    """The experiments of the fit, and those with only what is kept out. Raises InvalidInput where the targets show too
    little to keep something out.
    """
    if of == "frames":
        pairs = [split_frames(experiment, fraction) for experiment in given]
    else:
        chosen = choose_vertices(scene, given, fraction)
        pairs = [split_vertices(experiment, chosen) for experiment in given]
    return [fitted for fitted, _ in pairs], [kept for _, kept in pairs]


def split_frames(experiment: Experiment, fraction: float) -> tuple[Experiment, Experiment]:
    """The experiment without the last of its compared frames, and with only these."""
    motion, scene = experiment
    step, part = frame_places(motion, scene.delta)
    frames = int(np.searchsorted(step + part, scene.frames - 1, side="right"))
    if frames < 3:
        raise InvalidInput(f"{motion.name}: shows {frames} frames, too few to keep some of them out of the fit")
    first = frames - min(max(round(fraction * frames), 1), frames - 2)
    late = np.zeros(seen(motion).shape, bool)
    late[first:frames] = True
    early, rest = at_frames(motion, slice(first)), showing(motion, late)
    return Experiment(early, scene), Experiment(rest, scene)


def choose_vertices(scene: Scene, given: Sequence[Experiment], fraction: float) -> Flags:
    """Draw the vertices of all objects (vertices,) to keep out; at least one of each fitted object stays in."""
    generator = np.random.default_rng(SEED)
    shown = np.any([moving(experiment) for experiment in given], axis=0)
    owner = np.repeat(np.arange(len(scene.cloths)), scene.vertex_counts)
    chosen = np.zeros(len(owner), bool)
    for cloth in fitted_cloths(scene):
        own = np.flatnonzero(shown & (owner == cloth))
        if len(own) > 1:
            count = min(max(round(fraction * len(own)), 1), len(own) - 1)
            chosen[generator.choice(own, count, replace=False)] = True
    if not chosen.any():
        raise InvalidInput(f"{given[0].motion.name}: shows too few vertices to keep some of them out of the fit")
    return chosen


def moving(experiment: Experiment) -> Flags:
    """Which vertices (vertices,) are free, and observed at some time after the initial state."""
    motion, scene = experiment
    free = ~np.concatenate([cloth.fixed for cloth in scene.cloths])
    return np.asarray(free & seen(motion)[motion.times > 0].any(axis=0))


def split_vertices(experiment: Experiment, chosen: Flags) -> tuple[Experiment, Experiment]:
    """The experiment without the chosen vertices (vertices,), and with only these."""
    motion, scene = experiment
    parts = (showing(motion, part) for part in (~chosen, chosen))
    fitted, kept = (Experiment(part, scene) for part in parts)
    return fitted, kept


def showing(motion: Motion, part: Flags) -> Motion:
    """The motion with only a part of what counts in it, (frames, vertices) or (vertices,), and of points inside
    triangles, or of a scan, those that are near these vertices.
    """
    bound = motion.correspondence
    if bound.weights is not None:
        nearest = np.asarray(bound.weights.argmax(axis=1)).ravel()
        bound = bound._replace(seen=bound.seen & part[..., nearest])
    elif bound.mesh is not None:
        frames = np.arange(len(bound.seen))[:, None]
        corner = bound.mesh.triangles[bound.faces, 0]
        bound = bound._replace(seen=bound.seen & np.broadcast_to(part, motion.positions.shape[:2])[frames, corner])
    return replace(motion, observed=seen(motion) & part, correspondence=bound)


def seen(motion: Motion) -> Flags:
    """Which positions (frames, vertices) count in a comparison."""
    return motion.seen() if motion.weights is None else motion.seen() & (motion.weights > 0)


def error_of(objective: Objective, p: Array) -> float:
    """The RMSE, m, of the motion of parameters p (P,); infinite where it diverges."""
    try:
        return objective.position_rmse(p)
    except Diverged:
        return np.inf


KEPT_OUT = 0.25
"""Share of the frames that judges the models where the user keeps nothing out."""

BEATS = 0.05
"""By this fraction of its error on what is kept out a finer model must be better."""


@dataclass(frozen=True)
class Judged:
    """What one model of a hierarchy has come to."""

    model: str  # a letter: F, R, M or L; G where there is no other
    values: int  # fitted
    rmse: float  # m, over what it is fitted to
    holdout_rmse: float | None  # m, over what is kept out of the fit; None: nothing is
    seconds: float  # of its stage


class Choice(NamedTuple):
    """A model that was chosen."""

    model: str
    p: Array  # (P,), in its parameters
    judged: list[Judged]
    evaluations: int


def judged(levels: Sequence[ModelFit], kept_out: Objective | None) -> list[Judged]:
    """The models of a search with their errors on what is kept out."""
    return [
        Judged(each.model, each.values, each.rmse, None if kept_out is None else error_of(kept_out, each.p),
               each.seconds) for each in levels
    ]  # fmt: skip


def chosen(
    whole: Objective, kept_out: Objective | None, p: Array, rmse_tolerance: float, of: str, budget: int,
    longest: float = np.inf, fitted: bool = False,
) -> Choice:  # fmt: skip
    """The model for an objective, from values p (P,) and within a `budget` of evaluations; none is begun after the
    `longest` time, s of computing. An RMSE of `rmse_tolerance`, m, is good enough. Where nothing is `kept_out` of the
    objective, a part of it judges, the last frames or some vertices, as `of` says. Values that are `fitted`, by the
    coarsest model, go through no windows again.
    """
    scene = hierarchy.as_model(with_parameters(whole.scene, p), "L", exactly=True)
    part = whole.flagging(scene)
    if kept_out is None:
        part, kept_out = parted(part, of)
    else:
        kept_out = kept_out.flagging(scene)
    search = Search(part, parameters(scene), rmse_tolerance, budget)
    search.longest = longest
    try:
        with threads.single(), interrupts.heard():
            fit_models(search, [] if fitted else [search.start])
            found = judged(search.levels, kept_out)
    except (KeyboardInterrupt, interrupts.OutOfTime, Diverged, MemoryError, np.linalg.LinAlgError):
        found = judged(search.levels, None)  # what was fitted until then
    model = smallest(found) if found else "F"
    at = next((each.p for each in search.levels if each.model == model), search.best.p)
    return Choice(
        model, parameters(with_parameters(scene, at), flags=hierarchy.as_model(whole.scene, model, exactly=True)),
        found, search.budget.evaluations,
    )  # fmt: skip


def parted(objective: Objective, of: str) -> tuple[Objective, Objective | None]:
    """The objective without the part that judges, and that part; all of it and None where it is too little to part."""
    try:
        given, rest = split(objective.scene, objective.experiments, KEPT_OUT, of)
    except InvalidInput:
        return objective, None
    ends = [each.scene.frames for each in given]
    return objective.against(objective.scene, given, ends), objective.against(objective.scene, rest, ends)


def fit_models(search: Search, starts: Sequence[Array]) -> None:
    """Fit the models from coarse to fine, the first from `starts` (P,), up to one that leaves nothing but noise."""
    for model in hierarchy.models(search.objective.scene):
        if search.levels and search.is_late:
            return
        try:
            hierarchy.fit_level(search, model, starts)
        except Stop as stop:
            if stop.status != Status.CONVERGED:
                return
            search.levels.append(hierarchy.level_result(search, model))
            return
        if leaves_noise(search):
            return
        starts = [search.best.p]


def nearer(models: Sequence[Judged], chosen: str) -> Hint | None:
    """A hint on the model that came nearest to what was fitted, where another one was `chosen` that is clearly farther
    from that.
    """
    own = next((each for each in models if each.model == chosen), None)
    best = min(models, key=lambda each: each.rmse, default=None)
    if own is None or best is None or not best.rmse < (1.0 - BEATS) * own.rmse:
        return None
    text = f"model {best.model} comes to {metres(best.rmse)} on what was fitted, {chosen} to {metres(own.rmse)}"
    if best.holdout_rmse is not None and own.holdout_rmse is not None:
        kept = f"{metres(best.holdout_rmse)} against {metres(own.holdout_rmse)}"
        text += f"; on what was kept out it is no better, {kept}, so {chosen} was chosen"
    return Hint("model", f"{text}; --model {best.model} fits it", before_fit=False)


def smallest(models: Sequence[Judged]) -> str:
    """The first model that no finer one beats on what is kept out, or on what is fitted where nothing is."""
    errors = [each.rmse if each.holdout_rmse is None else each.holdout_rmse for each in models]
    for i, each in enumerate(models):
        if not any(finer < (1.0 - BEATS) * errors[i] for finer in errors[i + 1 :]):
            return each.model
    return models[-1].model
