"""Hints after a fit whose model differs: what of the residuals another clock, another place, or two vertices that are
mistaken for each other would explain (`attribution`). And what to do where a search has stalled: contacts
that switch, folds that buckle to another side and steps that the guard shortens let the error jump from one value to
the next, and no search by gradients comes down there but from near.

How much of what a fit leaves another clock or another place would explain.

Near the result the cost is |r|² + 2 gᵀz + zᵀH z in the values and the coordinates of a registration. What one kind of
registration saves beyond what the values save alone, relative to the cost, is the share of the squares that it
promises to explain. As that is linear, a few steps of Gauss–Newton then show what it does explain. Places are judged by
weighted residuals, as in `fit.registration`: what is held must not move away from where it is held.

What a fit must beat: the best still picture of its target, and the scene as it came.

The still picture has each vertex at the mean of the compared frames, which no other picture comes nearer than; where
what is held moves on, as on a body that walks, a picture that is carried along may be nearer. Its squares are those of
the motion. A model that leaves more of them than it explains, the half, is not one of that motion: the fit fails,
whatever the search says of its end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.base.messages import listed, metres
from clothfit.derivative.adjoint import Observer
from clothfit.engine.rollout import Rollout
from clothfit.engine.system import mobile
from clothfit.engine.tape import Tape
from clothfit.fit.hints import Hint
from clothfit.fit.registered_fit import cut, few
from clothfit.fit.registration import OFFSET, PLACE, RATE, RATES, THETA, Unknowns, descended, weighted
from clothfit.fit.result import ADEQUATE, FAILS, NEGLIGIBLE, Baselines, Fit, Verdict, without_intervals
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import in_groups
from clothfit.objective.comparison import Loss
from clothfit.objective.experiment import Experiment
from clothfit.objective.measures import Cloud
from clothfit.objective.objective import Objective
from clothfit.objective.run import Run, play
from clothfit.objective.target import Frames, sample
from clothfit.optimise import trust_region
from clothfit.optimise.gauss_newton import Model
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status
from clothfit.registration.mislabelled import EXCHANGE, MOST_MISLABELLED
from clothfit.registration.record import Registration
from clothfit.scene.fit_vector import bounds, parameters
from clothfit.scene.kinds import AUTO, REST
from clothfit.scene.scene import Scene

STEPS = 5
"""Steps of Gauss–Newton."""

KINDS = {"offset": slice(OFFSET, OFFSET + 1), "rate": slice(RATE, RATE + 1), "placement": PLACE}
"""The coordinates of each kind of registration."""


class Attribution(NamedTuple):
    """What one kind of registration explains."""

    what: str  # one of `KINDS`
    share: float  # of the squares that the values leave, weighted for a place
    registration: Registration  # of the first target


def promised(scene: Scene, given: Sequence[Experiment], loss: Loss) -> dict[str, float]:
    """The share of the squares that each kind promises to explain. Raises Diverged."""
    plain = few(scene, given, np.ones(THETA, bool), loss)
    models = [each.model(each.here) for each in (plain, weighted(plain))]
    found, values = dict[str, float](), len(plain.p)
    for what, part in KINDS.items():
        model = models[what == "placement"]
        own = np.arange(len(model.g)) < values
        base = model.cost - saving(model, own)
        moved = np.zeros(THETA, bool)
        moved[part] = True
        free = np.concatenate([own[:values], np.tile(moved, len(given))])
        found[what] = 1.0 - (model.cost - saving(model, free)) / base if base > 0 else 0.0
    return found


def saving(model: Model, free: Flags) -> float:
    """What the best step of some coordinates saves of a cost."""
    H, g = model.H[np.ix_(free, free)], model.g[free]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), np.finfo(float).tiny))
    step = scale * trust_region.within(trust_region.Quadratic(H * np.outer(scale, scale), g * scale))
    return -float(2.0 * g @ step + step @ H @ step)


def at_other_rates(scene: Scene, given: Sequence[Experiment], loss: Loss) -> Unknowns | None:
    """Where values of a scene and a clock far from the given one begin; None where no such clock is nearer with these
    values.
    """
    plain = few(scene, given, np.ones(THETA, bool), loss)
    tries = {rate: plain.at(plain.p, [Registration(rate=rate)] * len(given)) for rate in RATES}
    best = min(tries, key=lambda rate: tries[rate].cost())
    return None if best == 1.0 else tries[best]


def attribution(
    scene: Scene, given: Sequence[Experiment], loss: Loss, what: str, begun: Unknowns | None = None
) -> Attribution | None:
    """What one kind of registration explains of the residuals, from there or from where `begun`; None where the motion
    diverges.
    """
    before = few(scene, given, np.ones(THETA, bool), loss)
    try:
        before = weighted(before) if what == "placement" else before
    except Diverged:
        return None
    cost, after = before.cost(), descended((begun or before).only(KINDS[what]), STEPS)
    return Attribution(what, 1.0 - after.cost() / cost, after.registrations[0]) if 0 < cost < np.inf else None


LEAST_CLOCK, LEAST_PLACE = 0.5, 0.3
"""Share of the squares that a clock, or a place, must explain: a clock makes up for a part of any wrong model."""

WORSE = 9.0
"""Squares of a vertex relative to the median from which on it may be mistaken for another."""

FLAT = 1e-3
"""Extent of a scene's start across the plane in which it lies, relative to that along it."""

