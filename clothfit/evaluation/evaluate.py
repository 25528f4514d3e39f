"""How good a fitted scene is: how far its motion, over the fitted frames and beyond, and its parameters are from the
truth; and two motions of one scene, the fitted one and its target, frame by frame.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import FIT_TOLERANCE
from clothfit.base.memory import check_memory
from clothfit.base.messages import metres
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate_cloths
from clothfit.motion.times import MOST_STEPS, TIME_SLACK, frame_places, interpolated, snapped
from clothfit.objective.experiment import Experiment, Recorded, check_same_sizes, motion_of
from clothfit.objective.identifiability import identifiable
from clothfit.objective.measures import Cloud, surface_of
from clothfit.objective.target import sample
from clothfit.objective.target import target as target_of
from clothfit.registration.tracking import tracked
from clothfit.scene.fit_vector import fitted_cloths, parameters
from clothfit.scene.scene import Scene, check_is_scene

HORIZON = 500  # frames


@dataclass(frozen=True)
class Distance:
    """Distance between two motions over the vertices of the fitted objects (of all, where none is flagged)."""

    frames: int  # compared, the initial one included
    rmse: float  # m
    max_error: float  # largest distance of a vertex, m


@dataclass(frozen=True)
class Deviation:
    """Relative deviation |fitted / true − 1| of one kind of value of one object, over the identifiable ones."""

    object: int | None  # None: of the scene as a whole
    name: str  # of the kind: "mass", "stiffness", …
    mode: str  # "G" one value for the object, or "L" one per element
    count: int  # of values, those that are not identifiable included
    median_relative_deviation: float | None  # None where no value is identifiable
    max_relative_deviation: float | None  # the same


@dataclass(frozen=True)
class Evaluation:
    """How far a fitted scene is from the true one, or from a target."""

    fitted: Distance  # over the frames that are fitted
    horizon: Distance  # over a longer run, the fitted frames included
    parameters: list[Deviation]  # against the true values, kind by kind
    diverged: str | None = None  # what happened, where the longer run diverged; it then ends before that

    def __repr__(self) -> str:
        near, far = (f"{metres(part.rmse)} over {part.frames} frames" for part in (self.fitted, self.horizon))
        return f"<Evaluation: RMSE {near}, {far}{', then it diverges' if self.diverged else ''}>"


def evaluate(
    truth: Scene, fitted: Scene, frames: int | None = None, horizon: int = HORIZON, target: Recorded | None = None
) -> Evaluation:
    """Compare a fitted scene with the true one, or with a target motion where one is given.

    `frames` (default: the scene's) and `horizon` count the initial state, in steps of the true scene; each scene is
    simulated with its own step, and the fitted one is compared at the times of the other. A target, a motion or the
    path of its file, is compared at the times of its frames, as far as it reaches; each position counts once, unless
    its weight is 0. Raises InvalidInput when the scenes or the target have other objects, Diverged when a simulation
    diverges within the fitted frames.
    """
    for scene in (truth, fitted):
        check_is_scene(scene)
    check_same_sizes(fitted, truth)
    near = truth.frames if frames is None else frames
    if near < 2 or horizon < 2:
        raise InvalidInput(f"frames must be at least 2 to compare; {min(near, horizon)} was given")
    compared = compared_cloths(truth)
    length = max(near, horizon)
    if target is None:
        check_memory(length, sum(truth.vertex_counts), 1)  # two motions; else the second would be refused late
        goal, fault = finite_part(truth, compared, length, near)
    else:
        goal, fault = tracked(Experiment(motion_of(target, truth), fitted)).motion, None
    fitted_end, end = (place_of(each, truth, fitted) for each in (near, horizon))
    length = states(min(max(fitted_end, end), last_place(goal, fitted.delta)))
    own, own_fault = finite_part(fitted, compared, length, min(states(fitted_end), length))
    return judged(truth, fitted, own, goal, (near, horizon), fault or own_fault)


def judged(
    truth: Scene, fitted: Scene, own: Motion, goal: Motion, frames: tuple[int, int], fault: str | None
) -> Evaluation:
    """The evaluation of a fitted scene by its motion and its target, over the fitted `frames` and the longer run."""
    compared, ends = compared_cloths(truth), [place_of(each, truth, fitted) for each in frames]
    near, far = (distance(own, goal, fitted.delta, compared, end) for end in ends)
    return Evaluation(near, far, deviations(truth, fitted), fault)


def compared_cloths(scene: Scene) -> Collection[int]:
    """The objects that are fitted; all, where none is."""
    return fitted_cloths(scene) or range(len(scene.cloths))


def finite_part(scene: Scene, compared: Collection[int], frames: int, needed: int) -> tuple[Motion, str | None]:
    """Simulate the compared objects as far as the motion stays finite; with the fault that ended it, or None.

    Raises Diverged when fewer than `needed` frames are finite.
    """
    try:
        return simulate_cloths(scene, compared, frames, FIT_TOLERANCE), None
    except Diverged as error:
        if error.motion is None or len(error.motion.times) < needed:
            raise
        return error.motion, str(error)


def place_of(frames: int, truth: Scene, fitted: Scene) -> float:
    """Where the last of `frames` frames of the true scene lies in steps of the fitted one, whose step may be another.
    """
    places = np.array([min((frames - 1) * (truth.delta / fitted.delta), MOST_STEPS)])  # a target may end before that
    whole, fraction = snapped(places)
    return float(whole[0] + fraction[0])


def last_place(motion: Motion, delta: float) -> float:
    """Where the last frame of a motion lies in steps of `delta`, s."""
    step, fraction = frame_places(motion, delta)
    return float(step[-1] + fraction[-1])


def states(place: float) -> int:
    """Number of states, the initial one included, that reach a place in steps."""
    return int(np.ceil(place)) + 1


def distance(own: Motion, goal: Motion, delta: float, compared: Collection[int], end: float) -> Distance:
    """Distance of a motion `own`, simulated in steps of `delta`, s, from the frames of `goal` up to `end`, in steps."""
    gaps: list[Array] = []
    count = 0
    for cloth in compared:
        wanted = target_of(goal, cloth, delta, min(end, len(own.positions) - 1) + TIME_SLACK)
        shows, x = surface_of(goal, cloth), sample(wanted, own.of(cloth))
        if isinstance(shows, Cloud):
            gaps.append(shows.within(wanted, start=True).measure(wanted).residual(x))
        else:
            gaps.append((x - wanted.positions)[wanted.observed])
        count = len(wanted.step)
    squares = (np.concatenate(gaps) ** 2).sum(axis=1)
    if not squares.size:
        raise InvalidInput(f"{goal.name}: shows no observed vertex in the first {end * delta:g} s")
    return Distance(count, float(np.sqrt(squares.mean())), float(np.sqrt(squares.max())))


def deviations(truth: Scene, fitted: Scene) -> list[Deviation]:
    """|fitted / true − 1| of the parameters flagged in the true scene, but of those that are 0 or not identifiable."""
    true, found, listed = parameters(truth), parameters(fitted, flags=truth), []
    usable = identifiable(truth) & (true != 0)
    each = np.abs(found / np.where(usable, true, np.nan) - 1.0)
    for block in truth.blocks:
        known = each[block.part][~np.isnan(each[block.part])]
        middle, largest = (float(np.median(known)), float(known.max())) if known.size else (None, None)
        listed.append(Deviation(block.cloth, block.name, block.mode, block.count, middle, largest))
    return listed


@dataclass(frozen=True)
class Overlay:
    """Both motions at the frames of the target."""

    scene: Scene  # the fitted one
    times: Array  # (F,), s
    own: Array  # (F, n, 3), m
    goal: Array  # (F, n, 3), m; NaN where not observed
    rmse: Array  # (F,), m, over the observed vertices of the fitted objects; NaN where none is observed
    largest: Array  # (F,), m, the largest distance of such a vertex


def overlaid(truth: Scene, fitted: Scene, target: Motion | None, frames: int) -> Overlay:
    """The motion of a fitted scene, and its target: by default the motion of the true scene.

    Both have `frames` frames of the true scene's simulation, or as many as the target reaches, and end before they
    diverge. The fitted scene is simulated with its own step.
    """
    goal = target if target is not None else finite_part(truth, range(len(truth.cloths)), frames, 0)[0]
    own, _ = finite_part(fitted, range(len(fitted.cloths)), states(place_of(frames, truth, fitted)), 0)
    x = at_frames(own, goal, fitted.delta)
    y = seen(goal)[: len(x)]
    rmse, largest = distances(truth, x, y)
    return Overlay(fitted, goal.times[: len(x)], x, y, rmse, largest)


def seen(motion: Motion) -> Array:
    """The positions (F, n, 3) of a motion, m; NaN where they were not observed."""
    return np.where(motion.seen()[:, :, None], motion.positions, np.nan)


def at_frames(own: Motion, goal: Motion, delta: float) -> Array:
    """Positions (F, n, 3), m, of a motion in steps of `delta`, s, at the first F frames of another, all that it
    reaches.
    """
    step, fraction = frame_places(goal, delta)
    count = int(np.searchsorted(step + fraction, len(own.positions) - 1, side="right"))
    return interpolated(own.positions, step[:count], fraction[:count])


def distances(scene: Scene, x: Array, y: Array) -> tuple[Array, Array]:
    """Root mean square and largest distance (F,), m, of two motions (F, n, 3) over the compared objects."""
    own = compared_vertices(scene)
    return per_frame(((x[:, own] - y[:, own]) ** 2).sum(axis=2))


def compared_vertices(scene: Scene) -> Flags:
    """Which vertices (V,) belong to objects that are fitted; all, where none is."""
    compared = compared_cloths(scene)
    return np.repeat([index in compared for index in range(len(scene.cloths))], scene.vertex_counts)


def per_frame(squares: Array) -> tuple[Array, Array]:
    """Root mean square and largest distance (F,), m, from squared distances (F, n); NaN where none is finite."""
    known = np.isfinite(squares)
    count, finite = known.sum(axis=1), np.where(known, squares, 0.0)
    mean = np.where(count > 0, finite.sum(axis=1) / np.maximum(count, 1), np.nan)
    largest = np.where(count > 0, finite.max(axis=1, initial=0.0), np.nan)
    return np.sqrt(mean), np.sqrt(largest)
