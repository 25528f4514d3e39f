"""Hints: what a target itself shows of its difference from the scene, said before a fit.

Another clock or gravity (`free_fall`), another place or size, held vertices that move or stand elsewhere, lengths that
are not the scene's, and vertices that change places. `residual_hints` has those that a fitted motion shows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags
from clothfit.base.messages import counted, listed, metres
from clothfit.motion.markers import rigid
from clothfit.motion.motion import Motion, rms
from clothfit.objective.experiment import Experiment
from clothfit.registration.free_fall import other_fall
from clothfit.registration.mislabelled import changes, disorder
from clothfit.registration.record import named, scale_between
from clothfit.scene.cloth import Cloth
from clothfit.scene.kinds import INTEGRATORS
from clothfit.scene.scene import Scene

AWAY, RIGID = 0.001, 0.2
"""Distance of the first frame from the scene's start, relative to its size, that is worth a word, and the largest part
of it that may be left where the target is only moved and turned, or only larger or smaller.
"""

STANDS = 0.5
"""How far a held vertex may move about its mean, relative to its distance from where it is held, and stand there."""

OTHER_SIZE = 0.01
"""Relative difference of the sizes of the first frame and the scene's start that is worth a word."""

MOVES, PERSISTS = 0.01, 0.5
"""Movement of held vertices, relative to that of the others, and its correlation from frame to frame: noise has none.
"""

SHORTER, MOSTLY = 0.9, 0.95
"""Length of edges relative to their rest lengths: the median, and of three quarters of them, that is shorter."""

STARTS = 1e-3  # steps; a first frame within is that of the start

MOST = 3_000_000
"""Numbers of a target that one look takes."""


@dataclass(frozen=True)
class Hint:
    """What the user should look at, and what helps."""

    code: str  # "time_scale", "time_offset", "placement", "held_vertices_move", "rest_lengths", "swapped_markers", …
    text: str  # a sentence
    before_fit: bool = True  # said before the fit


def other_step(scene: Scene, start: object) -> list[Hint]:
    """A hint where a scene to start from has another step, which its values made up for."""
    if not isinstance(start, Scene) or (start.delta, start.method) == (scene.delta, scene.method):
        return []
    own, other = (f"{1e3 * each.delta:.4g} ms by {INTEGRATORS[each.method]}" for each in (scene, start))
    text = f"start: the values of {start.name} are for steps of {other}, not of {own}, and only they are taken"
    return [Hint("start_step", f"{text}; to keep its steps, fit {start.name} itself")]


def hints_before_fit(given: list[Experiment]) -> list[Hint]:
    """What the targets show before a fit, each kind once."""
    found: dict[str, Hint] = {}
    for motion, scene in given:
        for hint in hints_of(scene, motion):
            found.setdefault(hint.code, hint)
    return list(found.values())


def hints_of(scene: Scene, motion: Motion) -> Iterator[Hint]:
    """What one target shows."""
    end = scene.delta * (scene.frames - 1)
    if (fall := other_fall(scene, motion)) is not None:
        yield Hint(
            "time_scale",
            f"the target falls at {fall.acceleration:.3g} m/s² instead of {fall.gravity:.3g}: another clock (rate "
            f"{fall.rate:.3g}), or gravity; use --fit-time, or fit gravity",
        )
    elif late := int((motion.times > end + (1.0 + STARTS) * scene.delta).sum()):
        text = f"the scene ends at {end:.4g} s: {late} of {len(motion.times)} frames of the target come later and are"
        yield Hint("ends_early", f"{text} not compared; give it more steps, by optimizationIterations or new --frames")
    mixed = [disorder(motion) or begins_later(scene, motion)]
    yield from (Hint("frame_order", f"the target: {text}") for text in mixed if text)
    moved = [] if mixed[0] else list(placed(scene, motion))
    yield from moved or elsewhere(scene, motion)
    for swap in islice(changes(motion, 1), 1):
        names = listed([named(vertex, motion.vertex_counts) for vertex in swap.vertices])
        text = f"{names} change places in frame {swap.frame} of the target; exchange them there, or mark them as not"
        yield Hint("swapped_markers", f"{text} observed")
    for i, cloth in enumerate(scene.cloths):
        positions, seen = motion.of(i), motion.seen(i)
        yield from held_that_move(cloth, positions, seen, f"objects[{i}]")
        if not any(hint.code == "scale" for hint in moved):
            yield from shrunk(cloth, positions, seen, f"objects[{i}]")


