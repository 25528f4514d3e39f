"""Changes of a network's training that did not help, for `networks.py`.

Held    the spectral radius of the linear part is held at 1 or below
Guided  the error of the projected physics is a part of the loss

Without inputs the linear part is z = P z₁ + Q z₂ with P = (L₁ + L₂)ᵀ and Q = −L₂ᵀ, where L₁ and L₂ are the rows of L
for z₁ and z₁ − z₂. Its free motions are v λᵗ with λ² v = λ P v + Q v, 2 r of them. Where some |λ| is above 1, each such
λ goes to the nearest point of the circle; all others, and all shapes v, stay:

    [P Q] ← V Λ′² [V Λ′; V]⁻¹,   V (r, 2 r) the shapes, Λ′ the λ held.

This is done now and then between the steps of the descent: a parametrisation that keeps all λ within the circle (by a
Lyapunov inequality) would also bend the descent where nothing is near it. Where two motions with one shape would fall
on the same λ there are no such P and Q; then P ← s P and Q ← s² Q, which shrinks all λ by s.

The error of the physics at frames z₂, z₁, z that a network has played is |z − z*|, z* the projected implicit step from
z₁ with the velocity (z₁ − z₂)/h: z − z* = h A⁻¹ r, r the residual A ω − b of that step at ω = (z − z₁)/h. Its gradient
by all three frames is exact, by the adjoint of the step.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.subspace.network.training import Training
from clothfit.subspace.network.unrolled import TINY, Loss
from clothfit.subspace.physics.adjoint import Backward, Trajectory
from clothfit.subspace.physics.reduced import Reduced, State

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


class WithPhysics:
    """A loss to which the mean error of the physics is added, at some frames of the windows."""

    def __init__(self, loss: Loss, runs: Sequence[Reduced], size: float, count: int) -> None:
        """`runs`, the projected cloth of each motion; `size` of the coordinates; errors at `count` frames."""
        self.loss, self.runs, self.size, self.count = loss, runs, size, count
        self.back = [Backward(each) for each in runs]
        self.rng = np.random.default_rng(0)
        self.chosen: Array = np.zeros((0, 2), int)  # motion and first frame of each window

    def of(self, made: Array, given: Array, first: Array, last: Array) -> tuple[float, Array]:
        """The error and its derivative, as those of `Loss`."""
        error, grad = self.loss.of(made, given, first, last)
        if made.shape[1] < 3:
            return error, grad
        weight = self.loss.velocity / self.count
        for _ in range(self.count):
            i, k = int(self.rng.integers(len(made))), int(self.rng.integers(2, made.shape[1]))
            motion, start = self.chosen[i]
            if motion < len(self.runs):  # the others come to rest
                more, by = self.at(int(motion), int(start) + k, made[i, k - 2 : k + 1].astype(float) * self.size)
                error += weight * more / self.size
                grad[i, k - 2 : k + 1] += weight * by
        return error, grad

    def at(self, motion: int, t: int, frames: Array) -> tuple[float, Array]:
        """|z − z*| in step t of a motion, for frames z₂, z₁, z (3, r), and its derivative by them."""
        own = self.runs[motion]
        now = State(frames[1], (frames[1] - frames[0]) / own.h, None, t)
        after, iterations = own.advance(now)
        away = frames[2] - after.q
        norm = float(np.sqrt(away @ away + TINY))
        by_q, by_p = np.zeros((2, own.r)), np.zeros((2, own.r))
        by_q[1] = -away / norm
        self.back[motion].step(Trajectory([now, after], [iterations]), 0, by_q, by_p)
        return norm, np.stack([-by_p[0] / own.h, by_q[0] + by_p[0] / own.h, away / norm])


class Guided(Training):
    """A training with the error of the physics in its loss."""

    def draw(self, length: int) -> tuple[Array, Array]:
        """Windows at random, which the loss gets to know."""
        starts, length = self.starts(length)
        self.loss.chosen = starts[self.state.rng.integers(0, len(starts), self.recipe.batch)]  # type: ignore[misc, attr-defined]
        return self.motions.windows(self.loss.chosen, length)  # type: ignore[attr-defined]


def changed(training: Training, kind: type[Training], **fields: Any) -> Training:
    """The training as one of another kind, with other fields."""
    own = {each.name: getattr(training, each.name) for each in dataclasses.fields(training)}
    return kind(**own | fields)