CERTAIN = 0.9
"""Share of the squares from which on nothing else is tried."""

PROMISED = 0.35
"""Share of the squares that a clock must promise to be tried."""

LONGEST = 5.0
"""Seconds for these hints."""

SHIFT, JUMP = 1e-6, 1e-2
"""A relative change of all values, and that of the error, above which this counts as a jump."""

FLOOR, CLOSER, MOST_POSITIONS = 3.0, 0.1, 1_000_000
"""Error, relative to what other tolerances change, up to which it is at their floor; of these the factor; and positions
that are compared, at most.
"""

CODES = {"offset": "time_offset", "rate": "time_scale", "placement": "placement"}
"""Codes of the hints."""


def with_residual_hints(fit: Fit, objective: Objective) -> Fit:
    """The fit with hints from its residuals, where its model differs and positions are compared; with those that were
    found where the time for them ends. Windows show no clock and no place.
    """
    fit = replace(fit, hints=[*fit.hints, *from_gravity(fit, objective.scene)])
    if fit.verdict is None or not fit.verdict.differs or list(objective.weights) != ["position"]:
        return fit
    said, more = {hint.code for hint in fit.hints}, list[Hint]()
    # the others know axes that stand still, and times
    framed = objective.scene.method == REST or any(each.scene.frame for each in objective.experiments)
    looks: list[Callable[..., Iterable[Hint]]] = [from_exchange]
    if not framed and fit.windows is None:
        looks += [from_registration, from_mirror]
    try:
        with interrupts.limited(LONGEST):
            for look in looks:
                more.extend(look(fit, objective, said))
    except (Diverged, interrupts.OutOfTime):
        pass
    return replace(fit, hints=[*fit.hints, *more])


def from_gravity(fit: Fit, came: Scene) -> Iterator[Hint]:
    """Is gravity that was fitted nearer to what a clock of half or double the rate makes of the scene's than to it?"""
    known, found = (float(np.linalg.norm(scene.gravity)) for scene in (came, fit.scene))
    if known and found and not 0.5 <= (rate := known / found) <= 2.0:
        text = f"gravity is fitted as {found:.3g} m/s² instead of {known:.3g}: a clock with the rate {rate**0.5:.2g}"
        text += " would look the same; say the frame rate (--fps), or fit no gravity, with --fit-time"
        yield Hint(CODES["rate"], text, before_fit=False)


