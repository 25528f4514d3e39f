"""Test motions of `networks.py` by physics: projected on the basis, or in full from what the basis holds of a state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.inputs.tables import later
from clothfit.engine.rollout import rollout
from clothfit.subspace import translation
from clothfit.subspace.network.layers import Motions
from clothfit.subspace.physics.march import March, State
from clothfit.subspace.physics.samples import Reduced, decode
from clothfit.subspace.recording import SOLVE_TOLERANCE


def pieces(motions: Motions, steps: int) -> tuple[Motions, list[tuple[int, int]]]:
    """Motions cut to pieces of so many steps, with the two frames before each; and of which motion and from which step
    on each is.
    """
    whole = motions.w.shape[1]
    starts = [(e, t) for e in range(len(motions.z)) for t in range(0, whole - steps + 1, steps)]
    z, w = motions.windows(np.array(starts, np.int32), steps)
    return Motions(z, w, np.ones(z.shape[:2], bool)), starts


def projected(runs: Sequence[Reduced], test: Motions, starts: Sequence[tuple[int, int]]) -> Array:
    """Coordinates (pieces, frames, r) by the projected steps, from the last of the two frames of each piece on."""
    made = []
    for (e, t), z in zip(starts, test.z, strict=True):
        own = runs[e]
        motion, q = March(own), np.full((1 + test.w.shape[1], own.r), np.nan)
        motion.t, motion.state = t, State(z[[1, 0]], np.stack([(z[1] - z[0]) / own.system.h] * 2))
        q[0] = z[1]
        motion.take(q[1:])
        made.append(q)
    return np.stack(made)


def full(runs: Sequence[Reduced], test: Motions, starts: Sequence[tuple[int, int]]) -> Array:
    """The same by the full simulation, which begins at what the basis holds."""
    made = []
    for (e, t), z in zip(starts, test.z, strict=True):
        run, steps = runs[e], test.w.shape[1]
        own = run.system
        if t > 0:
            x = decode(run.system, run.basis, z[:2], t - 1)
            own = own._replace(x0=x[1], v0=np.ascontiguousarray((x[1] - x[0]) / own.h), inputs=later(own.inputs, t))
        found = rollout(own, steps, SOLVE_TOLERANCE)[0].x - run.system.x0
        found -= translation.shift(run.system.inputs, steps + 1, t)
        found[:, ~own.vertex.free] = 0.0
        made.append(found.reshape(steps + 1, -1) @ translation.projection(run.basis, own))
    return np.stack(made)