def placed(scene: Scene, motion: Motion) -> Iterator[Hint]:
    """Does the target begin where the scene does, and as large?"""
    seen = motion.seen()[0]
    start = np.concatenate([cloth.positions for cloth in scene.cloths])[seen]
    points = motion.positions[0][seen]
    if motion.times[0] > STARTS * scene.delta or len(points) < 3:
        return
    size = float(np.linalg.norm(np.ptp(start, axis=0)))
    distance, left = rms(points - start), rms(moved_onto(points, start) - start)
    larger = scale_between(points, start)
    alike = rms(moved_onto(points / larger, start) - start)
    free = np.sqrt(max(1.0 - 2.0 / len(points), 0.1))  # of what is left: moving and turning has six unknowns
    if abs(larger - 1.0) > OTHER_SIZE and left > AWAY * size and alike < RIGID * left:
        yield Hint(
            "scale",
            f"the target's first frame is {larger:.4g} times as large as the scene's start; use --fit-scale, or give "
            f"the target's unit (--scale, now {1.0 / larger:.4g} times)",
        )
        left, distance = alike, rms(points / larger - start)
    if distance > AWAY * size and left < RIGID * free * distance:
        yield Hint(
            "placement",
            f"the target's first frame is {metres(distance)} (RMS) away from the scene's start, and {metres(left)} "
            "when it is moved and turned as a whole; use --fit-placement",
        )


def begins_later(scene: Scene, motion: Motion) -> str | None:
    """Which frame of the target, not the first, shows the scene's start without being moved; None where none does."""
    start, seen = np.concatenate([cloth.positions for cloth in scene.cloths]), motion.seen()
    known, last = seen & seen[0], len(seen) - 1
    squares = np.where(known, ((motion.positions - start) ** 2).sum(axis=2), 0.0).sum(axis=1)
    count = known.sum(axis=1)
    away = np.sqrt(np.divide(squares, count, out=np.full(len(count), np.inf), where=count >= 3))
    near, size = int(away.argmin()), float(np.linalg.norm(np.ptp(start, axis=0)))
    if motion.times[0] > STARTS * scene.delta or not max(away[near] / RIGID**2, AWAY * size) < away[0] < np.inf:
        return None
    what = "are its frames in reverse?" if near == last else f"leave out what is before (--frames {near}:)"
    return f"its frame {near} of {last + 1}, not the first, is where the scene begins: {what}"


def elsewhere(scene: Scene, motion: Motion) -> Iterator[Hint]:
    """Do vertices that the scene holds stand still elsewhere in the target?"""
    for i, cloth in enumerate(scene.cloths):
        still, seen = held_still(cloth), motion.seen(i)
        held = some(np.flatnonzero(still & seen.any(axis=0)), len(motion.times))
        if not len(held):
            continue
        known = seen[:, held][..., None]
        mean = np.where(known, motion.of(i)[:, held], 0.0).sum(axis=0) / known.sum(axis=0)
        away = np.linalg.norm(mean - cloth.positions[held], axis=1)
        squares = (np.where(known, motion.of(i)[:, held] - mean, 0.0) ** 2).sum(axis=(0, 2))
        wandering = np.sqrt(squares / seen[:, held].sum(axis=0))
        gap = float(np.median(np.where(wandering < STANDS * away, away, 0.0)))
        size = float(np.linalg.norm(np.ptp(cloth.positions, axis=0)))
        if gap > AWAY * size:
            yield Hint(
                "placement",
                f"objects[{i}]: {counted(len(held), 'vertex', 'vertices')} that the scene holds "
                f"{'stands' if len(held) == 1 else 'stand'} {metres(gap)} (median) away from there in the target; use "
                "--fit-placement, or hold others",
            )
            return


