"""Estimation methods compared on one scene: how long each takes, and how near it comes.

The scene's own parameters are the truth, hidden from the fits, so the errors of motion and parameters are known.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from clothfit.base.errors import InvalidInput
from clothfit.evaluation.evaluate import relative_deviations
from clothfit.evaluation.work_precision import front
from clothfit.fit.estimate import estimate
from clothfit.fit.options import check_method
from clothfit.fit.result import Fit
from clothfit.optimise.progress import Progress
from clothfit.optimise.status import Status, Stop
from clothfit.scene.scene import Scene

COMPARED = ("auto", "momentum", "gauss-newton", "l-bfgs-b")
"""This package's methods and the best of SciPy's; SciPy's other methods are slower on all examples."""
FIT_EVALUATIONS = 100  # of cost and gradient
FIT_SECONDS = 30.0  # for one fit
WARM_UP_FRAMES, WARM_UP_EVALUATIONS = 5, 3


@dataclass(frozen=True)
class FitRow:
    """Cost and result of one method; numbers are None where it found nothing."""

    method: str
    status: Status  # "limit" where the evaluations or the seconds were spent
    seconds: float  # of the whole fit with its hidden target and search for a start, without intervals
    evaluations: int
    rmse: float | None  # m, of the positions over the fitted frames
    median_relative_deviation: float | None  # |fitted / true − 1| of identifiable values that are not 0
    pareto: bool = False  # whether no other method is faster and as near, or nearer and as fast


def compare_methods(
    scene: Scene,
    methods: Sequence[str] = COMPARED,
    evaluations: int = FIT_EVALUATIONS,
    seconds: float = FIT_SECONDS,
    report: Callable[[float, str], None] | None = None,
) -> list[FitRow]:
    """Fit the scene's own hidden parameters by each method, limited to these evaluations and seconds.

    `report` is called with the seconds since the start and the current task. Raises InvalidInput when nothing is
    flagged or a value is impossible, Diverged when the scene's own motion diverges.
    """
    if evaluations < 1:
        raise InvalidInput(f"evaluations must be at least 1; {evaluations} was given")
    began = time.perf_counter()
    rows = []
    for method in methods:
        check_method(method)
        if report:
            report(time.perf_counter() - began, f"fit by {method}")
        rows.append(fitted(scene, method, evaluations, seconds))
    best = front([(row.seconds, math.inf if row.rmse is None else row.rmse) for row in rows])
    return [replace(row, pareto=bool(flag)) for row, flag in zip(rows, best, strict=True)]


def fitted(scene: Scene, method: str, evaluations: int, seconds: float) -> FitRow:
    """Measure one method."""
    few = replace(scene, frames=min(scene.frames, WARM_UP_FRAMES))
    timed(few, method, WARM_UP_EVALUATIONS, seconds)  # compiling and loading shall not count
    found, took = timed(scene, method, evaluations, seconds)
    rmse = found.rmse if math.isfinite(found.rmse) else None
    deviations = relative_deviations(scene, found.scene)
    known = deviations[~np.isnan(deviations)]
    deviation = None if rmse is None or not known.size else float(np.median(known))
    return FitRow(method, found.status, took, found.evaluations, rmse, deviation)


def timed(scene: Scene, method: str, evaluations: int, seconds: float) -> tuple[Fit, float]:
    """Fit once; returns the fit and the seconds it took."""
    began = time.perf_counter()

    def watch(progress: Progress) -> None:
        if time.perf_counter() - began > seconds:
            raise Stop(Status.LIMIT)

    found = estimate(scene, method=method, max_evaluations=evaluations, on_progress=watch, intervals=False)
    return found, time.perf_counter() - began
