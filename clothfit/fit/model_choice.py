"""Model only what a scene needs: of the models from coarse to fine, the smallest that more freedom does not beat.

Each model (`ladder`) is fitted to a part of the targets, the first frames or some vertices, and judged by the rest: a
finer one always comes nearer to what it is fitted to, but only one that is nearer to what it has not seen has found
something of the cloth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import metres
from clothfit.fit.hints import Hint
from clothfit.fit.holdout import split
from clothfit.motion.divergence import Diverged
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.optimise.status import Rung, Status, Stop
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.strategy import ladder
from clothfit.strategy.trajectory_fit import is_explained

KEPT_OUT = 0.25
"""Share of the frames that judges the models where the user keeps nothing out."""

BEATS = 0.05
"""By this fraction of its error on what is kept out a finer model must be better."""


@dataclass(frozen=True)
class Judged:
    """What one model of a ladder has come to."""

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


def judged(rungs: Sequence[Rung], kept_out: Objective | None) -> list[Judged]:
    """The models of a search with their errors on what is kept out."""
    return [Judged(each.model, each.values, each.rmse, error(kept_out, each.p), each.seconds) for each in rungs]


def error(kept_out: Objective | None, p: Array) -> float | None:
    """The RMSE, m, at p (P,) on what is kept out."""
    if kept_out is None:
        return None
    try:
        return kept_out.position_rmse(p)
    except Diverged:
        return np.inf


def chosen(
    whole: Objective, kept_out: Objective | None, p: Array, enough: float, of: str, budget: int,
    longest: float = np.inf, fitted: bool = False,
) -> Choice:  # fmt: skip
    """The model for an objective, from values p (P,) and within a `budget` of evaluations; none is begun after the
    `longest` time, s of computing. An RMSE of `enough`, m, is good enough. Where nothing is `kept_out` of the
    objective, a part of it judges, the last frames or some vertices, as `of` says. Values that are `fitted`, by the
    coarsest model, go through no windows again.
    """
    scene = ladder.as_model(with_parameters(whole.scene, p), "L", exactly=True)
    part = whole.flagging(scene)
    if kept_out is None:
        part, kept_out = parted(part, of)
    else:
        kept_out = kept_out.flagging(scene)
    search = Search(part, parameters(scene), enough, budget)
    search.longest = longest
    try:
        with threads.single(), interrupts.heard():
            climb(search, [] if fitted else [search.start])
            found = judged(search.rungs, kept_out)
    except (KeyboardInterrupt, interrupts.OutOfTime, Diverged, MemoryError, np.linalg.LinAlgError):
        found = judged(search.rungs, None)  # what was fitted until then
    model = smallest(found) if found else "F"
    at = next((each.p for each in search.rungs if each.model == model), search.best.p)
    return Choice(
        model, parameters(with_parameters(scene, at), flags=ladder.as_model(whole.scene, model, exactly=True)),
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


def climb(search: Search, starts: Sequence[Array]) -> None:
    """Fit the models from coarse to fine, the first from `starts` (P,), up to one that leaves nothing but noise."""
    for model in ladder.models(search.objective.scene):
        if search.rungs and search.is_late:
            return
        try:
            ladder.rung(search, model, starts)
        except Stop as stop:
            if stop.status != Status.CONVERGED:
                return
            search.rungs.append(ladder.reached(search, model))
            return
        if is_explained(search):
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
    return Hint("model", f"{text}; --model {best.model} fits it", early=False)


def smallest(models: Sequence[Judged]) -> str:
    """The first model that no finer one beats on what is kept out, or on what is fitted where nothing is."""
    errors = [each.rmse if each.holdout_rmse is None else each.holdout_rmse for each in models]
    for i, each in enumerate(models):
        if not any(finer < (1.0 - BEATS) * errors[i] for finer in errors[i + 1 :]):
            return each.model
    return models[-1].model
