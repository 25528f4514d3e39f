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
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidMotion
from clothfit.base.limits import FIT_TOLERANCE
from clothfit.base.messages import metres, percent
from clothfit.fit import hierarchy
from clothfit.fit.continuation import LEAST, Even, frame_interval, in_frames, some_steps, with_nudging
from clothfit.fit.few_values import LOUDER
from clothfit.fit.hints import Hint
from clothfit.fit.options import Request
from clothfit.fit.preparation import counts_of, in_time
from clothfit.fit.result import Fit
from clothfit.fit.routes import BENDINGS, of_few_kinds, shares_of_bending
from clothfit.fit.start import start_of, values_by
from clothfit.fit.trajectory_fit import FIRST_WINDOW
from clothfit.motion.correspondence import SCANNED, Correspondence, weights_of_corners
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion, at_frames
from clothfit.motion.simulate import simulate
from clothfit.motion.times import frame_places, interpolated
from clothfit.objective.experiment import Experiment, experiment
from clothfit.objective.objective import Objective
from clothfit.optimise.prior import first, guard
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status, Stop
from clothfit.registration.tracking import FINE, MOSTLY, TRIM, median_edge, tracked
from clothfit.scene.cloth import together
from clothfit.scene.directions import edges_of
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.kinds import REST
from clothfit.scene.scene import Scene, with_places

Start: TypeAlias = float | Array | Scene | None

STEPS = 12
"""Of Gauss–Newton in each window, at most. Each must save the variance of what is left: what noise leaves uncertain."""

SIMPLEX, FLAT, MOST_COSTS = 2.0, 3e-3, 50
"""Size of the first simplex, as far as a start may be off, of the last one, and costs for each value, at most."""

GROWTH, SLOWEST = 1.5, 1.2
"""Ratio of a window to the one before: a cloth in wind makes much of a thousandth. Its root where a window leaves more
than noise though the one before did not, unless it is below the second, until one does even so.
"""

