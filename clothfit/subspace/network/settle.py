"""How a cloth comes to rest: motions that recorded ones lead to, by its own physics on the basis.

Recorded motions end a few seconds after their inputs do. A network that has seen no more keeps a cloth swinging for
ever. So some of the episodes whose inputs come to rest are played on, in the subspace, and cut to pieces of the length
of the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.system import build
from clothfit.subspace import carrier
from clothfit.subspace.network.signals import Signals
from clothfit.subspace.network.windows import Motions
from clothfit.subspace.physics.march import roll
from clothfit.subspace.physics.reduced import Reduced
from clothfit.subspace.recorded.recording import Data

TIMES = 10
"""The length of such a motion, in that of a recorded one."""

EPISODES = 4

MOST = 6e7
"""Springs times steps, of all these motions: half a minute or less."""


FARTHEST = 2.0
"""Times the way of the recorded motions: a cloth that falls from an obstacle, and never comes to rest, goes farther."""


def settled(
    data: Data, c: int, episodes: Sequence[int], basis: Array, signals: Signals, recorded: Array
) -> Motions | None:
    """The pieces of such motions that stay near the `recorded` coordinates (N, r); None where there are none."""
    chosen = [e for e in episodes if e % 2 == 1][:EPISODES]
    springs = len(data.scene.cloths[c].springs)
    times = min(TIMES, int(MOST / max(1, springs * data.steps * len(chosen)))) if chosen else 0
    found = [piece for e in chosen for piece in pieces(data, c, e, basis, signals, times)] if times > 1 else []
    most = FARTHEST * np.linalg.norm(recorded, axis=1).max()
    found = [each for each in found if np.linalg.norm(each[0], axis=1).max() <= most]
    if not found:
        return None
    z, w = (np.stack([each[k] for each in found]) for k in range(2))
    return Motions(z, w, np.ones(z.shape[:2], bool))


def pieces(data: Data, c: int, episode: int, basis: Array, signals: Signals, times: int) -> list[tuple[Array, Array]]:
    """Coordinates (T, r) and inputs (T − 2, m) of the pieces of one motion after the recorded frames."""
    length = data.steps
    system = build(data.scene_of(episode), c, steps=times * length)
    q = roll(Reduced(system, basis), times * length)
    z = np.concatenate([q[:1] - system.h * carrier.start_velocity(system, basis), q])
    w = signals.of(system, times * length)
    return [(z[a : a + length + 2], w[a : a + length]) for a in range(length, (times - 1) * length + 1, length)]
