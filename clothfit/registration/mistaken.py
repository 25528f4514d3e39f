"""Which markers of a target are mistaken, from the target and the scene's start alone, before any simulation.

Swapped at the start: where the first frame is the scene's start, but for its place, most markers are at their vertices
once it is moved and turned (by the rotation that leaves the least median of distances, P. J. Rousseeuw, Least median of
squares regression, JASA 79, 1984). Those that are not, and that an assignment to each other's vertices brings as near
as all the rest, are swapped.

Swapped later: two that change places from one frame to the next.

False: away from its vertex at the start, and farther from the markers around it than the cloth between them reaches.

Jumping: in one frame or two far from the way between the frames before and after, which are near each other.

Each asks for a multiple of what all other markers show, and for a part of the way to the next marker, so that noise, a
cloth that stretches, and one that whips are none of these.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.motion.motion import Motion
from clothfit.registration.record import Jump, Markers, Swap, rigid
from clothfit.scene.scene import Scene

FEWEST = 5
"""Markers, at least, that show where the others are."""

TRIPLES, SAMPLE = 64, 400
"""Rotations that are tried, each by three markers, and markers that judge them."""

MOST = 64
"""Markers that may be mistaken: more are no mistake but another shape."""

WRONG, APART = 6.0, 0.25
"""Distance from its vertex, relative to the median of all and to the way to the next one, from which on a marker is
wrong.
"""

FOUND, NEARER = 4.0, 0.25
"""Distance from another vertex, relative to the same median and to that from its own, up to which it is the other's."""

LOOSE = 0.02
"""Median distance relative to the scene's size above which the first frame is not the scene's start."""

EXCHANGE, SUDDEN = 0.1, 4.0
"""Two vertices change places where that leaves less than this part of their jumps, which are so much larger than those
of the others.
"""

FAR, REACHES, NEAREST = 2.0, 1.3, 4
"""Distances from the nearest markers, so many of them, relative to the way along the cloth: those of a false one,
compared with the median of all, and at least.
"""

SPIKE, BACK, VISIBLE = 12.0, 0.5, 0.2
"""How far from the middle of the frames around a marker jumps, relative to the median; how far it is from where it was,
or would have gone, when it is back, relative to that; and the jump relative to the median length of springs.
"""

FARTHER, SOON = 1.0, 0.25
"""How far a marker jumps for two frames, relative to the median length of springs: the shivers of a fine cloth are
shorter; and how far it then is from where it was, relative to the jump: a whip is farther.
"""

LIKE = 0.2
"""Of the same, how much may be left where the jump explains the frames around."""

LARGEST = 300_000
"""Markers times vertices up to which ways along the cloth are looked for."""