def from_registration(fit: Fit, objective: Objective, said: set[str]) -> Iterator[Hint]:
    """Would another clock, or another place, explain what is left? Offset and rate look alike: of both, the better
    one.
    """
    clock, place = CODES["rate"] not in said, CODES["placement"] not in said
    if not (clock or place):
        return
    unmoved, best = [Registration()] * len(objective.experiments), None
    given = cut(objective.experiments, unmoved, objective.scene, fit.scene)
    shares = promised(fit.scene, given, objective.loss)
    alike = objective.scene.mode("gravity") != "n"  # less gravity, a slower clock
    own = cut(objective.experiments, unmoved, objective.scene, objective.scene)
    far = at_other_rates(objective.scene, own, objective.loss) if clock and not alike else None
    promising = {**shares, "rate": np.inf} if far else shares
    for what in sorted(("offset", "rate") if clock else (), key=lambda each: -promising[each]):
        begun = far if what == "rate" else None
        hopeless = shares[what] < PROMISED and begun is None
        if hopeless or (alike and what == "rate") or (best is not None and best.share >= CERTAIN):
            continue
        try:
            each = attribution(fit.scene, given, objective.loss, what, begun)
        except interrupts.OutOfTime:
            break
        best = each if best is None or (each is not None and each.share > best.share) else best
    if best is not None and best.share >= LEAST_CLOCK:
        yield hint_of(best)
    if place and shares["placement"] >= LEAST_PLACE:
        moved = attribution(fit.scene, given, objective.loss, "placement")
        if moved is not None and moved.share >= LEAST_PLACE:
            yield hint_of(moved)


def from_mirror(fit: Fit, objective: Objective, said: set[str]) -> Iterator[Hint]:
    """Would the mirror image of a target explain it, where the scene begins in a plane, so that no first frame shows on
    which side of it the target goes on?
    """
    scene = objective.scene
    start = np.concatenate([cloth.positions for cloth in scene.cloths])
    middle, (_, sizes, axes) = start.mean(axis=0), np.linalg.svd(start - start.mean(axis=0), full_matrices=False)
    if CODES["placement"] in said or not sizes[-1] <= FLAT * sizes[0]:
        return
    mirror, came = np.eye(3) - 2.0 * np.outer(axes[-1], axes[-1]), objective.experiments
    seen = [Experiment(motion.moved(lambda x: (x - middle) @ mirror + middle), own) for motion, own in came]
    nothing, unmoved = np.zeros(THETA, bool), [Registration()] * len(seen)
    given, own = (cut(each, unmoved, scene, made) for each, made in ((seen, scene), (came, fit.scene)))
    cost = few(fit.scene, own, nothing, objective.loss).cost()
    share = 1.0 - descended(few(scene, given, nothing, objective.loss), STEPS).cost() / cost if cost > 0 else 0.0
    if share >= LEAST_CLOCK:
        text = f"the target seen in a mirror would explain {100 * share:.0f} % of what is left (of its squares)"
        text += ": look at --handedness, with --fit-placement where that turns it"
        yield Hint("handedness", text, before_fit=False)


def hint_of(each: Attribution) -> Hint:
    """The hint on what a registration explains."""
    found, part = each.registration, f"would explain {100 * each.share:.0f} % of what is left (of its squares)"
    if each.what == "offset":
        when = "later" if found.offset > 0 else "earlier"
        text = f"a target that begins {abs(found.offset):.2g} s {when} {part}; use --fit-time"
    elif each.what == "rate":
        text = f"a clock with the rate {found.rate:.3g} {part}; use --fit-time, or say the frame rate (--fps)"
    else:
        away = metres(float(np.linalg.norm(found.translation)))
        text = f"a target that is turned, and moved by {away}, {part}; use --fit-placement"
    return Hint(CODES[each.what], text, before_fit=False)


def from_exchange(fit: Fit, objective: Objective, said: set[str]) -> list[Hint]:
    """Are two vertices each where the other one should be, all the time?"""
    if "swapped_markers" in said:
        return []
    p = parameters(fit.scene, objective.scene)
    for run in objective.runs:
        if isinstance(run.comparison.surface, Cloud):
            continue
        every = Distances(run, np.arange(len(run.system.x0)), crossed=False)
        objective.simulate(run, p, every.update)
        squares = every.mean().ravel()
        far = np.flatnonzero(squares > WORSE * np.nanmedian(squares))
        if not 2 <= len(far) <= MOST_MISLABELLED:
            continue
        some = Distances(run, far, crossed=True)
        objective.simulate(run, p, some.update)
        if (pair := exchanged(some.mean())) is not None:
            (i, a), (j, b) = (run.scene.place_of(run.cloth, int(each)) for each in sorted(far[k] for k in pair))
            which = f"objects[{i}]: vertices {a} and {b}" if i == j else f"{a} of objects[{i}] and {b} of objects[{j}]"
            text = (
                f"{which} of the target lie where the other one should; exchange them, or mark them as not observed"
            )
            return [Hint("swapped_markers", text, before_fit=False)]
    return []


