"""Which markers of a target are mistaken, and which of its frames, from the target and the scene's start alone, before
any simulation.

Swapped at the start: where the first frame is the scene's start, but for its place, most markers are at their vertices
once it is moved and turned, so that the nearer half of them is nearest (by concentration steps: P. J. Rousseeuw, K. Van
Driessen, Computing LTS regression for large data sets, Data Mining and Knowledge Discovery 12, 2006). Those that are
not, and that an assignment to each other's vertices brings as near as all the rest, are swapped.

Swapped later: two that change places from one frame to the next.

False: away from its vertex at the start, and farther from the markers around it than the cloth between them reaches.

Jumping: in one frame or two far from the way between the frames before and after, which are near each other.

Each asks for a multiple of what all other markers show, and for a part of the way to the next marker, so that noise, a
cloth that stretches, and one that whips are none of these.

Frames: where some are in another order than they were recorded in, the second differences of all positions at the two
ends of that part nearly vanish when it is reversed.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags
from clothfit.motion.markers import rigid
from clothfit.motion.motion import Motion
from clothfit.registration.record import Jump, Markers, Swap
from clothfit.scene.scene import Scene

FEWEST, MOST_MISLABELLED = 5, 64
"""Markers, at least, that show where the others are, and at most that may be mistaken: more are another shape."""

WRONG, NEAR = 6.0, 0.25
"""Distance from its vertex, or from where it was a frame before, relative to the median of all, from which on a marker
stands out, and up to which it is at another vertex; and a part of the way to the next vertex, and of that from its own,
for the same.
"""

LOOSE = 0.02
"""Median distance relative to the scene's size above which the first frame is not the scene's start."""

EXCHANGE = 0.1
"""Two vertices change places where that leaves less than this part of their jumps, and these stand out."""

FAR, NEAREST = 2.0, 4
"""Distances from the nearest markers, so many of them, relative to those at the start, that a false one has, or so much
more than the median of all.
"""

SPIKE, LIKE = 12.0, 0.2
"""How far from its way a marker jumps, relative to the median; and how much of it may be left in the frames around once
the jump explains these.
"""

JUMPS = {1: (0.2, 0.5), 2: (1.0, 0.25)}
"""How far, relative to the median length of springs, a marker jumps for one frame and for two, in which a fine cloth
shivers and a corner whips; and how far it then is from where it was, relative to the jump.
"""

UNORDERED, MOST_FRAMES = 0.5, 1000
"""Squares of the ways from frame to frame, in those between any two, that show no order; and frames that are looked at.
"""


def mislabelled(scene: Scene, motion: Motion, late: bool = False) -> Markers:
    """What is wrong with the markers of a target; `late`: its first frame may be of another time than it says."""
    if motion.positions.shape[1] < FEWEST:
        return Markers()
    begins = late or not motion.times[0] > 1e-3 * scene.delta
    swaps, wrong = at_the_start(scene, motion) if begins else ([], [])
    cleared = Markers(tuple(swaps)).applied(motion)
    swaps += later_swaps(cleared)
    cleared = Markers(tuple(swaps)).applied(motion)
    suspects = [i for i in wrong if all(i not in each.vertices for each in swaps)]
    false = out_of_reach(scene, cleared, suspects)
    jumps = [each for each in jumping(scene, cleared) if each.vertex not in false]
    return Markers(tuple(swaps), tuple(false), tuple(jumps))


def at_the_start(scene: Scene, motion: Motion) -> tuple[list[Swap], list[int]]:
    """The swaps, in cycles, that the first frame of a target shows once it is moved and turned so that most markers are
    at their vertices, and all vertices whose markers are elsewhere then; none where they are no mistakes, but another
    shape.
    """
    from scipy.optimize import linear_sum_assignment

    seen = np.flatnonzero(motion.seen()[0])
    if len(seen) < FEWEST:
        return [], []
    start = np.concatenate([cloth.positions for cloth in scene.cloths])[seen]
    size = float(np.linalg.norm(np.ptp(start, axis=0)))
    points = moved(motion.positions[0, seen], start)
    distance = np.linalg.norm(points - start, axis=1)
    median = float(np.median(distance)) + 1e-9 * size
    places = np.flatnonzero(distance > WRONG * median)
    places = places[distance[places] > NEAR * spacing(start, places)]
    if not 1 <= len(places) <= min(MOST_MISLABELLED, (len(seen) - 3) // 2) or median > LOOSE * size:
        return [], []
    gaps = np.linalg.norm(points[places][:, None] - start[places][None], axis=2)
    rows, columns = linear_sum_assignment(np.minimum(gaps, WRONG**2 * median) ** 2)
    near = np.minimum(WRONG * median, NEAR * distance[places])
    after = {int(i): int(j) for i, j in zip(rows, columns, strict=True) if gaps[i, j] <= near[i] and i != j}
    wrong, swaps = seen[places], list[Swap]()
    while after:
        chain = [next((i for i in after if i not in after.values()), min(after))]
        while (following := after.pop(chain[-1], None)) not in (None, chain[0]):
            chain.append(following)
        swaps.append(Swap(tuple(wrong[chain].tolist()), closed=following is not None))
    return swaps, wrong.tolist()


def moved(points: Array, start: Array) -> Array:
    """The points (k, 3), m, as a whole moved and turned onto most of their places (k, 3)."""
    half, best, least = max(len(points) // 2 + 1, 3), points, np.inf
    near = np.arange(len(points))
    for _ in points:
        R, d = rigid(points[near], start[near])
        best = points @ R.T + d
        away = np.linalg.norm(best - start, axis=1)
        near = np.sort(np.argsort(away, kind="stable")[:half])
        before, least = least, float((away[near] ** 2).sum())
        if not least < before:  # of places that agree to rounding, other ones are the nearest each time
            break
    return best


def spacing(start: Array, which: NDArray[np.intp]) -> Array:
    """How far some of the places (k, 3) are from the nearest other one, m."""
    gaps = np.array([np.partition(np.linalg.norm(start - start[i], axis=1), 1)[1] for i in which])
    return gaps.reshape(len(which))


def later_swaps(motion: Motion) -> list[Swap]:
    """Which vertices change places from one frame to the next; swaps of before are undone where later ones are."""
    found = list[Swap]()
    while len(found) < MOST_MISLABELLED:
        swap = next(changes(Markers(tuple(found)).applied(motion), found[-1].frame if found else 1), None)
        if swap is None:
            return found
        found.append(swap)
    return []  # no two markers change places so often


def changes(motion: Motion, first: int) -> Iterator[Swap]:
    """Two vertices that change places, from the frame `first` on."""
    x, seen = motion.positions, motion.seen()
    for frame in range(first, len(x)):
        both = np.flatnonzero(seen[frame] & seen[frame - 1])
        if len(both) < FEWEST:
            continue
        now, before = x[frame, both], x[frame - 1, both]
        jump = np.linalg.norm(now - before, axis=1)
        wide = np.flatnonzero(jump > WRONG * np.median(jump))
        if not 2 <= len(wide) <= min(len(jump) // 2, MOST_MISLABELLED):
            continue
        across = np.linalg.norm(now[wide][:, None] - before[wide][None], axis=2)
        other = np.argmin(across, axis=1)
        for i, j in ((i, int(j)) for i, j in enumerate(other) if other[j] == i < j):
            if across[i, j] + across[j, i] < EXCHANGE * (jump[wide[i]] + jump[wide[j]]):
                yield Swap(tuple(both[wide[[i, j]]].tolist()), frame)


def apart(x: Array, seen: Flags) -> Array:
    """The mean squares D (F, F), m², of the ways of points x (F, k, 3), `seen` (F, k), between any two frames."""
    known = seen.astype(float)
    middle = x.sum(axis=(0, 1), where=seen[..., None]) / max(known.sum(), 1.0)
    own = np.where(seen[..., None], x - middle, 0.0)
    squares, flat = (own**2).sum(axis=2) @ known.T, own.reshape(len(x), -1)
    return np.asarray(np.maximum(squares + squares.T - 2.0 * flat @ flat.T, 0.0) / np.maximum(known @ known.T, 1.0))


def disorder(motion: Motion) -> str | None:
    """What is wrong with the order of a target's frames; None where a motion goes through them."""
    seen, x = motion.seen()[:MOST_FRAMES], motion.positions[:MOST_FRAMES]
    if len(x) < FEWEST + 2 or seen.any(axis=0).sum() < FEWEST:
        return None
    D = apart(x, seen)
    first, last = np.triu_indices(len(x), 1)
    if np.diag(D, 1).mean() > UNORDERED * D[first, last].mean():
        return "its frames are in no order, or far apart in time: each is as far from the next as from any other"

    def bent(a: NDArray[np.intp], b: NDArray[np.intp], c: NDArray[np.intp]) -> Array:
        """The squares of second differences of three frames each."""
        return np.asarray(2.0 * (D[a, b] + D[b, c]) - D[a, c])

    inside = (first >= 2) & (last <= len(x) - 3)
    i, j = first[inside], last[inside]
    frames = np.arange(1, len(x) - 1)
    now = np.concatenate([[0.0], bent(frames - 1, frames, frames + 1)])
    before = now[i - 1] + now[i] + now[j] + now[j + 1]
    after = bent(i - 2, i - 1, j) + bent(i - 1, j, j - 1) + bent(i + 1, i, j + 1) + bent(i, j + 1, j + 2)
    share = np.divide(after, before, out=np.full(len(i), np.inf), where=before > 4.0 * now[1:].mean())
    if share.min() < EXCHANGE:
        a, b = (int(each[share.argmin()]) for each in (i, j))
        what = f"frames {a} and {b} are exchanged" if b == a + 1 else f"frames {a} to {b} are in reverse"
        return f"its {what}: in the other order the motion goes on smoothly; put them so"
    return None


