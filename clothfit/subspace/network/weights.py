"""A network that steps the coordinates of a cloth, as plain arrays: what a player needs, and what MODEL holds.

With q₁, q₂ the coordinates (r,) of the last frame and of the one before, and w (m,) what acts on the step,

    u = [q₁, q₁ − q₂, w],   h₀ = u,   h_k = a(h_{k−1} W_k + b_k),   q = clip(u L + l + h_{K−1} W_K + b_K, low, high).

u L + l is the linear part (the prior of the paper, z̄), the rest the correction Φ. Scales of the data are folded into
the arrays. a is ReLU or ELU, a(s) = s for s > 0, else 0 or eˢ − 1. Inputs are clipped to their range first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.subspace.network.signals import Signals

Single = NDArray[np.float32]

ACTIVATIONS = ("relu", "elu")


@dataclass(frozen=True, eq=False)
class Network:
    """The arrays, single precision but for the signals."""

    linear: Single  # L, (2 r + m, r)
    offset: Single  # l, (r,)
    weights: tuple[Single, ...]  # W_k, (inputs, outputs) each; K of them
    biases: tuple[Single, ...]  # b_k, (outputs,)
    range: Single  # (2, r), low and high
    input_range: Single  # (2, m), of w
    activation: str  # of ACTIVATIONS
    signals: Signals  # how w follows from the inputs of a scene

    @property
    def r(self) -> int:
        """Number of coordinates."""
        return len(self.offset)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return int(self.input_range.shape[1])

    @property
    def nbytes(self) -> int:
        """Bytes of all that a step reads."""
        return sum(each.nbytes for each in (self.linear, self.offset, *self.weights, *self.biases))


def arrays(own: Network, c: int) -> dict[str, Any]:
    """The arrays of object c by their names in the file."""
    found: dict[str, Any] = {
        f"linear{c}": own.linear, f"offset{c}": own.offset, f"range{c}": own.range,
        f"input_range{c}": own.input_range,
    }  # fmt: skip
    for k, (weight, bias) in enumerate(zip(own.weights, own.biases, strict=True)):
        found |= {f"weight{c}.{k}": weight, f"bias{c}.{k}": bias}
    return found | {f"signal_mean{c}": own.signals.mean, f"signal_mix{c}": own.signals.mix}


def names(layers: int, c: int) -> list[str]:
    """The names of these arrays for so many layers."""
    layer = [f"{kind}{c}.{k}" for k in range(layers) for kind in ("weight", "bias")]
    return [f"{each}{c}" for each in ("linear", "offset", "range", "input_range", "signal_mean", "signal_mix")] + layer


def described(own: Network) -> dict[str, Any]:
    """What the head of the file says of it."""
    return {"layers": len(own.weights), "activation": own.activation, "signals": [list(e) for e in own.signals.parts]}


def from_arrays(held: Mapping[str, Any], about: Mapping[str, Any], c: int) -> Network:
    """The network of object c from a file's arrays and head. Raises KeyError, TypeError or ValueError."""

    def of(name: str) -> Single:
        return np.ascontiguousarray(held[name], np.float32)

    count = int(about["layers"])
    parts = tuple((str(name), int(size)) for name, size in about["signals"])
    signals = Signals(parts, np.asarray(held[f"signal_mean{c}"], float), np.asarray(held[f"signal_mix{c}"], float))
    weights = tuple(of(f"weight{c}.{k}") for k in range(count))
    biases = tuple(of(f"bias{c}.{k}") for k in range(count))
    reach, given = of(f"range{c}"), of(f"input_range{c}")
    return Network(of(f"linear{c}"), of(f"offset{c}"), weights, biases, reach, given, str(about["activation"]), signals)


def fits(own: Network, r: int) -> bool:
    """Whether the shapes fit each other and r coordinates, and all is finite."""
    shaped = own.offset.shape == (r,) and own.range.shape == (2, r) and own.input_range.ndim == 2
    shaped = shaped and len(own.input_range) == 2 and own.linear.shape == (2 * r + own.m, r)
    shaped = shaped and own.activation in ACTIVATIONS and len(own.weights) > 0 and own.signals.fits(own.m)
    if not shaped:
        return False
    size = 2 * r + own.m
    for weight, bias in zip(own.weights, own.biases, strict=True):
        if weight.ndim != 2 or len(weight) != size or bias.shape != (weight.shape[1],):
            return False
        size = weight.shape[1]
    every: list[Array | Single] = [own.linear, own.offset, own.range, own.input_range, *own.weights, *own.biases]
    return size == r and all(bool(np.isfinite(each).all()) for each in every)