def exchanged(squares: Array) -> tuple[int, int] | None:
    """The two of some vertices that are nearest to each other's targets, where hardly anything is left then; `squares`
    (k, k) are of the distances from the motion of one to the target of the other.
    """
    own = np.diag(squares)
    left = (squares + squares.T) / (own[:, None] + own[None])
    np.fill_diagonal(left, np.inf)
    left[np.isnan(left)] = np.inf
    i, j = np.unravel_index(int(np.argmin(left)), left.shape)
    return (int(i), int(j)) if left[i, j] < EXCHANGE else None


class Distances:
    """The squared distances of the motion of some vertices from their targets, or from each other's."""

    def __init__(self, run: Run, vertices: NDArray[np.intp], crossed: bool) -> None:
        """`vertices` (k,); `crossed`: from the targets of all of them."""
        self.frames, self.vertices, self.crossed = Frames(run.comparison.goal), vertices, crossed
        shape = (len(vertices), len(vertices) if crossed else 1)
        self.squares, self.count = np.zeros(shape), np.zeros(shape)

    def update(self, chunk: Rollout) -> None:
        """Take the next chunk of a motion."""
        frames = self.frames.of(chunk)
        goal = self.frames.cut(frames, chunk)
        for s, target, seen in zip(sample(goal, chunk.x), goal.positions, goal.observed, strict=True):
            axis = 0 if self.crossed else 1  # of the targets, beside those of the motion
            here, there = seen[self.vertices][:, None], np.expand_dims(seen[self.vertices], axis)
            gaps = s[self.vertices][:, None] - np.expand_dims(target[self.vertices], axis)
            both = np.broadcast_to(here & there, self.squares.shape)
            self.squares += np.where(both, (np.where(both[..., None], gaps, 0.0) ** 2).sum(axis=2), 0.0)
            self.count += both

    def mean(self) -> Array:
        """Their means (k, k), or (k, 1), m²; NaN where nothing was seen."""
        return np.asarray(np.where(self.count > 0, self.squares / np.maximum(self.count, 1), np.nan))


def with_floor(fit: Fit, objective: Objective) -> Fit:
    """The fit as converged where what it leaves is no more than the tolerance of the linear systems leaves of its
    motion, which buckles or meets something: that is no noise, so it shows nothing that is hidden.
    """
    doubted = fit.status == Status.STALLED or any(hint.code == "hidden" for hint in fit.hints)
    left = fit.relative_rmse
    if not (doubted and left and left <= NEGLIGIBLE) or fit.single_steps or objective.observations > MOST_POSITIONS:
        return fit
    p, closer = parameters(fit.scene, objective.scene), CLOSER * objective.tolerance
    try:
        both = (each.positions(p) for each in (objective, objective.until(objective.steps + 1, closer)))
        pairs = list(zip(objective.runs, *both, strict=True))
    except Diverged:
        return fit
    squares = sum(float(((x - other)[run.comparison.goal.step] ** 2).sum()) for run, x, other in pairs)
    away = float(np.sqrt(squares / max(objective.observations, 1)))
    if fit.rmse > FLOOR * away:
        return fit
    text = (
        f"the error is at the floor of the tolerance, {objective.tolerance:g}: solved ten times as exactly, the same "
        f"values move the cloth by {metres(away)} (RMS), so no search brings it nearer"
    )
    hints = [*(hint for hint in fit.hints if hint.code != "hidden"), Hint("floor", text, before_fit=False)]
    status = Status.CONVERGED if fit.status == Status.STALLED else fit.status
    return replace(fit, status=status, hints=hints, verdict=Verdict(ADEQUATE, left))


