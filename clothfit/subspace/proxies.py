"""Vertices pushed out of the scene's obstacles after decoding: what a basis leaves out may put a limb through a sleeve.

A vertex at the distance δ < d from the surface of an obstacle goes by (d − δ) n to the distance d, n the outward normal
there. On spheres, planes and capsules with two radii, where δ is the distance to the whole obstacle also from inside,
that is the shortest way. Fixed vertices stay. A vertex between several obstacles is pushed by one after the other, a
few times around.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.engine.forces import spheres, touch
from clothfit.engine.inputs.tables import set_frame
from clothfit.engine.system import System
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import lane0, lane1, lane2, pack

ROUNDS = 3
"""How often all obstacles get their turn."""


def push_all(system: System, x: Array, distance: float = 0.0) -> None:
    """Push the vertices of all frames, positions (F, n, 3), m, in place. Raises InvalidInput where there are no
    obstacles, or the distance is below 0.
    """
    if not (np.isfinite(distance) and distance >= 0.0):
        raise InvalidInput(f"--push-out must be at least 0; {distance:g} m was given")
    if not len(system.spheres.radius) and (system.colliders is None or not len(system.colliders.rows)):
        raise InvalidInput("--push-out: the scene has no obstacles")
    for frame, each in enumerate(x):
        push_out(system, each, frame, distance)


def push_out(system: System, x: NDArray[np.floating], frame: int, distance: float = 0.0) -> None:
    """Move positions (n, 3), m, of a frame, with the obstacles where the inputs of the system say, to a `distance`, m,
    from them.
    """
    set_frame(system.inputs, system, frame)
    push(system.spheres, system.colliders, system.vertex.free, x, distance)


@kernel
def push(balls, colliders, free, x, distance):
    """The same, for obstacles where they are."""
    for i in range(len(x)):
        if free[i]:
            for _ in range(ROUNDS):
                if not (out_of_spheres(balls, x, i, distance) or out_of_colliders(colliders, x, i, distance)):
                    break


@kernel
def out_of_spheres(balls, x, i, distance):
    """Push one vertex out of the plain spheres; whether it was in any."""
    found = False
    for c in range(len(balls.radius)):
        depth, _, n0, n1, n2 = spheres.contact(balls, x, i, c)
        depth += distance
        if depth > 0.0:
            x[i, 0], x[i, 1], x[i, 2] = x[i, 0] + depth * n0, x[i, 1] + depth * n1, x[i, 2] + depth * n2
            found = True
    return found


@kernel(absent=False)
def out_of_colliders(colliders, x, i, distance):
    """The same for all other obstacles."""
    found = False
    for c in range(len(colliders.rows)):
        own = colliders.rows[c]
        p = pack(x[i, 0], x[i, 1], x[i, 2], 0.0)
        delta, _, _, inner, _, _ = touch.measured(colliders.bodies, own, i, p)
        depth = distance - delta
        if depth > 0.0:
            n = touch.outward(own, inner)
            x[i, 0] += depth * lane0(n)
            x[i, 1] += depth * lane1(n)
            x[i, 2] += depth * lane2(n)
            found = True
    return found