FEW, FEWEST, PART = 12, 4, 0.5
"""Values, at most, that are fitted at once, and for which a simplex is cheap; and the part of the time in which cloths
at rest are drawn.
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

FOLDS = (
    "the cloth {}: points are {} off it (RMS), of which {} are noise, so its values mean little; scan all of the hem, "
    "take a finer mesh, or begin with values that are nearer (--start, new --fabric)"
)

ELSEWHERE = (
    "{}: a quarter of its points are {} or more off the cloth even after it was drawn to them: cut away what is not "
    "cloth, as a table or a pedestal, and check its unit and axes (--scale, --up)"
)

OWN_FOLDS = (
    "the shape was found from the scan; simulate, which begins elsewhere, ends in other folds with these values, up to "
    "{} away"
)

CLEARLY, SIGNIFICANT, VISIBLE, PROMINENT = 0.1, 5.0, 1e-3, 0.1
"""Squares above those of noise that count as a difference, standard deviations of these, and distance in median edges;
how far a fold of a hem comes out, as a share of the farthest.
"""

REACHES = (0.1, 0.3, 1.0, 3.0)
"""How far its weight would take a cloth that is pulled to where it was drawn, in edges, one after the other."""

MOST_TRIES, SAME_SHAPE, FAR_OFF = 6, 1e-3, 9.0
"""Shapes of what a scan does not show that are let go, at most; difference of their distances, relative, within which
they are one; and mean square distance of a vertex, in squares of the median, from which on it misses its points.
"""

MOST = 0.95
"""Quantile of distances that is shown beside their median."""


class Tracks(NamedTuple):
    """Targets whose scans are tracked, and where a fit to them starts."""

    given: list[Experiment]
    start: Start
    text: str = ""  # what was left out, as the time was too short
    places: Sequence[Experiment] = ()  # what `places` has of them
    substeps: int | None = None  # steps to a frame that explain the scans, where those of the scene end between frames


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
    """The same, however long it takes; the `best` of cloths at rest so far is kept. Where the fit may choose its steps,
    those of the cloth that is tracked end at frames, and are no longer than the scene's.
    """
    own, raw = scene, given
    if scene.method != REST and counts_of(options, scene) and not isinstance(options.substeps, int):
        scene = in_frames(scene, given[0])
        given = [Experiment(motion, scene if made is own else made) for motion, made in given]
    first = with_parameters(scene, start_of(scene, start))
    few = hierarchy.as_model(first, hierarchy.models(first)[0])
    if scene.method == REST:
        few, found = by_folds(first if len(parameters(first)) <= FEW else few, scene, given, options, best)
    else:
        models = [few, first] if len(parameters(first)) <= FEW else [few]
        fewest = [of_few_kinds(first, parameters(first))] if options.auto else []
        few, found = by_windows([*fewest, *models], scene, given, options)
    found = own_scenes(found, given)
    whole = objective_of(scene, found, options)
    costs = [whole.cost_or_infinity(parameters(each, flags=scene)) for each in (few, first)]
    nearest, start = (few, few.with_step(own.delta, own.frames)) if costs[0] < costs[1] else (first, start)
    shown = places(nearest, found) if raw[0].scene is own and not own.frame else ()
    steps = None if shown or np.isclose(scene.delta, own.delta) else round(frame_interval(given[0]) / scene.delta)
    return Tracks(own_scenes(found, raw), start, "", own_scenes(shown, raw) if shown else (), steps)


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
    """Whether the cloth that a scene simulates misses the matched points of a tracked scan by more than noise does."""
    return is_more(left_over(scene, motion), scene)


def is_more(left: Array, scene: Scene, noise: float = np.inf) -> bool:
    """Whether what is `left_over` is more than noise leaves: twice the variance about the cloth that was drawn to the
    points, or more, or clearly above that of earlier frames, `noise`, m².

    The model then is not the scan's. A cloth would slide along itself to bring points near, and distances do not say
    where along itself it is.
    """
    free, drawn = left
    return bool(free >= 2.0 * drawn or free > max(LOUDER**2 * noise, (VISIBLE * median_edge(scene)) ** 2))


def left_over(scene: Scene, motion: Motion) -> Array:
    """The mean square distances (2,), m², of nearly all matched points of a tracked scan from the cloth that a scene
    simulates, infinite where that diverges, and from the one that was drawn to them: a few are no points of the cloth.
    Where no cloth was drawn, and of cloth at rest, nothing is left.
    """
    scan, squares = motion.correspondence, np.zeros(2)
    if scan.mesh is None or scene.method == REST:
        return np.array([0.0, np.inf])
    try:
        x = at_times(scene, motion)
    except Diverged:
        return np.array([np.inf, 0.0])
    for frame, both in enumerate(zip(x, motion.positions, strict=True)):
        away = np.sort(np.abs([scan.feet(s, frame).gaps for s in both]))
        squares += (away[:, : int(MOST * away.shape[1])] ** 2).sum(axis=1)
    return squares / max(float(MOST * scan.seen.sum()), 1.0)


def at_times(scene: Scene, motion: Motion) -> Array:
    """The positions (F, n, 3), m, of a scene's own motion at the times of another. Raises Diverged."""
    step, fraction = frame_places(motion, scene.delta)
    steps = int(np.ceil(step + fraction).max())
    return interpolated(simulate(scene, steps + 1, FIT_TOLERANCE).positions, step, fraction)


def by_windows(
    models: Sequence[Scene], scene: Scene, given: Sequence[Experiment], options: Request
) -> tuple[Scene, list[Experiment]]:
    """The values that more and more frames lead to, and the targets tracked by them: those of `models` from coarse to
    fine, each from the first window on that the one before leaves more than noise of.
    """
    few, *finer = models
    longest, reached, growth, noise, sure = max(len(each.motion.times) for each in given), 0, GROWTH, np.inf, False
    while reached < longest:
        frames = next_window(reached, longest, growth)
        found, before = by(few, scene, given, frames), few
        far = noise == np.inf and leaves_more(few, found[0].motion)
        trial = nearer(few, found, options, far=far)
        left = left_over(trial, found[0].motion)
        explained, sure = sure, not is_more(left, trial, noise)
        shorter = next_window(reached, longest, growth**0.5)
        if explained and not sure and growth > SLOWEST and shorter < frames:
            growth, sure = growth**0.5, True
            continue
        few, reached, growth = trial, frames, growth if sure else GROWTH
        while finer and not sure:
            few = nearer(with_parameters(finer[0], values_by(few, finer.pop(0))), found, options, far=far)
            left = left_over(few, found[0].motion)
            sure = not is_more(left, few, noise)
        if sure:
            noise = min(noise, float(left[0]))
    return few, found if few is before else by(few, scene, given, longest)


def next_window(frames: int, longest: int, growth: float) -> int:
    """Frames of the window after one of so many; the last may be a little longer than others."""
    new = max(int(frames * growth), frames + 1) if frames else FIRST_WINDOW
    return new if new * growth**0.5 < longest else longest


