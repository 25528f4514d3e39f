"""Make a motion look like a capture: noise, vertices that no camera saw, skipped frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clothfit.errors import InvalidInput
from clothfit.motion import Motion


def check(noise: float, observed: float, every: int) -> None:
    """Raise InvalidInput when a value is out of range."""
    if not (np.isfinite(noise) and noise >= 0):
        raise InvalidInput(f"noise: {noise:g} m is not possible, 0 or more is")
    if not 0 < observed <= 1:
        raise InvalidInput(f"observed: the fraction {observed:g} is not possible, it must be above 0 and at most 1")
    if every < 1:
        raise InvalidInput(f"every: {every} is not possible, 1 or more is")


def degrade(motion: Motion, noise: float = 0.0, observed: float = 1.0, every: int = 1, seed: int = 0) -> Motion:
    """Add Gaussian noise of `noise` metres per coordinate, show a fraction of the vertices, keep every K-th frame.

    Which vertices are seen is drawn once for each object (at least one of each); what is not seen becomes NaN. The same
    seed gives the same result. Raises InvalidInput when a value is out of range.
    """
    check(noise, observed, every)
    generator = np.random.default_rng(seed)
    positions, times = motion.positions[::every].copy(), motion.times[::every].copy()
    if noise > 0:
        positions += generator.normal(scale=noise, size=positions.shape)
    kept = motion.observed if motion.observed is None else motion.observed[::every].copy()
    if observed < 1:
        seen = np.zeros(positions.shape[1], bool)
        start = 0
        for count in motion.vertex_counts:
            chosen = generator.choice(count, size=max(1, round(observed * count)), replace=False)
            seen[start + chosen] = True
            start += count
        kept = np.broadcast_to(seen, positions.shape[:2]).copy() if kept is None else kept & seen
        positions[~kept] = np.nan
    return replace(motion, positions=positions, times=times, observed=kept)
