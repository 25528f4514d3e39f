"""LSTM and GRU in place of the layers of a network, for `networks.py`.

With u = [z₁, z₁ − z₂, w] scaled and a state h (and c), a step gives z = clip(z₁ + (z₁ − z₂) + s ⊙ (h⁺ W_o + b_o)):

    LSTM   i, f, o, g = σ, σ, σ, tanh of [u, h] W + b,   c⁺ = f c + i g,   h⁺ = o tanh c⁺
    GRU    a, k = σ of [u, h] W + b,   n = tanh([u, a h] V + d),   h⁺ = (1 − k) n + k h

S. Hochreiter, J. Schmidhuber, Neural Computation 9, 1997; K. Cho et al., EMNLP 2014. The state is 0 where a window or a
motion begins.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clothfit.base.arrays import Array


def sigmoid(x: Array) -> Array:
    """1/(1 + e⁻ˣ)."""
    return 0.5 * (1.0 + np.tanh(0.5 * x))


class Recurrent:
    """Values, steps and their transposes, with the state of all windows; a step counts from `begin`."""

    def __init__(self, kind: str, scale: tuple[Array, Array, Array], limits: Array, width: int, seed: int) -> None:
        """`kind` LSTM or GRU; `scale` the means and factors of u, and s; `limits` (2, r)."""
        self.mean, self.lift, self.left = (each.astype(np.float32) for each in scale)
        self.kind, self.width, self.r = kind, width, len(self.left)
        self.low, self.high = limits.astype(np.float32)
        rng, size = np.random.default_rng([seed, 0]), len(self.lift) + width
        gates = 4 if kind == "LSTM" else 2
        shapes = [(size, gates * width), (gates * width,), (width, self.r), (self.r,)]
        shapes += [(size, width), (width,)] if kind == "GRU" else []
        made = [rng.standard_normal(each) / np.sqrt(each[0]) * (len(each) > 1) for each in shapes]
        self.values = [each.astype(np.float32) for each in made]
        self.values[2] *= np.float32(0.1)
        if kind == "LSTM":
            self.values[1][width : 2 * width] = 1.0  # forget nothing at first

    @property
    def multiplications(self) -> int:
        """Of a step."""
        return sum(each.size for each in self.values if each.ndim == 2)

    def begin(self, count: int) -> None:
        """Forget everything, for so many windows."""
        self.h, self.c = (np.zeros((count, self.width), np.float32) for _ in range(2))
        self.by_h, self.by_c = np.zeros_like(self.h), np.zeros_like(self.h)

    def step(self, z1: Array, z2: Array, w: Array) -> tuple[Array, Any]:
        """The next coordinates (B, r), and what `pull` needs."""
        x = (np.concatenate([z1, z1 - z2, w], axis=1) - self.mean) * self.lift
        kept = (self.lstm if self.kind == "LSTM" else self.gru)(x)
        z = z1 + (z1 - z2) + self.left * (self.h @ self.values[2] + self.values[3])
        return np.clip(z, self.low, self.high), (kept, self.h, z < self.low, z > self.high)

    def lstm(self, x: Array) -> Any:
        """Advance the state."""
        both = np.concatenate([x, self.h], axis=1)
        gates = both @ self.values[0] + self.values[1]
        n = self.width
        i, f, o = (sigmoid(gates[:, k * n : (k + 1) * n]) for k in range(3))
        g = np.tanh(gates[:, 3 * n :])
        before, self.c = self.c, f * self.c + i * g
        top = np.tanh(self.c)
        self.h = o * top
        return both, i, f, o, g, before, top

    def gru(self, x: Array) -> Any:
        """Advance the state."""
        both = np.concatenate([x, self.h], axis=1)
        gates = sigmoid(both @ self.values[0] + self.values[1])
        a, k = gates[:, : self.width], gates[:, self.width :]
        inner = np.concatenate([x, a * self.h], axis=1)
        n = np.tanh(inner @ self.values[4] + self.values[5])
        before, self.h = self.h, (1.0 - k) * n + k * self.h
        return both, inner, a, k, n, before

    def pull(self, kept: Any, gz: Array, grad: list[Array]) -> tuple[Array, Array]:
        """Add the derivatives by all values to `grad`, for that by z (B, r); returns those by z₁ and z₂."""
        inside, h, below, above = kept
        g = np.where((below & (gz > 0)) | (above & (gz < 0)), 0.0, gz).astype(np.float32)
        out = g * self.left
        grad[2] += h.T @ out
        grad[3] += out.sum(axis=0)
        self.by_h = self.by_h + out @ self.values[2].T
        gx = (self.pull_lstm if self.kind == "LSTM" else self.pull_gru)(inside, grad) * self.lift
        r = self.r
        return 2.0 * g + gx[:, :r] + gx[:, r : 2 * r], -g - gx[:, r : 2 * r]

    def pull_lstm(self, inside: Any, grad: list[Array]) -> Array:
        """The derivative by x; those by the state before take the place of those after."""
        both, i, f, o, g, before, top = inside
        by_c = self.by_c + self.by_h * o * (1.0 - top * top)
        parts = [by_c * g * i * (1 - i), by_c * before * f * (1 - f)]
        parts += [self.by_h * top * o * (1 - o), by_c * i * (1 - g * g)]
        gates = np.concatenate(parts, axis=1)
        grad[0] += both.T @ gates
        grad[1] += gates.sum(axis=0)
        back = gates @ self.values[0].T
        size = both.shape[1] - self.width
        self.by_h, self.by_c = back[:, size:], by_c * f
        return back[:, :size]

    def pull_gru(self, inside: Any, grad: list[Array]) -> Array:
        """The same."""
        both, inner, a, k, n, before = inside
        by_n = self.by_h * (1.0 - k) * (1.0 - n * n)
        grad[4] += inner.T @ by_n
        grad[5] += by_n.sum(axis=0)
        back = by_n @ self.values[4].T
        size = both.shape[1] - self.width
        by_a = back[:, size:] * before * a * (1.0 - a)
        by_k = self.by_h * (before - n) * k * (1.0 - k)
        gates = np.concatenate([by_a, by_k], axis=1)
        grad[0] += both.T @ gates
        grad[1] += gates.sum(axis=0)
        more = gates @ self.values[0].T
        self.by_h = self.by_h * k + back[:, size:] * a + more[:, size:]
        return back[:, :size] + more[:, :size]
