"""From the scene to arrays: one System per cloth, the only place where the scene's names become symbols.

Cloths do not touch each other, so each is a system of its own: what one computes does not depend on the others,
and a fit moves only the cloths it fits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit import sparse
from clothfit.arrays import Array, Indices
from clothfit.forces import spheres, springs, vertex, wind
from clothfit.scene import Scene

EXPLICIT, SYMPLECTIC, IMPLICIT = 0, 1, 2
"""Values of the scene's `integrationMethod`."""


class System(NamedTuple):
    """One cloth, constant during a simulation. n vertices."""

    x0: Array  # (n, 3), positions at the start, m
    h: float  # time step, s
    method: int  # EXPLICIT, SYMPLECTIC or IMPLICIT
    newton_iterations: int  # linear solves per implicit step, at least 1
    vertex: vertex.Vertex
    springs: springs.Springs
    faces: wind.Faces
    spheres: spheres.Spheres
    row: Indices  # pattern of the step's matrix, see `sparse.BlockMatrix`
    column: Indices


def build(scene: Scene, index: int) -> System:
    """The System of cloth `index` of the scene."""
    cloth = scene.cloths[index]
    row, column, slot = sparse.pattern(cloth.springs, ~cloth.fixed)
    return System(
        x0=np.array(cloth.positions),
        h=scene.delta,
        method=scene.method,
        newton_iterations=scene.newton_iterations,
        vertex=vertex.build(cloth.mass, cloth.fixed, cloth.damping),
        springs=springs.build(cloth.positions, np.array(cloth.springs), cloth.stiffness, cloth.damping, slot),
        faces=wind.build(np.array(cloth.triangles), cloth.drag, scene.wind),
        spheres=spheres.build(scene.spheres),
        row=row,
        column=column,
    )


def with_elements(system: System, mass: Array, stiffness: Array) -> System:
    """The same system with other masses (n,) kg and stiffnesses (S,) N/m; nothing else is built again."""
    return system._replace(
        vertex=system.vertex._replace(mass=np.array(mass, float)),
        springs=system.springs._replace(stiffness=np.array(stiffness, float)),
    )
