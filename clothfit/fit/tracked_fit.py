"""Scans: tracked by the values that they show themselves, before the fit.

A cloth of wrong values is drawn to a scan along another way than it took. So the first frames are tracked, some steps
of Gauss–Newton bring one factor near them, and then all values where these are few: so many, from afar, may end in
another minimum. More and more frames follow, each time with the values of those before; in the end all of them by the
values that all have led to. What is matched then is what the fit compares, and it begins with these values, unless its
own start is nearer.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.base.messages import metres, percent
from clothfit.fit import hierarchy
from clothfit.fit.continuation import Even, some_steps
from clothfit.fit.hints import Hint
from clothfit.fit.options import Request
from clothfit.fit.preparation import in_time
from clothfit.fit.result import Fit
from clothfit.fit.routes import best_bendings, shares_of_bending
from clothfit.fit.start import start_of, values_by
from clothfit.fit.trajectory_fit import FIRST_WINDOW, STAGE_TOLERANCE, window_lengths
from clothfit.motion.correspondence import SCANNED, Correspondence
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion, at_frames
from clothfit.motion.simulate import simulate
from clothfit.motion.times import frame_places, interpolated
from clothfit.objective.experiment import Experiment, experiment
from clothfit.objective.objective import Objective
from clothfit.optimise.prior import guard
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status, Stop
from clothfit.registration.tracking import FINE, median_edge, tracked
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.kinds import REST
from clothfit.scene.scene import Scene

Start: TypeAlias = float | Array | Scene | None

STEPS, SAVING = 12, 1e-3
"""Of Gauss–Newton in each window, and the share of the cost that a step must save."""

SAME = 0.01
"""Change of the coordinates of values up to which what was tracked before holds."""

FEW, NEAREST, PART = 12, 0.9, 0.5
"""Values, at most, that are fitted at once; the share of the points, the nearest, by which shapes of cloths at rest are
compared; and the part of the time in which these are tried.
"""

UNTRACKED = (
    "the time was too short to track the scan: all of its points are compared, strangers as well, from the fit's own "
    "start; give it more, --budget"
)

HURRIED = (
    "the time was too short to try all bending stiffnesses whose folds may be those of the scan: the fit begins with "
    "the best of those that were tried; give it more, --budget"
)

LEFT_BEHIND = (
    "the points of the scan go up to {} away from vertices that the scene holds, which do not follow a scan; give "
    "these a motion (pins in the scene, or new --pins-from MOTION), or let them go"
)

MOST = 0.95
"""Quantile of distances that is shown beside their median."""


class Tracks(NamedTuple):
    """Targets whose scans are tracked, and where a fit to them starts."""

    given: list[Experiment]
    start: Start
    text: str = ""  # what was left out, as the time was too short
    places: Sequence[Experiment] = ()  # what `places` has of them


def with_scans(scene: Scene, given: list[Experiment], start: Start, options: Request) -> Tracks:
    """The targets with their scans tracked, as far as half of the time of the fit allows; as they are where that is too
    short.
    """
    if not any(each.motion.correspondence.mesh for each in given):
        return Tracks(given, start)
    seconds = None if options.time_limit is None else 0.5 * options.time_limit
    best = [Tracks(given, start, UNTRACKED)]
    return in_time(partial(tracked_by_values, scene, given, start, options, best), None, seconds) or best[-1]


def tracked_by_values(
    scene: Scene, given: list[Experiment], start: Start, options: Request, best: list[Tracks]
) -> Tracks:
    """The same, however long it takes; the `best` of cloths at rest so far is kept."""
    first = with_parameters(scene, start_of(scene, start))
    few = hierarchy.as_model(first, hierarchy.models(first)[0])
    if scene.method == REST:
        few, found = by_folds(first if len(parameters(first)) <= FEW else few, scene, given, options, best)
    else:
        few, found = by_windows([few, first] if len(parameters(first)) <= FEW else [few], scene, given, options)
    found = own_scenes(found, given)
    whole = objective_of(scene, found, options)
    costs = [whole.cost_or_infinity(parameters(each, flags=scene)) for each in (few, first)]
    nearest, start = (few, few) if costs[0] < costs[1] else (first, start)
    return Tracks(found, start, "", places(nearest, found) if found[0].scene is scene and not scene.frame else ())


def own_scenes(found: Sequence[Experiment], given: Sequence[Experiment]) -> list[Experiment]:
    """What was found of targets, each with the scene that it was given with."""
    return [Experiment(new.motion, own.scene) for new, own in zip(found, given, strict=True)]


def left_behind(given: Sequence[Experiment]) -> list[Hint]:
    """What is said where points of scans begin at held vertices and then are more than an edge away from them."""
    from scipy.spatial import KDTree

    for motion, scene in given:
        scan, held = motion.correspondence, np.concatenate([cloth.fixed for cloth in scene.cloths])
        for i, cloth in enumerate(scene.cloths):
            for pin in cloth.pins:
                held[scene.vertices(i)][pin.vertices] = False
        if scan.mesh is None or scene.frame or not held.any() or not scan.seen.any(axis=1).all():
            continue
        x = np.concatenate([cloth.positions for cloth in scene.cloths])[held]
        edge = median_edge(scene)
        frames = zip(scan.points, scan.seen, strict=True)
        away = [float(np.median(KDTree(points[seen]).query(x)[0])) for points, seen in frames]
        if away[0] <= edge < np.median(away):  # holes in some frames hide them, too
            return [Hint("held_vertices_move", LEFT_BEHIND.format(metres(max(away))))]
    return []


def places(scene: Scene, given: Sequence[Experiment]) -> list[Experiment]:
    """The targets by where their vertices were tracked, in the place of distances, where a scene's motion does not
    explain the first of them; else none.
    """
    if not leaves_more(scene, given[0].motion):
        return []
    return [
        Experiment(replace(motion, correspondence=Correspondence(*motion.correspondence[:2])), own)
        for motion, own in given
    ]


def leaves_more(scene: Scene, motion: Motion) -> bool:
    """Whether the matched points of a tracked scan are farther from the cloth that a scene simulates than noise takes
    them: the variance of their distances is twice that about the cloth that was drawn to them, or more.

    The model then is not the scan's. A cloth would slide along itself to bring points near, and distances do not say
    where along itself it is.
    """
    scan, squares = motion.correspondence, np.zeros(2)
    if scan.mesh is None or scene.method == REST:
        return False
    try:
        x = at_times(scene, motion)
    except Diverged:
        return True
    for frame, both in enumerate(zip(x, motion.positions, strict=True)):
        squares += [float(gaps @ gaps) for gaps in (scan.feet(s, frame).gaps for s in both)]
    return bool(squares[0] >= 2.0 * squares[1])


def at_times(scene: Scene, motion: Motion) -> Array:
    """The positions (F, n, 3), m, of a scene's own motion at the times of another. Raises Diverged."""
    step, fraction = frame_places(motion, scene.delta)
    return interpolated(simulate(scene, int(np.ceil(step + fraction).max()) + 1).positions, step, fraction)