def mistaken(scene: Scene, motion: Motion, late: bool = False) -> Markers:
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
    places = places[distance[places] > APART * spacing(start, places)]
    if not 1 <= len(places) <= min(MOST, (len(seen) - 3) // 2) or median > LOOSE * size:
        return [], []
    gaps = np.linalg.norm(points[places][:, None] - start[places][None], axis=2)
    rows, columns = linear_sum_assignment(np.minimum(gaps, WRONG * FOUND * median) ** 2)
    near = np.minimum(FOUND * median, NEARER * distance[places])
    after = {int(i): int(j) for i, j in zip(rows, columns, strict=True) if gaps[i, j] <= near[i] and i != j}
    wrong, swaps = seen[places], list[Swap]()
    while after:
        first = next((i for i in after if i not in after.values()), min(after))
        chain, closed = [first], False
        while not closed and chain[-1] in after:
            following = after.pop(chain[-1])
            closed = following == first
            chain += [] if closed else [following]
        swaps.append(Swap(tuple(wrong[chain].tolist()), closed=closed))
    return swaps, wrong.tolist()


def moved(points: Array, start: Array) -> Array:
    """The points (k, 3), m, as a whole moved and turned onto most of their places (k, 3)."""
    generator = np.random.default_rng(0)
    judges = generator.choice(len(points), SAMPLE, replace=False) if len(points) > SAMPLE else np.arange(len(points))
    best, least = points, float(np.median(np.linalg.norm((points - start)[judges], axis=1)))
    tries = [generator.choice(judges, 3, replace=False) for _ in range(TRIPLES)]
    for chosen in (np.arange(len(points)), *tries):
        R, d = rigid(points[chosen], start[chosen])
        left = float(np.median(np.linalg.norm((points @ R.T + d - start)[judges], axis=1)))
        if left < (1.0 - 1e-9) * least:
            best, least = points @ R.T + d, left
    for _ in range(3):  # three markers are noisier than all that agree
        distance = np.linalg.norm(best - start, axis=1)
        good = distance <= WRONG / 2 * np.median(distance) + np.finfo(float).tiny
        if good.sum() < FEWEST:
            break
        R, d = rigid(best[good], start[good])
        best = best @ R.T + d
    return best


def spacing(start: Array, which: NDArray[np.intp]) -> Array:
    """How far some of the places (k, 3) are from the nearest other one, m."""
    gaps = np.array([np.partition(np.linalg.norm(start - start[i], axis=1), 1)[1] for i in which])
    return gaps.reshape(len(which))


def later_swaps(motion: Motion) -> list[Swap]:
    """Which vertices change places from one frame to the next; swaps of before are undone where later ones are."""
    found = list[Swap]()
    while len(found) < MOST:
        swap = next(changes(Markers(tuple(found)).applied(motion), found[-1].frame if found else 1), None)
        if swap is None:
            return found
        found.append(swap)
    return []  # no two markers change places so often


def changes(motion: Motion, first: int) -> Iterator[Swap]:
    """Two vertices that change places, from the frame `first` on."""
    for frame in range(first, len(motion.positions)):
        both = np.flatnonzero(motion.seen()[frame] & motion.seen()[frame - 1]) if motion.observed is not None else None
        rows = slice(None) if both is None else both
        now, before = motion.positions[frame, rows], motion.positions[frame - 1, rows]
        jump = np.linalg.norm(now - before, axis=1)
        if len(jump) < FEWEST:
            continue
        wide = np.flatnonzero(jump > SUDDEN * np.median(jump))
        if not 2 <= len(wide) <= min(len(jump) // 2, MOST):
            continue
        across = np.linalg.norm(now[wide][:, None] - before[wide][None], axis=2)
        other = np.argmin(across, axis=1)
        for i, j in ((i, int(j)) for i, j in enumerate(other) if other[j] == i < j):
            if across[i, j] + across[j, i] < EXCHANGE * (jump[wide[i]] + jump[wide[j]]):
                pair = wide[[i, j]] if both is None else both[wide[[i, j]]]
                yield Swap(tuple(sorted(pair.tolist())), frame)


def out_of_reach(scene: Scene, motion: Motion, suspects: list[int]) -> list[int]:
    """Those of the suspects that are farther from the markers around them than the cloth between them reaches."""
    found, first = [], 0
    for i, cloth in enumerate(scene.cloths):
        n = len(cloth.mass)
        own = [each - first for each in suspects if first <= each < first + n]
        seen = motion.seen(i)
        markers = np.flatnonzero(seen.any(axis=0))
        if own and len(markers) > FEWEST and len(markers) * n <= LARGEST:
            ratio = stretched(motion.of(i)[:, markers], seen[:, markers], ways(cloth.springs, cloth.rest, n, markers))
            limit = max(REACHES, FAR * float(np.nanmedian(ratio)))
            found += [first + each for each in own if ratio[np.searchsorted(markers, each)] > limit]
        first += n
    return found


def ways(springs: Indices, lengths: Array, n: int, markers: NDArray[np.intp]) -> Array:
    """The ways (k, k), m, along springs from each marker to each other one."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    graph = coo_array((np.maximum(lengths, 1e-12), springs.T), shape=(n, n)).tocsr()
    return np.asarray(dijkstra(graph, directed=False, indices=markers)[:, markers])


def stretched(points: Array, seen: Flags, way: Array) -> Array:
    """How far each marker (k,) is from the nearest others, relative to the way there: the median of these, each in the
    frames where that is largest.
    """
    near = np.where(np.eye(len(way), dtype=bool), np.inf, way)
    order = np.argsort(near, axis=1)[:, :NEAREST]
    ratio = np.full(order.shape, np.nan)
    for i, others in enumerate(order):
        both = seen[:, [i]] & seen[:, others]
        gaps = np.where(both, np.linalg.norm(points[:, [i]] - points[:, others], axis=2), np.nan) / near[i, others]
        known = both.any(axis=0) & np.isfinite(near[i, others])
        ratio[i, known] = np.nanquantile(gaps[:, known], 0.9, axis=0)
    return np.array([np.nanmedian(row) if np.isfinite(row).any() else np.nan for row in ratio])


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
    if len(motion.positions) < 5 or not len(lengths):
        return []
    long, found = float(np.median(lengths)), dict[int, set[int]]()
    x, observed = motion.positions, motion.observed
    for k in range(1, len(x) - 1):
        away = np.linalg.norm(x[k] - 0.5 * (x[k - 1] + x[k + 1]), axis=1)
        if observed is not None:
            away[~(observed[k - 1] & observed[k] & observed[k + 1])] = np.nan
        wide = np.flatnonzero(away > VISIBLE * long)
        if not 1 <= len(wide) <= MOST or np.isfinite(away).sum() < FEWEST:
            continue
        wide = wide[away[wide] > SPIKE * np.nanmedian(away)]
        back = np.linalg.norm(x[k + 1, wide] - x[k - 1, wide], axis=1) < BACK * away[wide]
        if 2 <= k < len(x) - 2:
            back |= alone(x[k - 2 : k + 3, wide])
        for vertex in wide[back]:
            found.setdefault(int(vertex), set()).add(k)
    for k in range(1, len(x) - 2):
        for vertex in twice(x[k - 1 : k + 3], None if observed is None else observed[k - 1 : k + 3], FARTHER * long):
            found.setdefault(int(vertex), set()).update((k, k + 1))
    return [Jump(vertex, tuple(sorted(frames))) for vertex, frames in sorted(found.items())]


def twice(x: Array, observed: Flags | None, least: float) -> NDArray[np.intp]:
    """The markers that are off their way in the two frames amid four, x (4, k, 3), by `least`, m, or more, and then
    back where they were but for a small part of that; not where many of them are.
    """
    away = np.stack([np.linalg.norm(x[i] - ((3 - i) * x[0] + i * x[3]) / 3.0, axis=1) for i in (1, 2)])
    if observed is not None:
        away[:, ~observed.all(axis=0)] = np.nan
    nearest = away.min(axis=0)
    if np.isfinite(nearest).sum() < FEWEST:
        return np.zeros(0, np.intp)
    wide = np.flatnonzero((nearest > least) & (away > SPIKE * np.nanmedian(away, axis=1)[:, None]).all(axis=0))
    if len(wide) > MOST:
        return np.zeros(0, np.intp)
    return np.asarray(wide[np.linalg.norm(x[3, wide] - x[0, wide], axis=1) < SOON * nearest[wide]])
