"""The basis U of a subspace: proper orthogonal decomposition of recorded motions, and the lowest vibration modes.

With displacements d (n, 3) of the free vertices, weighted by masses, the r vectors that leave out least of all frames
are the leading eigenvectors of Σ √M d dᵀ √M, or, where there are fewer frames than coordinates, follow from those of
the matrix of all products of two frames. Either is summed up motion by motion, so that no more than two motions are in
memory. Fixed vertices have rows of 0, and the state at the start is q = 0: both are exact. Uᵀ M U = 1.

A cloth that flutters moves its energy to shapes that are small but quick. For such ones the changes from frame to frame
count as well, scaled so that all together weigh a part `changes` of the frames.

L. Sirovich, Q. Appl. Math. 45, 561, 1987. Vibration modes take the place of the last few vectors: what the recorded
motions hardly show can still move.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput
from clothfit.engine.system import System
from clothfit.subspace.recording import Data
from clothfit.subspace.translation import relative

MOST_FRAMES, WORK = 1500, 1e10
"""Frames that the decomposition sees, spread over all motions, and multiplications within which it sees more: those of
small cloths cost little, and few frames of many motions miss how these go on.
"""

SIZES = (4, 8, 16, 24, 32, 48, 64, 96, 128, 192, 256)
"""For the table of what is left out."""

MODES = 16
"""One of so many vectors is a vibration mode."""

ROUNDING = 1e-7
"""Relative size of a vector that is nothing but rounding, or nothing new."""


Rows: TypeAlias = Callable[[int], Array]
"""What gives the frames (F, 3 m) of an episode."""


class Decomposition(NamedTuple):
    """Vectors in the order of how much of the motions they hold."""

    vectors: Array  # (n, 3, k), Uᵀ M U = 1
    left_out: Array  # (k + 1,), m: RMS over frames and vertices, weighted by mass, without all but the first vectors


def frames_of(data: Data, cloth: int, episode: int, system: System, most: int) -> Array:
    """Some of the good frames of a motion, (F, n, 3), m, without what carries it."""
    x, good = data.motion(episode, cloth)
    x = relative(x, system)
    kept = np.flatnonzero(good)
    return np.asarray(x[kept[:: max(1, -(-len(kept) // most))]])


def decompose(
    data: Data, cloth: int, systems: Sequence[System], most: int, episodes: Sequence[int], changes: float = 0.0
) -> Decomposition:
    """At most `most` vectors from some episodes, with the system of each. Raises InvalidInput where nothing moves."""
    system, inputs = systems[0], dict(zip(episodes, systems, strict=True))
    free = system.vertex.free
    root = np.sqrt(system.vertex.mass[free])[:, None]
    size = 3 * len(root)
    each = max(2, max(MOST_FRAMES, int(WORK / size**2)) // len(episodes))

    def of_frames(episode: int) -> Array:
        interrupts.check()
        frames = frames_of(data, cloth, episode, inputs[episode], each)
        return np.asarray((frames[:, free] * root).reshape(-1, size))

    def of_changes(episode: int) -> Array:
        x, good = data.motion(episode, cloth)
        x = relative(x, inputs[episode])
        kept = np.flatnonzero(good[1:] & good[:-1])[:: max(1, -(-len(x) // each))]
        return np.asarray(((x[kept + 1] - x[kept])[:, free] * root).reshape(-1, size))

    def weighted(episode: int) -> Array:
        return np.concatenate([of_frames(episode), scale * of_changes(episode)]) if scale else of_frames(episode)

    scale = 0.0
    if changes:
        still, moved = (sum(float((of(e) ** 2).sum()) for e in episodes) for of in (of_frames, of_changes))
        scale = changes * float(np.sqrt(still / moved)) if moved > 0 else 0.0
    ends = np.cumsum([0, *(len(weighted(episode)) for episode in episodes)])
    tall = size <= ends[-1]
    gram = reduce(np.add, (d.T @ d for d in map(weighted, episodes))) if tall else by_frames(weighted, episodes, ends)
    values, vectors = np.linalg.eigh(gram)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    count = min(most, int(np.count_nonzero(values > ROUNDING**2 * max(values[0], 1e-300))))
    if count == 0:
        raise InvalidInput("nothing moves in the recorded motions; a subspace needs inputs that move the cloth")
    if not tall:
        mix = vectors[:, :count] / np.sqrt(values[:count])
        parts = zip(episodes, pairwise(ends), strict=True)
        vectors = reduce(np.add, (weighted(e).T @ mix[a:b] for e, (a, b) in parts))
    made = np.zeros((len(free), 3, count))
    made[free] = (vectors[:, :count]).reshape(-1, 3, count) / root[:, :, None]
    frames, squares, held = int(ends[-1]), values.sum(), values[:count]
    if scale:  # of the frames alone
        frames, squares, held = 0, 0.0, np.zeros(count)
        for own in map(of_frames, episodes):
            frames, squares = frames + len(own), squares + float((own**2).sum())
            held += ((own @ vectors[:, :count]) ** 2).sum(axis=0)
    rest = squares - np.concatenate([[0.0], np.cumsum(held)])
    return Decomposition(made, np.sqrt(np.maximum(rest, 0.0) / (frames * float((root**2).sum()))))


def by_frames(weighted: Rows, episodes: Sequence[int], ends: Indices) -> Array:
    """All products of two frames, (F, F)."""
    gram = np.zeros((ends[-1], ends[-1]))
    for i, episode in enumerate(episodes):
        d = weighted(episode)
        for j in range(i + 1):
            other = d if j == i else weighted(episodes[j])
            gram[ends[i] : ends[i + 1], ends[j] : ends[j + 1]] = d @ other.T
    return np.asarray(np.tril(gram) + np.tril(gram, -1).T)


def vibration(system: System, x: Array, count: int) -> Array:
    """The lowest vibration modes (n, 3, count) at positions x (n, 3), with the springs' stiffness as if none were
    compressed.
    """
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.linalg import eigsh

    free, (a, b) = system.vertex.free, system.springs.ends.T
    e = x[a] - x[b]
    length = np.maximum(np.linalg.norm(e, axis=1), 1e-300)
    d, rho = e / length[:, None], np.minimum(system.springs.rest / length, 1.0)
    outer = rho[:, None, None] * d[:, :, None] * d[:, None, :]
    block = system.springs.stiffness[:, None, None] * ((1.0 - rho)[:, None, None] * np.eye(3) + outer)
    row, column = (np.concatenate(each) for each in ([a, b, a, b], [a, b, b, a]))
    values = np.concatenate([block, block, -block, -block])
    axis = np.arange(3)
    rows, columns = np.broadcast_arrays(3 * row[:, None, None] + axis[:, None], 3 * column[:, None, None] + axis)
    size = 3 * len(x)
    K = coo_array((values.ravel(), (rows.ravel(), columns.ravel())), (size, size)).tocsc()
    kept = np.flatnonzero(np.repeat(free, 3))
    root = diags_array(1.0 / np.sqrt(np.repeat(system.vertex.mass[free], 3)))
    own = (root @ K[kept][:, kept] @ root).tocsc()
    scale = float(own.diagonal().mean())
    _, modes = eigsh(own, k=count, sigma=-1e-6 * scale, v0=np.ones(len(kept)))
    made = np.zeros((len(x), 3, count))
    made[free] = np.asarray(root @ modes).reshape(-1, 3, count)
    return made


def orthonormal(vectors: Array, mass: Array, first: int) -> Array:
    """Vectors (n, 3, k) with Uᵀ M U = 1; the first ones have it already, of the others what is not new is left out."""
    flat = (vectors * np.sqrt(mass)[:, None, None]).reshape(-1, vectors.shape[2])
    kept = [flat[:, i] for i in range(first)]
    for i in range(first, flat.shape[1]):
        v = flat[:, i]
        size = np.linalg.norm(v)
        for _ in range(2):
            done = np.stack(kept, axis=1) if kept else np.zeros((len(v), 0))
            v = v - done @ (done.T @ v)
        if np.linalg.norm(v) > 10 * ROUNDING * size:
            kept.append(v / np.linalg.norm(v))
    own = np.stack(kept, axis=1).reshape(len(mass), 3, -1)
    return np.ascontiguousarray(own / np.sqrt(mass)[:, None, None])


def enriched(found: Decomposition, system: System, size: int, x: Array, modes: int | None = None) -> Array:
    """A basis (n, 3, r) of at most `size` vectors: most from motions, the others vibration modes at x (n, 3)."""
    free: Flags = system.vertex.free
    asked = size // MODES if modes is None else modes
    room = max(0, min(asked, 3 * int(free.sum()) - 2))
    first = min(size - room, found.vectors.shape[2])
    if room == 0:
        return np.ascontiguousarray(found.vectors[:, :, :first])
    more = vibration(system, x, room)
    made = orthonormal(np.concatenate([found.vectors[:, :, :first], more], axis=2), system.vertex.mass, first)
    return made[:, :, :size]
