"""Networks and models of them for tests."""

import itertools
import os
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.system import build
from clothfit.scene.scene import dumps
from clothfit.subspace.model import NETWORK, Model, Part
from clothfit.subspace.network.signals import fitted, raw
from clothfit.subspace.network.weights import Network
from clothfit.subspace.physics.samples import nothing
from helpers.subspaces import some


def network_of(system: Any, steps: int, r: int, hidden: tuple[int, ...] = (10, 7), activation: str = "elu",
               seed: int = 0) -> Network:  # fmt: skip
    """A network with random weights for the inputs of a system, whose linear part forgets."""
    rng = np.random.default_rng(seed)
    table = raw(system, steps)
    signals = fitted([table])
    w = signals.of(system, steps)
    m = w.shape[1]
    sizes = (2 * r + m, *hidden, r)
    linear = np.concatenate([0.9 * np.eye(r), 0.8 * np.eye(r), 0.02 * rng.standard_normal((m, r))])
    weights = [0.2 * rng.standard_normal(pair) / np.sqrt(pair[0]) for pair in itertools.pairwise(sizes)]
    biases = [0.1 * rng.standard_normal(size) for size in sizes[1:]]
    reach = np.stack([w.min(axis=0), w.max(axis=0)]) if m else np.zeros((2, 0))

    def single(array: Array) -> Any:
        return np.ascontiguousarray(array, np.float32)

    return Network(
        single(linear), single(0.01 * rng.standard_normal(r)), tuple(map(single, weights)), tuple(map(single, biases)),
        single(np.stack([np.full(r, -2.0), np.full(r, 2.0)])), single(reach), activation, signals,
    )  # fmt: skip


def model_of(scene: Any, steps: int, r: int = 6, **kind: Any) -> Model:
    """A model of a scene, whose networks have random weights and bases."""
    parts = []
    for c in range(len(scene.cloths)):
        system = build(scene, c, steps=steps)
        basis = some(system, r).astype(np.float32).astype(float)
        own = network_of(system, steps, r, **kind)
        parts.append(Part(basis, nothing(), np.asarray(own.range, float), network=own))
    limits = {"wind": [[-9.0] * 3, [9.0] * 3], "pins": [[-1.0] * 3, [1.0] * 3]}
    return Model(dumps(scene), os.path.abspath(scene.folder), tuple(parts), limits, {}, NETWORK)


def by_formula(own: Network, q: Array, before: Array, w: Array) -> Array:
    """The next coordinates, as the page of the network's file has them."""
    u = np.concatenate([q, q - before, w])
    h = u
    for k, (weight, bias) in enumerate(zip(own.weights, own.biases, strict=True)):
        h = h @ weight + bias
        if k < len(own.weights) - 1:
            h = np.maximum(h, 0.0) if own.activation == "relu" else np.where(h > 0, h, np.expm1(np.minimum(h, 0.0)))
    low, high = own.range
    return np.clip(u @ own.linear + own.offset + h, low, high)