def moved_onto(points: Array, others: Array) -> Array:
    """The points (n, 3), moved and turned as a whole so that they are nearest to the others (n, 3)."""
    R, t = rigid(points, others)
    return np.asarray(points @ R.T + t)


def held_still(cloth: Cloth) -> Flags:
    """Which vertices (n,) the scene holds where they start."""
    still = cloth.fixed.copy()
    still[[vertex for pin in cloth.pins for vertex in pin.vertices]] = False
    return np.asarray(still)


def held_that_move(cloth: Cloth, positions: Array, seen: Flags, name: str) -> Iterator[Hint]:
    """Do vertices that the scene holds move in the target (F, n, 3)?"""
    known = seen.all(axis=0)
    held, free = (some(np.flatnonzero(known & each), len(positions)) for each in (held_still(cloth), ~cloth.fixed))
    if not len(held) or not len(free) or len(positions) < 4:
        return
    away = positions[:, held] - positions[:, held].mean(axis=0)
    squares = (away**2).sum(axis=(0, 2))
    lasting = (away[1:] * away[:-1]).sum(axis=(0, 2)) > PERSISTS * squares
    travel = rms((positions[:, free] - positions[0, free]).reshape(-1, 3))
    moving = lasting & (np.sqrt(squares / len(away)) > MOVES * travel)
    if moving.any():
        farthest = float(np.sqrt(squares[moving].max() / len(away)))
        vertices = counted(int(moving.sum()), "vertex", "vertices")
        first = int(held[moving][0])
        yield Hint(
            "held_vertices_move",
            f"{name}: {vertices} of {len(held)} that the scene holds {'moves' if moving.sum() == 1 else 'move'} in the "
            f"target, by up to {metres(farthest)} (RMS), vertex {first} the first; free them, or hold others",
        )


def shrunk(cloth: Cloth, positions: Array, seen: Flags, name: str) -> Iterator[Hint]:
    """Are the edges of the target (F, n, 3) shorter than the scene's rest lengths, most of them, most of the time?"""
    chosen = some(np.flatnonzero(edges_of(cloth)), len(positions))
    (a, b), rest = cloth.springs[chosen].T, cloth.rest[chosen]
    both = seen[:, a] & seen[:, b]
    if not both.any() or cloth.mode("rest") != "n":
        return
    count = both.sum(axis=0)
    known = count > 0
    lengths = np.where(both, np.linalg.norm(np.where(both[..., None], positions[:, a] - positions[:, b], 0), axis=2), 0)
    ratio = (lengths.sum(axis=0)[known] / count[known]) / rest[known]
    middle = float(np.median(ratio))
    start = np.flatnonzero(both[0])
    first = float(np.median(lengths[0, start] / rest[start])) if len(start) else 1.0
    shorter = middle < SHORTER and float(np.quantile(ratio, 0.75)) < MOSTLY
    if shorter or abs(first - 1.0) > 1.0 - SHORTER:
        value, when = (first, "at the start") if abs(first - 1.0) > 1.0 - SHORTER else (middle, "in the mean")
        yield Hint(
            "rest_lengths",
            f"{name}: the target's edges are {100 * abs(value - 1.0):.0f} % {'shorter' if value < 1 else 'longer'} "
            f"{when} than the scene's rest lengths; fit rest lengths (springRestLength), or check the unit",
        )


def edges_of(cloth: Cloth) -> Flags:
    """Which springs (S,) lie along an edge of a triangle; all, where none does."""
    n = len(cloth.mass)
    sides = np.sort(cloth.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
    ends = np.sort(cloth.springs, axis=1).astype(np.int64)
    found = np.isin(ends[:, 0] * n + ends[:, 1], sides[:, 0] * n + sides[:, 1])
    return found if found.any() else np.ones(len(ends), bool)


def some(indices: NDArray[np.intp], frames: int) -> NDArray[np.intp]:
    """Evenly chosen indices, so few that a look at them in so many frames takes little memory."""
    every = -(-3 * len(indices) * frames // MOST) or 1
    return indices[::every]