def out_of_reach(scene: Scene, motion: Motion, suspects: list[int]) -> list[int]:
    """Those of the suspects that are farther from the markers of their cloth that are nearest at the start than the
    cloth between them reaches.
    """
    if not suspects:
        return []
    start = np.concatenate([cloth.positions for cloth in scene.cloths])
    owner = np.repeat(np.arange(len(scene.cloths)), scene.vertex_counts)
    seen, ratios = motion.seen(), dict[int, float]()
    for i in (markers := np.flatnonzero(seen.any(axis=0))):
        others = markers[(owner[markers] == owner[i]) & (markers != i)]
        away = np.linalg.norm(start[others] - start[i], axis=1)
        near = np.argsort(away, kind="stable")[:NEAREST]
        gaps = np.linalg.norm(motion.positions[:, others[near]] - motion.positions[:, [i]], axis=2)
        gaps[~(seen[:, others[near]] & seen[:, [i]])] = np.nan
        known = np.isfinite(gaps).any(axis=0)
        if known.any():
            far = np.nanquantile(gaps[:, known], 0.9, axis=0) / away[near][known]  # in the frames where it is largest
            ratios[int(i)] = float(np.median(far))
    limit = FAR * max(1.0, float(np.median(list(ratios.values()) or [1.0])))
    return [i for i in suspects if ratios.get(i, 0.0) > limit]


