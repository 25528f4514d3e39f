"""The stages of a trajectory fit: Gauss–Newton on the first frames, on more and more, and at last on all of them.

Near the start of a motion the cost is smooth in the parameters; later that of a windy cloth is chaotic. Stages before
the last one solve the linear systems loosely and end early.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.objective.objective import Objective
from clothfit.optimise.gauss_newton import PATIENT, Patience
from clothfit.optimise.search import Search

NEAR_ERROR = 2e-3
"""Error relative to how far the target moves, below which all frames are fitted at once."""

FAR_ERROR = 0.05
"""Error relative to how far the target moves, above which the model cannot reproduce it: the fit ends there. Nearer, a
last stage with the fit's own tolerance goes to the very minimum.
"""

FIRST_WINDOW, WINDOW_GROWTH = 10, 2
"""Frames of the first window after the first that shows something, and the ratio of one window to the one before."""

WINDOW_ITERATIONS, WHOLE_ITERATIONS = 8, 200
"""Iterations of Gauss–Newton in each window, and where all frames are fitted."""

WINDOW_SAVING, LOOSE_SAVING = 1e-3, 1e-4
"""A window, and a loose stage of all frames, end where a step would save less than this fraction of the cost."""

STAGE_TOLERANCE = 1e-5
"""Of the linear systems before the last stage: its error is far below that of the motion."""

LONG_POSITIONS = 100_000
"""Compared positions from which on a fit saves time: it tries the balances of momentum on a few frames before it solves
those of all, has looser stages before the last one, and ends early where the motion stays far from its target.
"""

STAGE_PATIENCE = Patience(4, 1e-2, 1e-3)
"""Of a long fit before its last stage."""


class Stage(NamedTuple):
    """Gauss–Newton over some frames, as well as is needed there."""

    objective: Objective
    least: float  # relative saving that ends it
    iterations: int
    patience: Patience


def stages(search: Search, near: bool, windows: bool) -> list[Stage]:
    """What is fitted one after the other, all frames last; in `windows` only where the start is not `near` the target.
    """
    objective, whole = search.objective, search.objective.steps + 1
    last = Stage(objective, 0.0, WHOLE_ITERATIONS, PATIENT)
    if near:
        return [last]
    windows = windows and "spectrum" not in objective.weights  # that of a part is another spectrum
    lengths = window_lengths(first_window(objective), whole) if windows else [whole]
    tolerance = stage_tolerance(objective)
    patience = STAGE_PATIENCE if is_long(search) else PATIENT
    found = [
        Stage(objective.until(frames, tolerance), WINDOW_SAVING, WINDOW_ITERATIONS, patience) for frames in lengths[:-1]
    ]
    if tolerance > objective.tolerance and is_long(search):
        found.append(Stage(objective.until(whole, tolerance), LOOSE_SAVING, WHOLE_ITERATIONS, STAGE_PATIENCE))
    return [*found, last]


def first_window(objective: Objective) -> int:
    """Frames of the first window: some after the first that shows anything."""
    return objective.first_step + FIRST_WINDOW


def first_frames(objective: Objective) -> Objective:
    """The objective over the first window, solved loosely."""
    return objective.until(first_window(objective), stage_tolerance(objective))


def window_lengths(frames: int, last: int) -> list[int]:
    """Frames of each window, from the first to the last, which is whole."""
    lengths = []
    while frames < 0.8 * last:
        lengths.append(frames)
        frames *= WINDOW_GROWTH
    return [*lengths, last]


def stage_tolerance(objective: Objective) -> float:
    """The tolerance of the linear systems where the motion is still far from the target's."""
    return max(STAGE_TOLERANCE, objective.tolerance)


def is_long(search: Search) -> bool:
    """Whether a fit takes so long that it saves time."""
    return search.objective.observations >= LONG_POSITIONS


def is_near(search: Search, cost: float | None = None) -> bool:
    """Whether a cost, by default that of the best point, means that the motion is nearly the target's."""
    best = search.best.cost if cost is None else cost
    return bool(np.isfinite(best)) and best < NEAR_ERROR**2 * search.objective.still


def is_far(search: Search) -> bool:
    """Whether the best point is so far from the target that the model cannot reproduce it."""
    return search.best.cost > FAR_ERROR**2 * search.objective.still
