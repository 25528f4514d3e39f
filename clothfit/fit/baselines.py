"""What a fit must beat: the best still picture of its target, and the scene as it came.

The still picture has each vertex at the mean of the compared frames, which no other picture comes nearer than. A model
whose motion is no nearer than that explains nothing of the motion: the fit fails, whatever the search says of its end.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clothfit.base.messages import listed, metres
from clothfit.derivative.adjoint import Observer
from clothfit.engine.tape import Tape
from clothfit.fit.hints import Hint
from clothfit.fit.result import FAILS, Baselines, Fit, without_intervals
from clothfit.motion.divergence import Diverged
from clothfit.objective.objective import Objective
from clothfit.objective.run import Run, shown
from clothfit.optimise.status import Status
from clothfit.scene.scene import Scene

MOVERS = ("damping", "drag", "wind", "gravity")
"""Kinds whose lack keeps a cloth from moving as its target does."""


def still(objective: Objective) -> float:
    """Root mean square distance, m, of the compared positions from the mean of each vertex over its frames."""
    squares = 0.0
    for run in objective.runs:
        goal = run.comparison.goal
        x = objective.experiments[run.experiment].motion.of(run.cloth)[: len(goal.step)]  # in the scene's axes
        x, seen = run.comparison.shown(x), run.comparison.observed[..., None]
        mean = x.sum(axis=0, where=seen) / np.maximum(seen.sum(axis=0), 1)
        squares += sum(float(((each - mean) ** 2).sum(where=here)) for each, here in zip(x, seen, strict=True))
    return float(np.sqrt(squares / max(objective.observations, 1)))


def as_it_came(objective: Objective) -> float | None:
    """Root mean square distance, m, of the motion by the scene's own values, whatever is flagged; None where it
    diverges.
    """

    def show(run: Run, observe: Observer) -> None:
        shown(run, Tape(run.system, run.steps, objective.tolerance, None, run.forms), [observe])

    try:
        found = objective.distance(show)
    except Diverged:
        return None
    return found if np.isfinite(found) else None


def with_still(found: Fit, objective: Objective) -> Fit:
    """The fit beside the best still picture, where positions are compared. Over whole motions, where the model differs,
    a fit that is not nearer fails.
    """
    if objective.own or not objective.observations or "position" not in objective.weights:
        return found
    found = replace(found, baselines=Baselines(still(objective)))
    nearer = not found.rmse >= still_of(found)
    if found.windows is not None or found.verdict is None or not found.verdict.differs or nearer:
        return found
    text = (
        f"the best still picture of the target comes to {metres(still_of(found))}, the fitted motion only to "
        f"{metres(found.rmse)}: what moves the cloth is missing from the model, or the search, which ended in its "
        f"stage “{found.stage}”, has not found it. {way_out(objective.scene)}"
    )
    status = Status.STALLED if found.status == Status.CONVERGED else found.status
    verdict, first = replace(found.verdict, model=FAILS), Hint(FAILS, text, early=False)
    warnings = [each for each in found.warnings if not each.startswith("no intervals")]
    warnings.append("no intervals: the fit fails, so its values say nothing of the cloth")
    found = replace(without_intervals(found), status=status, verdict=verdict)
    return replace(found, hints=[first, *found.hints], warnings=warnings)


def still_of(found: Fit) -> float:
    """The error of the still picture, m; infinite where it is not known."""
    return np.inf if found.baselines is None else found.baselines.still


def with_start(found: Fit, objective: Objective) -> Fit:
    """The fit beside the scene as it came; `objective` has that scene, in its own step."""
    if found.baselines is None:
        return found
    return replace(found, baselines=replace(found.baselines, start=as_it_came(objective)))


def way_out(scene: Scene) -> str:
    """What to try where a fit of the scene fails."""
    flagged = {block.name for block in scene.blocks}
    missing = [name for name in MOVERS if name not in flagged]
    if missing:
        return (
            f"Fit {listed(missing)} as well (--fit auto), or see that what is held, and wind, are as in the target; "
            "where its clock may be another, use --fit-time"
        )
    return "Try other starts (--starts 8), more time (--budget), or fewer frames first"