def alone(x: Array) -> Flags:
    """Whether the third of five frames x (5, k, 3) is the one that is off a way, however fast: by d it is then off the
    middle of its neighbours, and these are by −d/2 off theirs. A cloth that whips is pulled to one side for longer.
    """
    off = x[1:-1] - 0.5 * (x[:-2] + x[2:])
    left = np.linalg.norm(off[[0, 2]] + 0.5 * off[1], axis=2).max(axis=0)
    return np.asarray(left < LIKE * np.linalg.norm(off[1], axis=1))  # False where a frame is not seen


def jumping(scene: Scene, motion: Motion) -> list[Jump]:
    """The markers that are far from their way in single frames, or farther in two."""
    lengths = np.concatenate([cloth.lengths for cloth in scene.cloths] or [np.zeros(0)])
    x, seen, found = motion.positions, motion.seen(), dict[int, set[int]]()
    long = float(np.median(lengths)) if len(lengths) and len(x) >= FEWEST else np.inf
    for count, (least, back) in JUMPS.items():
        for first in range(1, len(x) - count):
            for vertex in off_their_way(x, seen, first, count, least * long, back):
                found.setdefault(int(vertex), set()).update(range(first, first + count))
    return [Jump(vertex, tuple(sorted(frames))) for vertex, frames in sorted(found.items())]


def off_their_way(x: Array, seen: Flags, first: int, count: int, least: float, back: float) -> NDArray[np.intp]:
    """The markers that are off the line between the frames around so many, from the `first` on, by `least`, m, or more,
    and then back where they were but for the part `back` of that; not where many of them are.
    """
    end, none = first + count, np.zeros(0, np.intp)
    known = np.flatnonzero(seen[first - 1 : end + 1].all(axis=0))
    before, after = x[first - 1, known], x[end, known]
    away = np.stack([
        np.linalg.norm(x[k, known] - ((end - k) * before + (k + 1 - first) * after) / (count + 1.0), axis=1)
        for k in range(first, end)
    ])  # fmt: skip
    far = away.min(axis=0) > least
    if len(known) < FEWEST or not far.any():
        return none
    wide = np.flatnonzero(far & (away > SPIKE * np.median(away, axis=1)[:, None]).all(axis=0))
    returns = np.linalg.norm((after - before)[wide], axis=1) < back * away[:, wide].min(axis=0)
    if count == 1 and 2 <= first < len(x) - 2:
        returns |= alone(x[first - 2 : end + 2, known[wide]])
    return known[wide[returns]] if len(wide) <= MOST_MISLABELLED else none
