"""Forces that play back to the same motion: found once more, step by step, along the steps of the engine itself.

A cloth that buckles or flutters forgets no rounding: forces that were found along one motion lead, played to a cloth
that is 1e-16 m beside it, somewhere else. So each force is the one that the closed loop applies to the state in which
the engine really is, with the tolerance of the scene. The same steps from the same start give the same bits.
"""

from __future__ import annotations

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.control.closed_loop import ClosedLoop
from clothfit.engine import rollout
from clothfit.engine.rollout import Rollout
from clothfit.engine.step import implicit
from clothfit.engine.system import System, build
from clothfit.motion.simulate import limited
from clothfit.scene.forces import Forces
from clothfit.scene.scene import Scene


def recorded(scene: Scene, loop: ClosedLoop, f: Array, most: float = np.inf) -> Array:
    """The forces u (T, n, 3), N, that the closed loop with forces f applies, none above `most` N. They end early where
    the motion diverges.
    """
    steps = len(f)
    played = open_system(scene, loop)
    closed = loop.system
    assert closed.inputs is not None
    assert played.inputs is not None
    closed.inputs.force[:steps] = f
    u = played.inputs.force
    whole, work = rollout.empty(played, steps), implicit.workspace(played)
    beside = implicit.workspace(closed)
    for t in range(steps):
        one = whole.part(t, t + 1)
        at = ahead(closed, one, scene.tolerance, beside) if loop.late else one.x[0]
        asked = f[t] + loop.gain[t, :, None] * (loop.places[t] - at)
        u[t] = limited(np.where(loop.pushed[:, None], asked, 0.0), most)
        if rollout.fill(played, scene.tolerance, work, one) < 1:
            break
        interrupts.check()
    return u[:steps].copy()


def open_system(scene: Scene, loop: ClosedLoop) -> System:
    """The system without springs, with a table of forces to fill."""
    times = loop.h * np.arange(loop.steps, dtype=float)
    forces = Forces(times, np.zeros((loop.steps, sum(scene.vertex_counts), 3)))
    return build(scene.with_forces(forces), loop.cloth, steps=loop.steps)


def ahead(closed: System, one: Rollout, tolerance: float, work: implicit.Workspace) -> Array:
    """Where the closed loop takes the state before a step, (n, 3), m."""
    own = rollout.empty(closed, 1)._replace(
        v=one.v, x_before=one.x_before, v_before=one.v_before, ready=one.ready, first=one.first
    )
    own.x[0] = one.x[0]
    rollout.fill(closed, tolerance, work, own)
    after: Array = own.x[1]
    return after
