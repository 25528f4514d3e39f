"""The network of D. Holden, B. C. Duong, S. Datta, D. Nowrouzezahrai, Subspace Neural Physics, SCA 2019, for
`networks.py`: ten layers of ReLU on [z̄, z₁, w] with z̄ = α ⊙ z₁ + β ⊙ (z₁ − z₂), trained by mean absolute errors and
AMSGrad (S. J. Reddi, S. Kale, S. Kumar, ICLR 2018).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.subspace.network.layers import Linear, Loss, Motions, Recipe, Trained, rms
from clothfit.subspace.network.learn import TrainingData, prepared
from clothfit.subspace.network.training import FIRST, LEAST, SECOND, Descent, State, Training
from trainings import changed

PAPER = Recipe(hidden=(1.5,) * 9, windows=(32, 32), least=0.0, batch=16, rate=1e-4, noise=0.01, shake=1.0,
               velocity=1.0, clip=np.inf, margin=0.0, rests=False)  # fmt: skip
DECAY = 0.999
"""Of the rate with each pass through the data."""


def diagonal(motions: Motions) -> Linear:
    """z̄ by least squares, each component for itself; the layers take [z̄, z₁, w], inputs by their deviations."""
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


class Layers(Trained):
    """The values, whose linear part stays as it is."""

    @property
    def values(self) -> list[Array]:
        """All that is trained."""
        return [*self.weights, *self.biases]

    def step(self, z1: Array, z2: Array, w: Array) -> tuple[Array, Any]:
        """The next coordinates (B, r), and what `pull` needs."""
        u = np.concatenate([z1, z1 - z2, w], axis=1)
        kept = [u @ self.lift]
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            kept.append(np.maximum(kept[-1] @ weight + bias, 0.0))
        z = u @ self.linear + self.left * (kept[-1] @ self.weights[-1] + self.biases[-1])
        return np.clip(z, self.low, self.high), (kept, z < self.low, z > self.high)

    def pull(self, kept: Any, gz: Array, grad: list[Array]) -> tuple[Array, Array]:
        """Add the derivatives by all values to `grad`, for that by z, gz (B, r); returns those by z₁ and z₂."""
        layers, below, above = kept
        g = np.where((below & (gz > 0)) | (above & (gz < 0)), 0.0, gz).astype(self.kind)
        count, r, gh = len(self.weights), self.r, g * self.left
        for k in range(count - 1, -1, -1):
            grad[k] += layers[k].T @ gh
            grad[count + k] += gh.sum(axis=0)
            gh = gh @ self.weights[k].T
            if k:
                gh *= layers[k] > 0
        gu = g @ self.linear.T + gh @ self.lift.T
        return gu[:, :r] + gu[:, r : 2 * r], -gu[:, r : 2 * r]


class Absolute(Loss):
    """Mean absolute errors of all components."""

    def mean(self, away: Array) -> tuple[float, Array]:
        """The mean error, and its derivative."""
        return float(np.abs(away).mean()), np.sign(away) / away.size


class AMSGrad(Descent):
    """Adam whose denominator never falls."""

    def __init__(self, values: Sequence[Array]) -> None:
        super().__init__(values)
        self.largest = [np.zeros_like(each) for each in values]

    def step(self, values: Sequence[Array], grad: Sequence[Array], rate: float) -> None:
        """Change the values along their gradients."""
        self.count += 1
        unbiased = np.sqrt(1.0 - SECOND**self.count)
        size = rate * unbiased / (1.0 - FIRST**self.count)
        for k, (value, g) in enumerate(zip(values, grad, strict=True)):
            self.mean[k] += (1.0 - FIRST) * (g - self.mean[k])
            self.square[k] += (1.0 - SECOND) * (g * g - self.square[k])
            np.maximum(self.largest[k], self.square[k], out=self.largest[k])
            value -= size * self.mean[k] / (np.sqrt(self.largest[k]) + LEAST * unbiased)


class Schooled(Training):
    """Both frames that a window begins with have noise of their own, and the rate falls with each pass."""

    def begin(self, frames: Array) -> Array:
        """The first two frames (B, 2, r) with noise."""
        noise = self.noise * self.state.rng.standard_normal((2, *frames[:, 0].shape))
        return frames + noise.swapaxes(0, 1).astype(frames.dtype)

    def rate(self, done: float) -> float:
        """The rate of the descent."""
        recipe = self.recipe
        passes = self.state.rounds * recipe.batch * recipe.windows[1] / max(1, int(self.motions.good.sum()))
        return float(recipe.rate * DECAY**passes)


def schooled(given: TrainingData) -> tuple[Training, float]:
    """A training at its beginning, and the size of the coordinates."""
    training, size = prepared(given, PAPER, 0)
    motions = training.motions.scaled(1.0, float)
    rng, kind = np.random.default_rng([0, 0]), training.motions.z.dtype.type
    own = Layers(diagonal(motions), PAPER, np.stack([training.own.low, training.own.high]), rng, kind)
    deviations = motions.z[motions.good].std(axis=0)
    noise = np.full(len(deviations), PAPER.noise * deviations[:3].mean(), kind)
    state = State(own.values, AMSGrad(own.values), np.random.default_rng([0, 1]), [v.copy() for v in own.values])
    return changed(training, Schooled, own=own, noise=noise, loss=Absolute(training.loss.velocity), state=state), size