def by_windows(
    models: Sequence[Scene], scene: Scene, given: Sequence[Experiment], options: Request
) -> tuple[Scene, list[Experiment]]:
    """The values that more and more frames lead to, and the targets tracked by them: in the first window those of
    `models` from coarse to fine, then of the last.
    """
    few, *finer = models
    longest, found = max(len(each.motion.times) for each in given), list(given)
    for frames in window_lengths(FIRST_WINDOW, longest):
        found = by(few, scene, given, frames)
        before = few
        few = nearer(few, found, options)
        while finer:
            few = nearer(with_parameters(finer[0], values_by(few, finer.pop(0))), found, options)
    return few, found if few is before else by(few, scene, given, longest)


def by_folds(
    few: Scene, scene: Scene, given: list[Experiment], options: Request, kept: list[Tracks]
) -> tuple[Scene, list[Experiment]]:
    """Values that come nearest to scans of cloths at rest, from those of `few` with other bending stiffnesses, and the
    scans as they are tracked from there: each has folds of its own, and not from all can those of the scan be reached.
    """
    longest, least, best = max(len(each.motion.times) for each in given), np.inf, (few, list(given))
    bends = np.concatenate([shares_of_bending(block) for block in few.blocks])

    def at(factor: float) -> Scene:
        return with_parameters(few, factor**bends * parameters(few))

    factors, near = [1.0], FINE * median_edge(few)
    away = dict[float, float]()

    def measure(factor: float) -> float:
        away[factor] = distance(given, by(at(factor), scene, given, longest, 0))
        return away[factor]

    if bends.any():
        with interrupts.limited(None if options.time_limit is None else PART * PART * options.time_limit):
            factors = best_bendings(measure)
        if away:
            kept.append(Tracks(given, at(factors[0]), HURRIED))
    # what has the folds of the scan already may lose them where it is drawn
    tries = [(factor, rounds) for factor in factors or [1.0] for rounds in (0, None)
             if rounds is None or away.get(factor, np.inf) <= near]  # fmt: skip
    for factor, rounds in tries:
        found = by(at(factor), scene, given, longest, rounds)
        if not np.isfinite(least):
            kept.append(Tracks(own_scenes(found, given), at(factor), HURRIED))
        trial = nearer(at(factor), found, options)
        whole = objective_of(trial, [experiment(trial, *each) for each in found], options)
        cost = whole.cost_or_infinity(parameters(trial)) + unmatched(given, found)
        if cost < least:
            least, best = cost, (trial, found)
            kept.append(Tracks(own_scenes(found, given), trial, HURRIED))
        if whole.rmse(cost) <= SAME * SAME * whole.rms_displacement:
            break
    return best