def with_stall_hint(fit: Fit, objective: Objective) -> Fit:
    """The fit with what to do next where its search has stalled."""
    known = fit.single_steps or (fit.verdict and fit.verdict.fails)
    if fit.status != Status.STALLED or not fit.rmse > 0.0 or known:
        return fit
    others = [objective.rmse(objective.cost_or_infinity(p)) for p in around(fit, objective)]
    away = max(others, key=lambda rmse: abs(rmse - fit.rmse), default=fit.rmse)
    if not abs(away - fit.rmse) <= JUMP * fit.rmse:
        share = f"change it by {100 * abs(away / fit.rmse - 1):.3g} %" if np.isfinite(away) else "let it diverge"
        text = (
            f"the search has stalled where the error jumps: values that are a millionth larger or smaller {share}, as "
            "contacts, folds or the guard of the step switch. Fit fewer frames, then all of them from that result "
            "(--start), or with finer steps (--substeps)"
        )
    else:
        text = (
            "the search has stalled short of a minimum: fit its result in place of the scene, which keeps its steps, "
            "or the scene by another --method, from other starts (--starts 8), or of the fabric, where you know it "
            "(new --fabric denim)"
        )
    return replace(fit, hints=[*fit.hints, Hint("stalled", text, before_fit=False)])


def with_own_motion(fit: Fit, search: Search) -> Fit:
    """The fit with what is left of a target that is a motion of its model."""
    each, left = fit.single_steps, f"the motion as a whole ends {metres(fit.rmse)} from it"
    if each is not None:
        grown = fit.rmse > each.steps**2 * each.rmse  # what errors of single steps add up to, if nothing grows
        if not (grown or search.misses_own):
            return fit
        text = (
            f"the values are those of the target: each of its {each.steps} steps, begun where the target begins it, "
            f"ends within {metres(each.largest)} of it (RMS); {left}, {fit.rmse / each.rmse:.0e} times as far: it is "
            "chaotic, and no search brings it nearer"
        )
        return replace(fit, hints=[*fit.hints, Hint("chaotic", text, before_fit=False)])
    if not search.misses_own or fit.status not in (Status.CONVERGED, Status.STALLED):
        return fit
    text = (
        f"the target is a motion of this model, as steps of it show; {left}, so other values explain it, which the "
        "search has not found: fit the first frames, then all of them from that result (--start)"
    )
    return replace(fit, hints=[*fit.hints, Hint("own_motion", text, before_fit=False)])


def around(fit: Fit, objective: Objective) -> list[Array]:
    """Values (P,) on two sides of those that were found, every other one changed the other way."""
    p = parameters(fit.scene, objective.scene)
    scales = np.concatenate([np.zeros(0), *(np.full(block.count, block.kind.scale) for block in objective.blocks)])
    sizes = np.where(objective.identifiable, np.maximum(np.abs(p), SHIFT * scales), 0.0)
    change = SHIFT * sizes * np.where(np.arange(len(p)) % 2 == 0, 1.0, -1.0)
    return [np.clip(p + sign * change, *bounds(objective.scene)) for sign in (1.0, -1.0)]


MOVERS = ("damping", "drag", "wind", "gravity")
"""Kinds whose lack keeps a cloth from moving as its target does."""


def picture_error(objective: Objective, shown: Objective | None = None) -> float:
    """Root mean square distance, m, of the compared positions from the mean of each vertex over the frames, or over
    those that another objective of the same scenes has `shown`: as it stands, or carried along by what is held, if that
    is nearer.
    """
    return min(picture_distance(objective, shown or objective, carried) for carried in (False, True))


def picture_distance(objective: Objective, shown: Objective, carried: bool) -> float:
    """The same for one of both."""
    squares = 0.0
    for run, other in zip(objective.runs, shown.runs, strict=True):
        y, known = compared_points(shown, other, carried)
        mean = y.sum(axis=0, where=known) / np.maximum(known.sum(axis=0), 1)
        x, seen = compared_points(objective, run, carried)
        if isinstance(run.comparison.surface, Cloud):
            squares += run.comparison.cost_of(np.broadcast_to(mean, x.shape))
            continue
        squares += sum(float(((each - mean) ** 2).sum(where=here)) for each, here in zip(x, seen, strict=True))
    return float(np.sqrt(squares / max(objective.observations, 1)))