def by_simplex(part: Even, y: Array) -> Array:
    """Where the method of Nelder and Mead leads from y (Q,): few values whose cost is rough, as that of a cloth that
    buckles, where slopes lead nowhere (J. A. Nelder, R. Mead, A simplex method for function minimization, 1965).
    """
    from scipy.optimize import minimize

    first, minimizer = np.vstack([y, y + SIMPLEX * np.eye(part.size)]), cast(Any, minimize)  # as in `scipy_methods`
    ends = {"initial_simplex": first, "xatol": FLAT, "fatol": FLAT**2 * part.cost(y), "maxfev": MOST_COSTS * part.size}
    return np.asarray(np.clip(minimizer(part.cost, y, method="Nelder-Mead", options=ends).x, *part.bounds))


def by_folds(
    few: Scene, scene: Scene, given: list[Experiment], options: Request, kept: list[Tracks]
) -> tuple[Scene, list[Experiment]]:
    """Values that come nearest to scans of cloths at rest, and the scans as they are tracked from there.

    Cloths that hang by other bending stiffnesses are drawn to the scan: not from the folds of all can those of the scan
    be reached, and in what it does not show they end in folds of their own. Those that come nearest are then let go,
    pulled to where they were drawn more and more weakly, and drawn anew, while the values are fitted: so they stay in
    the scan's folds. One that is farther off than another is without a pull cannot become the nearest.
    """
    longest = max(len(each.motion.times) for each in given)
    bends = np.concatenate([shares_of_bending(block) for block in few.blocks])
    hung, trials, tries = (list[tuple[float, Scene, list[Experiment]]]() for _ in range(3))

    def hang(factor: float) -> None:
        trial = with_parameters(few, factor**bends * parameters(few))
        free = by(trial, scene, given, longest, 0)
        found = [tracked(each) for each in held(trial, scene, given, free, np.inf)]
        for every, own in ((hung, free), (trials, found)):
            every.append((distance(given, own), trial, own))
            every.sort(key=lambda each: each[0])
        kept.append(Tracks(own_scenes(trials[0][2], given), hung[0][1], HURRIED))

    hang(1.0)
    seconds = None if options.time_limit is None else PART * PART * options.time_limit
    with suppress(interrupts.OutOfTime), interrupts.limited(seconds):
        for factor in BENDINGS[1:] if bends.any() else ():
            hang(factor)
    check_near(given, trials[0][2])
    about = hung[0][1]
    found = mended(about, [own for _, _, own in trials], scene, given)
    few, found, _ = let_go(about, found, scene, given, REACHES[0], options, about)
    for _, _, others in trials:
        mixed = [with_parts(own, other, ~own.motion.seen()[-1]) for own, other in zip(found, others, strict=True)]
        free = [tracked(each, 0) for each in held(few, scene, given, mixed, REACHES[0])]
        tries.append((distance(given, free), few, free))
    tries.sort(key=lambda each: each[0])
    tries = [each for k, each in enumerate(tries) if not k or each[0] > (1.0 + SAME_SHAPE) * tries[k - 1][0]]
    least, best = np.inf, (few, found)
    for away, trial, free in tries[:MOST_TRIES]:
        for reach in (*REACHES, np.inf):
            trial, free, away = let_go(trial, free, scene, given, reach, options, about)
            if not away < least:
                break
        else:
            least, best = away, (trial, free)
            kept.append(Tracks(own_scenes(free, given), trial, HURRIED))
    return best


def check_near(given: Sequence[Experiment], tracks: Sequence[Experiment]) -> None:
    """Raise InvalidMotion where most points of a scan are more than an edge off a cloth that was drawn to them."""
    for (motion, scene), (own, _) in zip(given, tracks, strict=True):
        if motion.correspondence.mesh is not None:
            away = np.abs(motion.correspondence.feet(own.positions[-1], len(motion.times) - 1).gaps)
            far = float(np.quantile(away, MOSTLY))
            if far > median_edge(scene):
                raise InvalidMotion(ELSEWHERE.format(motion.name, metres(far)))


def mended(
    few: Scene, shapes: Sequence[list[Experiment]], scene: Scene, given: Sequence[Experiment]
) -> list[Experiment]:
    """The first of the shapes to which cloths were drawn, by the values of `few`; but where points are much farther off
    than others, as in another one, as long as that brings them nearer.
    """
    found = shapes[0]
    away = distance(given, found)
    for others in shapes[1:]:
        mixed = [
            with_parts(own, other, misses(raw.motion, own.motion))
            for raw, own, other in zip(given, found, others, strict=True)
        ]
        drawn = [tracked(each) for each in held(few, scene, given, mixed, REACHES[0])]
        if (near := distance(given, drawn)) < away:
            away, found = near, drawn
    return found


