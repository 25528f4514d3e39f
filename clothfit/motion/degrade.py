"""Make a motion look like a capture: noise, vertices that no camera saw, another frame rate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clothfit.base.limits import check_capture
from clothfit.base.memory import check_memory
from clothfit.motion.motion import Motion, arrays_of, check_loaded
from clothfit.motion.times import TIME_SLACK, interpolated, snapped

MOST_RECORDED_FRAMES = 1e18
"""More frames than any memory holds."""


def degrade(
    motion: Motion, noise: float = 0.0, observed: float = 1.0, every: int = 1, seed: int = 0, fps: float | None = None
) -> Motion:
    """Make a motion look like a capture: noise, unseen vertices, fewer frames.

    `noise` is the standard deviation of each coordinate, m. `observed`, above 0 and at most 1, is the fraction of the
    vertices that are seen, drawn once for each object, at least one of each; the others become NaN. `every` K keeps
    every K-th frame; `fps` records so many frames per second instead. The same seed gives the same motion. Raises
    InvalidInput when a value is out of range.
    """
    check_loaded(motion)
    check_capture(noise, observed, every, fps)
    generator = np.random.default_rng(seed)
    if fps is not None:
        motion = at_rate(motion, fps)
    else:  # a copy: noise and gaps are written into it
        motion = replace(motion, **{name: array[::every].copy() for name, array in arrays_of(motion).items()})
    positions, kept = motion.positions, motion.observed
    if noise > 0:
        for frame in positions:  # one by one: an array as large as `positions` would take as much memory again
            frame += generator.normal(scale=noise, size=frame.shape)
    if observed < 1:
        seen = np.zeros(positions.shape[1], bool)
        start = 0
        for count in motion.vertex_counts:
            chosen = generator.choice(count, size=max(1, round(observed * count)), replace=False)
            seen[start + chosen] = True
            start += count
        kept = np.broadcast_to(seen, positions.shape[:2]).copy() if kept is None else kept & seen
        positions[~kept] = np.nan
    return replace(motion, observed=kept)


def at_rate(motion: Motion, fps: float) -> Motion:
    """The motion at `fps` frames per second from its first time on, linear between its frames.

    A fit interpolates in the same way, so a perfect target stays perfect. A position is observed, and weighs more
    than 0, where both frames beside it allow that.
    """
    first, last = float(motion.times[0]), float(motion.times[-1])
    slack = TIME_SLACK * (last - first) / max(len(motion.times) - 1, 1)
    frames = int(min((last - first + slack) * fps, MOST_RECORDED_FRAMES)) + 1
    check_memory(frames, motion.positions.shape[1], 1)
    times = first + np.arange(frames) / fps
    index, fraction = snapped(np.interp(times, motion.times, np.arange(len(motion.times))))
    after = index + (fraction > 0)
    observed, weights = motion.observed, motion.weights
    if weights is not None:
        weights = np.where((weights[index] > 0) & (weights[after] > 0), interpolated(weights, index, fraction), 0.0)
    return replace(
        motion,
        positions=interpolated(motion.positions, index, fraction),
        times=times,
        observed=None if observed is None else observed[index] & observed[after],
        weights=weights,
    )