def compared_points(objective: Objective, run: Run, carried: bool) -> tuple[Array, Flags]:
    """The points (F, m, 3), m, of a target that a run compares, in the scene's axes, and which are seen (F, m, 1).
    `carried`: vertices without the mean way of the held ones that are always seen.
    """
    motion = in_groups(objective.experiments[run.experiment].motion, run.scene)
    x = motion.of(run.cloth)[: len(run.comparison.goal.step)]
    if isinstance(run.comparison.surface, Cloud):
        x = np.where(np.isfinite(x), x, run.system.x0)  # there was no time to track it
        return x, np.ones((*x.shape[:2], 1), bool)
    held = ~mobile(run.system) & np.isfinite(x).all(axis=(0, 2))
    if carried and run.comparison.surface is None and held.any():
        way = x[:, held].mean(axis=1, keepdims=True)
        x = x - (way - way[:1])
    return run.comparison.points_of(x), run.comparison.observed[..., None]


def as_it_came(objective: Objective) -> float | None:
    """Root mean square distance, m, of the motion by the scene's own values, whatever is flagged; None where it
    diverges.
    """

    def show(run: Run, observe: Observer) -> None:
        play(run, Tape(run.system, run.steps, objective.tolerance, None, run.forms), [observe])

    try:
        found = objective.distance(show)
    except Diverged:
        return None
    return found if np.isfinite(found) else None


def with_picture(found: Fit, objective: Objective) -> Fit:
    """The fit beside the best still picture, where positions are compared. Over whole motions, where the model differs,
    a fit that leaves more of the squares than it explains fails.
    """
    own = objective.own or objective.scene.method == REST
    if own or not objective.observations or "position" not in objective.weights:
        return found
    found = replace(found, baselines=Baselines(picture_error(objective)))
    explains = not 2.0 * found.rmse**2 >= picture_error_of(found) ** 2
    if found.windows is not None or found.verdict is None or not found.verdict.differs or explains:
        return found
    chosen = any(hint.code == AUTO for hint in found.hints)
    text = (
        f"the best still picture of the target comes to {metres(picture_error_of(found))}, the fitted motion only to "
        f"{metres(found.rmse)}, which leaves more of its squares than it explains: what moves the cloth is missing "
        "from the model, or its clock or its place is another one, or the search, which ended in its "
        f"stage “{found.stage}”, has not found it. {way_out(objective.scene, chosen)}"
    )
    status = Status.STALLED if found.status == Status.CONVERGED else found.status
    verdict, first = replace(found.verdict, model=FAILS), Hint(FAILS, text, before_fit=False)
    warnings = [each for each in found.warnings if not each.startswith("no intervals")]
    warnings.append("no intervals: the fit fails, so its values say nothing of the cloth")
    found = replace(without_intervals(found), status=status, verdict=verdict)
    return replace(found, hints=[first, *found.hints], warnings=warnings)


def picture_error_of(fit: Fit) -> float:
    """The error of the still picture, m; infinite where it is not known."""
    return np.inf if fit.baselines is None else fit.baselines.still


def with_start(fit: Fit, objective: Objective) -> Fit:
    """The fit beside the scene as it came; `objective` has that scene, in its own step."""
    if fit.baselines is None:
        return fit
    return replace(fit, baselines=replace(fit.baselines, start=as_it_came(objective)))


def way_out(scene: Scene, chosen: bool) -> str:
    """What to try where a fit of the scene fails, or where it has `chosen` by itself what to fit."""
    flagged = {block.name for block in scene.blocks}
    missing = [name for name in MOVERS if name not in flagged]
    if missing and not chosen:
        return (
            f"Fit {listed(missing)} as well (--fit auto), or see that what is held, and wind, are as in the target; "
            "where its clock may be another, use --fit-time"
        )
    return (
        "See that what is held, what it touches and wind are as in the target, or try a scene of the fabric, where you "
        "know it (new --fabric denim), other starts (--starts 8), more time (--budget), or fewer frames first"
    )