def with_parts(own: Experiment, other: Experiment, which: Flags) -> Experiment:
    """A shape with some vertices (n,) where another has them."""
    x = own.motion.positions.copy()
    x[-1, which] = other.motion.positions[-1, which]
    return Experiment(replace(own.motion, positions=x), own.scene)


def misses(raw: Motion, found: Motion) -> Flags:
    """The vertices (n,) whose points in the last frame of a scan are much farther off than all."""
    scan, frame, x = raw.correspondence, len(raw.times) - 1, found.positions[-1]
    if scan.mesh is None:
        return np.zeros(len(x), bool)
    feet = scan.feet(x, frame)
    squares = squares_of(feet.gaps)
    weights = weights_of_corners(scan.mesh.triangles[feet.faces], feet.weights, len(x))
    return np.asarray(weights.T @ squares > FAR_OFF * np.median(squares) * weights.sum(axis=0))


def held(
    few: Scene, scene: Scene, given: Sequence[Experiment], found: Sequence[Experiment], reach: float
) -> list[Experiment]:
    """Scans in scenes that begin where cloths were `found`, and pull what was seen there, so that their weight would
    take them so many edges away; infinite: not at all.
    """
    made = list[Experiment]()
    for (raw, own), (motion, _) in zip(given, found, strict=True):
        place = with_places(few if own is scene else own, motion.positions[-1])
        if np.isfinite(reach) and motion.correspondence.mesh is not None:
            omega = float(np.sqrt(np.linalg.norm(own.gravity) / (reach * median_edge(own))))
            place = with_nudging(place, motion, omega)
        there = experiment(few, raw, place)
        made.append(Experiment(there.motion, with_parameters(there.scene, parameters(few))))
    return made


def let_go(
    few: Scene, found: Sequence[Experiment], scene: Scene, given: Sequence[Experiment], reach: float, options: Request,
    about: Scene,
) -> tuple[Scene, list[Experiment], float]:  # fmt: skip
    """Values, from those of `few`, that bring cloths that are `held` near their scans, and are near those of `about`
    where little shows them; where the cloths are drawn from there, or hang where nothing pulls; and their distance, m,
    before they are drawn.
    """
    parts = held(few, scene, given, found, reach)
    pulled = [Experiment(each.motion, own) for each, (_, own) in zip(found, parts, strict=True)]
    few = nearer(few, pulled, options, about, bool(np.isfinite(reach)))
    parts = held(few, scene, given, found, reach)
    free = [tracked(each, 0) for each in parts]
    away = distance(given, free)
    return few, [tracked(each) for each in parts] if np.isfinite(reach) else free, away


def distance(given: Sequence[Experiment], found: Sequence[Experiment]) -> float:
    """Root mean square distance, m, of the points of scans from cloths at rest as they were found; outliers count as
    far as what begins them.
    """
    squares = [0.0]
    for (motion, _), (own, _) in zip(given, found, strict=True):
        if motion.correspondence.mesh is None:
            continue
        for frame in np.flatnonzero(motion.times > 0).tolist():
            feet = motion.correspondence.feet(own.positions[frame], frame)
            squares.append(float(squares_of(feet.gaps).mean()))
    return float(np.sqrt(sum(squares)))


def squares_of(gaps: Array) -> Array:
    """Squares of distances (m,), m², of which those of outliers are what begins them."""
    away = np.abs(gaps)
    return np.asarray(np.minimum(away, TRIM * np.median(away)) ** 2)


