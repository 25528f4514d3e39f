"""The linear part of a network, by least squares over all recorded steps, and the scales that follow from it.

The paper's is z̄ = α ⊙ z₁ + β ⊙ (z₁ − z₂), each component for itself; the other one takes all of u = [z₁, z₁ − z₂, w]
and a constant, with a ridge: what is left of a step after z₁ + (z₁ − z₂), z − 2 z₁ + z₂, is as small as it should be
where hardly anything moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array
from clothfit.subspace.network.windows import Motions

RIDGE = 1e-10
"""Of the squares of each column of u."""

LEAST = 1e-2
"""Of the largest scale is each: what hardly moves is not blown up."""


@dataclass(frozen=True, eq=False)
class Linear:
    """z̄ = u L + l, and the scales of what the layers take and give."""

    matrix: Array  # L, (2 r + m, r)
    offset: Array  # l, (r,)
    mean: Array  # μ, (2 r + m,)
    lift: Array  # F, (2 r + m, f), or the diagonal of it
    left: Array  # s, (r,), the RMS of what it leaves out

    @property
    def features(self) -> int:
        """What the layers take."""
        return int(self.lift.shape[-1])

    @property
    def radius(self) -> float:
        """The spectral radius of the step z₁, z₂ → z, z₁."""
        r = len(self.offset)
        a, b = self.matrix[:r].T, self.matrix[r : 2 * r].T
        step = np.block([[a + b, -b], [np.eye(r), np.zeros((r, r))]])
        return float(np.abs(np.linalg.eigvals(step)).max())


def dense(motions: Motions) -> Linear:
    """That of all coordinates and inputs."""
    now, way, w, after = motions.steps()
    r = now.shape[1]
    u = np.concatenate([now, way, w], axis=1)
    columns = np.concatenate([u, np.ones((len(u), 1))], axis=1)
    gram = columns.T @ columns
    gram[np.diag_indices(len(gram) - 1)] *= 1.0 + RIDGE * 1e2
    gram[np.diag_indices(len(gram))] += RIDGE * np.append(np.diag(gram)[:-1], 0.0) + 1e-30
    found = np.linalg.lstsq(gram, columns.T @ (after - now - way), rcond=1e-13)[0]
    matrix = found[:-1].copy()
    matrix[:r] += np.eye(r)
    matrix[r : 2 * r] += np.eye(r)
    left = after - (u @ matrix + found[-1])
    deviations = [floored(part.std(axis=0)) for part in (now, way)]
    reach = np.maximum(w.std(axis=0), 1e-12)
    mean = np.concatenate([now.mean(axis=0), np.zeros(r), w.mean(axis=0)])
    return Linear(matrix, found[-1], mean, 1.0 / np.concatenate([*deviations, reach]), rms(left))


def diagonal(motions: Motions) -> Linear:
    """That of the paper; the layers take [z̄, z₁, w], inputs relative to their deviations."""
    now, way, w, after = motions.steps()
    r, m = now.shape[1], w.shape[1]
    nn, nw, ww = ((a * b).sum(axis=0) for a, b in ((now, now), (now, way), (way, way)))
    na, wa = (now * after).sum(axis=0), (way * after).sum(axis=0)
    det = np.maximum(nn * ww - nw * nw, 1e-300)
    alpha, beta = (na * ww - wa * nw) / det, (wa * nn - na * nw) / det
    matrix = np.concatenate([np.diag(alpha), np.diag(beta), np.zeros((m, r))])
    lift = np.zeros((2 * r + m, 2 * r + m))
    lift[:, :r] = matrix
    lift[:r, r : 2 * r] = np.eye(r)
    lift[2 * r :, 2 * r :] = np.diag(1.0 / np.maximum(w.std(axis=0), 1e-12))
    left = after - np.concatenate([now, way, w], axis=1) @ matrix
    return Linear(matrix, np.zeros(r), np.zeros(2 * r + m), lift, np.full(r, float(rms(left).max())))


def rms(x: Array) -> Array:
    """Of each column."""
    return np.asarray(np.sqrt((x**2).mean(axis=0)))


def floored(scale: Array) -> Array:
    """Scales, none of them far below the largest."""
    return np.maximum(scale, max(LEAST * float(scale.max(initial=0.0)), 1e-12))
