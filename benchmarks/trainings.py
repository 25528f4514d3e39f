"""A change of a network's training that did not help, for `networks.py`: the spectral radius of the linear part is held
at 1 or below.

Without inputs the linear part is z = P z₁ + Q z₂ with P = (L₁ + L₂)ᵀ and Q = −L₂ᵀ, where L₁ and L₂ are the rows of L
for z₁ and z₁ − z₂. Its free motions are v λᵗ with λ² v = λ P v + Q v, 2 r of them. Where some |λ| is above 1, each such
λ goes to the nearest point of the circle; all others, and all shapes v, stay:

    [P Q] ← V Λ′² [V Λ′; V]⁻¹,   V (r, 2 r) the shapes, Λ′ the λ held.

This is done now and then between the steps of the descent: a parametrisation that keeps all λ within the circle (by a
Lyapunov inequality) would also bend the descent where nothing is near it. Where two motions with one shape would fall
on the same λ there are no such P and Q; then P ← s P and Q ← s² Q, which shrinks all λ by s.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.subspace.network.training import Training

EVERY = 25
"""Rounds of a training from one time that λ are held to the next."""

SINGULAR = 1e-9
"""The least singular value, relative to the largest, with which an inverse is still one."""

SLACK = 1e-9
"""Above 1 that is rounding."""


def companion(matrix: Array) -> Array:
    """The step (2 r, 2 r) z₁, z₂ → z, z₁ of a linear part L (2 r + m, r)."""
    r = matrix.shape[1]
    a, b = matrix[:r].T.astype(float), matrix[r : 2 * r].T.astype(float)
    return np.block([[a + b, -b], [np.eye(r), np.zeros((r, r))]])


def radius(matrix: Array) -> float:
    """The spectral radius of a linear part."""
    return float(np.abs(np.linalg.eigvals(companion(matrix))).max())


def hold(matrix: Array) -> None:
    """Change a linear part (2 r + m, r) in place so that its spectral radius is at most 1."""
    r = matrix.shape[1]
    values, shapes = np.linalg.eig(companion(matrix))
    size = np.abs(values)
    largest = float(size.max())
    if not largest > 1.0 + SLACK:
        return
    held = values / np.maximum(size, 1.0)
    v = shapes[r:] / np.linalg.norm(shapes[r:], axis=0)
    pairs = np.concatenate([v * held, v])
    spread = np.linalg.svd(pairs, compute_uv=False)
    if spread[-1] > SINGULAR * spread[0]:
        both = np.linalg.solve(pairs.T, (v * held**2).T).real  # (2 r, r): P, Q transposed
        p, q = both[:r], both[r:]
    else:
        p = (matrix[:r] + matrix[r : 2 * r]) / largest
        q = -matrix[r : 2 * r] / largest**2
    matrix[:r], matrix[r : 2 * r] = p + q, -q


class Held(Training):
    """A training whose linear part does not grow."""

    def round(self, done: float) -> None:
        """One step of the descent."""
        super().round(done)
        if self.state.rounds % EVERY == 0:
            hold(self.own.linear)


def changed(training: Training, kind: type[Training], **fields: Any) -> Training:
    """The training as one of another kind, with other fields."""
    own = {each.name: getattr(training, each.name) for each in dataclasses.fields(training)}
    return kind(**own | fields)
