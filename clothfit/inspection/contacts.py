"""The contacts of a motion at every point where forces are evaluated, which decide on which smooth piece it lies.

A step is smooth in its state and its parameters except where a vertex enters or leaves a sphere: there its matrix
jumps, and so does the cost. Two motions with the same contacts throughout lie on one smooth piece of the cost.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Flags
from clothfit.engine.rollout import Rollout
from clothfit.engine.system import System


class Switch(NamedTuple):
    """The first difference between two motions of a cloth."""

    step: int  # counted from 1
    vertex: int
    sphere: int  # counted from 0

    def __str__(self) -> str:
        return f"vertex {self.vertex} at sphere {self.sphere}, step {self.step}"


def contacts(system: System, part: Rollout) -> Flags:
    """Which of n vertices are in which of C spheres (T, N, C, n), at the forces of T steps of N iterations."""
    steps, iterations, n = part.w.shape[:3]
    spheres = system.spheres
    found = np.zeros((steps, iterations, len(spheres.radius), n), bool)
    if not found.size:
        return found
    for k in range(iterations):
        y = part.x[:-1] if k == 0 else part.x[:-1] + system.h * part.w[:, k - 1]
        for c, (centre, radius) in enumerate(zip(spheres.centre, spheres.radius, strict=True)):
            found[:, k, c] = np.linalg.norm(y - centre, axis=2) < radius
    found[np.arange(iterations) >= part.used[:, None]] = False  # iterations that were not made
    return found


def first_switch(a: Flags, b: Flags) -> Switch | None:
    """The first difference between the contacts of two motions; None where there is none."""
    if np.array_equal(a, b):
        return None
    step, _, sphere, vertex = (int(i) for i in np.argwhere(a != b)[0])
    return Switch(step + 1, vertex, sphere)