def distance(given: Sequence[Experiment], found: Sequence[Experiment]) -> float:
    """Root mean square distance, m, of the nearest points of scans from cloths at rest as they were found."""
    squares = [0.0]
    for (motion, _), (own, _) in zip(given, found, strict=True):
        if motion.correspondence.mesh is None:
            continue
        for frame in np.flatnonzero(motion.times > 0).tolist():
            away = np.sort(np.abs(motion.correspondence.feet(own.positions[frame], frame).gaps))
            squares.append(float((away[: int(np.ceil(NEAREST * len(away)))] ** 2).mean()))
    return float(np.sqrt(sum(squares)))


def unmatched(given: Sequence[Experiment], found: Sequence[Experiment]) -> float:
    """What points cost that no place of a cloth was found for, each an edge away, m²."""
    lost = 0.0
    for (motion, _), (own, scene) in zip(given, found, strict=True):
        edge = median_edge(scene)
        if motion.correspondence.mesh:
            lost += edge**2 * float(motion.correspondence.seen.sum() - own.correspondence.seen.sum())
    return lost


def objective_of(scene: Scene, given: Sequence[Experiment], options: Request) -> Objective:
    """The loosely solved objective of targets."""
    return Objective(
        scene, list(given), STAGE_TOLERANCE, [own.frames for _, own in given],
        loss=options.loss, loss_scale=options.loss_scale, memory=options.memory,
    )  # fmt: skip


def with_figures(fit: Fit, raw: Motion, given: Motion) -> Fit:
    """The fit with what it has come to of its first target, where that is a scan, `raw` as it came and `given` as it
    was tracked: how far its points are from the cloth, all of them, and the cloth from the points, and what was never
    seen.
    """
    scan, share = raw.correspondence, given.correspondence.share
    if scan.mesh is None or fit.status == Status.DIVERGED:
        return fit
    try:
        x = at_times(fit.scene, raw)
    except Diverged:
        return fit
    from scipy.spatial import KDTree

    there, back = list[Array](), list[Array]()
    for frame, s in enumerate(x):
        points = scan.points[frame, scan.seen[frame]]
        there.append(np.abs(scan.feet(s, frame).gaps))
        if len(points):
            back.append(np.asarray(KDTree(points).query(s)[0]))
    sides = {"scan_to_cloth": np.concatenate(there), "cloth_to_scan": np.concatenate(back)}
    figures: dict[str, Any] = {
        name: {"median": float(np.median(away)), "most": float(np.quantile(away, MOST))} for name, away in sides.items()
    }
    free = ~np.concatenate([cloth.fixed for cloth in fit.scene.cloths])
    figures["unseen"] = float(1.0 - given.seen()[:, free].any(axis=0).mean()) if free.any() else 0.0
    one, other = (f"{metres(each['median'])} ({metres(each['most'])})" for each in list(figures.values())[:2])
    text = (
        f"scan: {percent(share)} of its points are matched; all are {one} off the cloth, in the median (95 %), and its "
        f"vertices {other} from the points; {percent(figures['unseen'])} of the free vertices were never seen"
    )
    bound = Correspondence(SCANNED, share, figures=figures)
    return replace(fit, correspondence=bound, hints=[*fit.hints, Hint("scan", text, before_fit=False)])


def by(
    few: Scene, scene: Scene, given: Sequence[Experiment], frames: int, rounds: int | None = None
) -> list[Experiment]:
    """The first frames of the targets, tracked by the values of `few`, which takes the place of the main scene."""
    parts = [(at_frames(motion, slice(frames)), few if own is scene else own) for motion, own in given]
    own = [experiment(few, motion, each) for motion, each in parts]
    return [tracked(Experiment(each.motion, with_parameters(each.scene, parameters(few))), rounds) for each in own]


def nearer(few: Scene, given: Sequence[Experiment], options: Request) -> Scene:
    """The scene with the values that some steps lead to; the same object where they change by little, or nothing."""
    objective = objective_of(few, [experiment(few, *each) for each in given], options)
    search = Search(objective, parameters(few), 0.0, options.max_evaluations, options.observer.progress)
    part = Even(search, objective)
    search.enter("tracking")
    y = start = part.y(search.start)
    with suppress(Diverged, Stop), np.errstate(over="ignore", invalid="ignore"):
        y = some_steps(part, start, STEPS, SAVING, prior=guard(start, part.own_widths))
    return few if np.abs(y - start).max(initial=0.0) <= SAME else with_parameters(few, part.parameters(y))