def objective_of(scene: Scene, given: Sequence[Experiment], options: Request) -> Objective:
    """The objective of targets."""
    return Objective(
        scene, list(given), options.tolerance, [own.frames for _, own in given],
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

    if fit.scene.method == REST:
        own = partial(held, fit.scene, fit.scene, [Experiment(raw, fit.scene)], [Experiment(given, fit.scene)])
        hung, drawn = tracked(own(np.inf)[0], 0).motion, tracked(own(REACHES[0])[0]).motion
        away = float(np.linalg.norm(x[-1] - hung.positions[-1], axis=1).max())
        if away > FINE * median_edge(fit.scene):
            fit = replace(fit, hints=[*fit.hints, Hint("own_folds", OWN_FOLDS.format(metres(away)), before_fit=False)])
        fit, x = with_folds(fit, raw, hung, drawn), hung.positions

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


def with_folds(fit: Fit, raw: Motion, hung: Motion, drawn: Motion) -> Fit:
    """The fit of a cloth at rest as stalled, with what it looks like beside the cloth that was drawn to the scan, where
    points of the scan that are neighbours are off it alike: of noise, which is new in each point, half the mean square
    of their differences is the variance.
    """
    from scipy.spatial import KDTree

    scan, frame, x = raw.correspondence, len(raw.times) - 1, hung.positions[-1]
    feet = scan.feet(x, frame)
    near = np.abs(feet.gaps) <= TRIM * np.median(np.abs(feet.gaps))
    gaps = feet.gaps[near]
    if fit.status != Status.CONVERGED or len(gaps) < 2:
        return fit
    places = (scan.points[frame, scan.seen[frame]] + feet.gaps[:, None] * feet.normals)[near]
    change = gaps - gaps[np.asarray(KDTree(places).query(places, k=2)[1])[:, 1]]
    whole, noise = float((gaps**2).mean()), 0.5 * float((change**2).mean())
    clearly = (1.0 + max(CLEARLY, SIGNIFICANT / np.sqrt(len(gaps)))) * noise
    if whole <= clearly + (VISIBLE * median_edge(fit.scene)) ** 2:
        return fit
    own, other = folds(fit.scene, x), folds(fit.scene, drawn.positions[-1])
    how = f"drapes in {own} folds, in the scan in {other}" if own != other else "drapes in other folds than the scan"
    text = FOLDS.format(how if own else "hangs otherwise than the scan", metres(np.sqrt(whole)), metres(np.sqrt(noise)))
    return replace(fit, status=Status.STALLED, hints=[*fit.hints, Hint("folds", text, before_fit=False)])


def folds(scene: Scene, x: Array) -> int:
    """In how many folds the hem of a cloth at x (n, 3), m, hangs around what is held; 0 where it does not go around."""
    from scipy.signal import find_peaks

    whole = together(scene.cloths)
    start, held, hem = whole.positions, whole.fixed, edges_of(whole.triangles).hem
    down = scene.gravity / max(float(np.linalg.norm(scene.gravity)), 1e-300)
    level = np.linalg.svd(down[None])[2][1:]  # two directions across the weight
    if not held.any() or held[hem].any():
        return 0
    middle = start[held].mean(axis=0)
    there = (start[hem] - middle) @ level.T
    angle = np.arctan2(*there.T)
    order = np.argsort(angle)
    if np.diff(angle[order], append=angle[order[0]] + 2 * np.pi).max() > 0.5 * np.pi:
        return 0
    away = np.linalg.norm((x[hem[order]] - middle) @ level.T, axis=1)
    least = int(away.argmin())
    around = np.roll(away, -least)
    return len(find_peaks(np.append(around, around[0]), prominence=PROMINENT * float(np.ptp(away)))[0])


def by(
    few: Scene, scene: Scene, given: Sequence[Experiment], frames: int, rounds: int | None = None
) -> list[Experiment]:
    """The first frames of the targets, tracked by the values of `few`, which takes the place of the main scene."""
    parts = [(at_frames(motion, slice(frames)), few if own is scene else own) for motion, own in given]
    own = [experiment(few, motion, each) for motion, each in parts]
    return [tracked(Experiment(each.motion, with_parameters(each.scene, parameters(few))), rounds) for each in own]


def nearer(
    few: Scene, given: Sequence[Experiment], options: Request, about: Scene | None = None, pulled: bool = False,
    far: bool = False,
) -> Scene:  # fmt: skip
    """The scene with the values that some steps lead to; the same object where none is taken. What is hardly shown
    stays near those of `about`, by default its own; where cloths are `pulled`, as in continuation. From values that are
    `far` off, where distances of cloths that buckle otherwise are rough, few go where a simplex leads, too.
    """
    objective = objective_of(few, [experiment(few, *each) for each in given], options)
    search = Search(objective, parameters(few), 0.0, options.max_evaluations, options.observer.progress)
    part = Even(search, objective)
    search.enter("tracking")
    y = start = part.y(search.start)
    with suppress(Diverged, Stop), np.errstate(over="ignore", invalid="ignore"):
        centre = start if about is None else part.y(parameters(about))
        doubt = first(centre, [np.arange(part.size, dtype=np.int32)], (LEAST * part.residuals()) ** -0.5)
        prior = doubt if pulled else guard(centre, part.own_widths)
        steps = partial(some_steps, part, most=STEPS, saving=1.0 / part.residuals(), prior=prior)
        y = steps(start)
        if far and part.size <= FEWEST:
            y = steps(by_simplex(part, y))
    return few if np.array_equal(y, start) else with_parameters(few, part.parameters(y))
