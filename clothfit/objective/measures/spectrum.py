"""Spectra: each vertex should swing as strongly at each frequency as in the target, at whatever phase.

With y_f = w_f (s_f − x₀), w the Hann window over the F frames scaled to Σ w² = F, and q = 0 … F/2 the frequencies,

    C_q = c_q Σ_f y_f cos(2π q f / F),   S_q = c_q Σ_f y_f sin(2π q f / F),   A_q = sqrt(C_q² + S_q² + ε²) − ε

for each coordinate; d = A − A*, m; a group is a vertex at a frequency. c_q² = 2/F (1/F at q = 0 and F/2, which have no
mirror image), so that by Parseval's theorem Σ_q C_q² + S_q² = Σ_f y_f²: the numbers are as large as those of positions.
ε rounds off the tip at amplitude 0, where a length has no derivative.

The cost does not depend on the phase, so it is smoother than that of positions where two motions are out of step. The
frames must be equally spaced, and a vertex that is not observed in all of them is left out.
Reference: F. J. Harris, On the use of windows for harmonic analysis with the discrete Fourier transform,
Proceedings of the IEEE 66 (1978).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidMotion
from clothfit.engine.system import System
from clothfit.motion.times import TIME_SLACK
from clothfit.objective.measures.measure import coordinates, matrix
from clothfit.objective.target import Target

if TYPE_CHECKING:
    from scipy.sparse import csr_array

EPSILON = 1e-6
"""ε, m: smaller than any capture resolves."""

FEWEST_FRAMES = 4
"""With fewer frames a spectrum means nothing."""


class Spectrum:
    """Differences of amplitudes; R = frequencies × vertices seen throughout, c = 3 coordinates."""

    linear = False

    def __init__(self, goal: Target, system: System, name: str) -> None:
        check_grid(goal, name)
        throughout: Flags = np.asarray(goal.observed.all(axis=0))
        self.vertices = np.flatnonzero(throughout)
        self.start = system.x0[self.vertices]
        self.basis = basis(len(goal.step))
        self.reach = len(goal.step)
        self.groups = self.basis.shape[1] * len(self.vertices)
        self.goal = self._amplitudes(goal.positions)[0]
        self.seen: Flags = throughout & (goal.places[-1] > 0)
        self.weights: Array | None = None
        if len(goal.weights):
            self.weights = np.tile(goal.weights[:, self.vertices].mean(axis=0), self.basis.shape[1])

    def _amplitudes(self, s: Array) -> tuple[Array, Array]:
        """A (Q V, 3), and its derivative by C and S (2, Q, V, 3), for V vertices and Q frequencies."""
        parts = np.tensordot(self.basis, s[:, self.vertices] - self.start, axes=1)
        root = np.sqrt((parts**2).sum(axis=0) + EPSILON**2)
        return (root - EPSILON).reshape(-1, 3), parts / root

    def residual(self, s: Array) -> Array:
        """Difference of the amplitudes (R, 3), m."""
        return self._amplitudes(s)[0] - self.goal

    def pullback(self, s: Array, r: Array) -> Array:
        """Jᵀ r (F, n, 3)."""
        out, derivative = np.zeros_like(s), self._amplitudes(s)[1]
        pulled = derivative * r.reshape(derivative.shape[1:])
        out[:, self.vertices] = np.tensordot(self.basis, pulled, axes=((0, 1), (0, 1)))
        return out

    def jacobian(self, s: Array) -> csr_array:
        """J (3 R, 3 F n): each amplitude depends on its coordinate in all frames."""
        derivative = self._amplitudes(s)[1]
        values = np.einsum("pqf,pqvc->qvcf", self.basis, derivative)
        frames, vertices = np.meshgrid(np.arange(len(s)), self.vertices, indexing="ij")
        columns = coordinates(frames.ravel(), vertices.ravel(), s.shape[1]).reshape(len(s), -1, 3).transpose(1, 2, 0)
        rows = np.arange(derivative[0].size).reshape(*derivative.shape[1:], 1)
        return matrix(rows, columns, values, (derivative[0].size, s.size))


def basis(frames: int) -> Array:
    """c_q w_f cos and c_q w_f sin of 2π q f / F, (2, Q, F)."""
    f, q = np.arange(frames), np.arange(frames // 2 + 1)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * f / frames)
    window /= np.sqrt((window**2).mean())
    alone = (q == 0) | (2 * q == frames)
    scale = np.sqrt(np.where(alone, 1.0, 2.0) / frames)
    angle = 2.0 * np.pi * (np.outer(q, f) % frames) / frames
    return np.asarray(scale[:, None] * window * np.stack([np.cos(angle), np.sin(angle)]))


def check_grid(goal: Target, name: str) -> None:
    """Raise InvalidMotion unless the frames are equally spaced and enough."""
    if len(goal.step) < FEWEST_FRAMES:
        raise InvalidMotion(
            f"{name}: {len(goal.step)} of its frames are compared; the spectrum needs at least {FEWEST_FRAMES}"
        )
    gaps = np.diff(goal.places)
    wrong = np.abs(gaps - gaps.mean()) > 2 * TIME_SLACK
    if wrong.any():
        raise InvalidMotion(
            f"{name}: times[{int(np.argmax(wrong)) + 1}]: the spectrum needs frames at equal distances in time"
        )
