"""The proportions of a uniform fabric, by the geometry of its mesh.

A fabric has one density and one stiffness; the front end shares them out by geometry: a vertex' mass is proportional
to the area of its triangles, a traction spring's stiffness to the area at its edge over its length squared, a bending
spring's to a quarter of twice that of the second triangle at the edge it bends over (`meshes.mesh`). Springs and
vertices that belong to no triangle get the geometric mean of the others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.meshes.mesh import BENDING_SHARE, Mesh, areas
from clothfit.scene.cloth import Cloth


def proportions(cloth: Cloth) -> tuple[Array, Array]:
    """Relative masses (n,) and stiffnesses (S,) of a uniform fabric, each with geometric mean 1."""
    area = areas(Mesh(cloth.positions, cloth.triangles))
    mass = np.zeros(len(cloth.mass))
    np.add.at(mass, cloth.triangles, area[:, None] / 3)
    return normalised(mass), normalised(spring_areas(cloth, area) / cloth.lengths**2)


def spring_areas(cloth: Cloth, area: Array) -> Array:
    """The area (S,) that each spring stands for, m²; 0 where it is neither an edge nor bends over one."""
    n = len(cloth.mass)
    sides = np.sort(cloth.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    opposite, shared = cloth.triangles[:, [2, 0, 1]].reshape(-1), np.repeat(area, 3)
    key = sides[:, 0].astype(np.int64) * n + sides[:, 1]
    order = np.argsort(key, kind="stable")
    pairs = np.flatnonzero(np.diff(key[order]) == 0)  # two triangles at one edge
    first, second = order[pairs], order[pairs + 1]
    across = np.sort(np.stack([opposite[first], opposite[second]], axis=1), axis=1)
    bend_key = across[:, 0].astype(np.int64) * n + across[:, 1]
    bend_area = BENDING_SHARE * 2.0 * shared[second]
    ends = np.sort(cloth.springs, axis=1)
    own = ends[:, 0].astype(np.int64) * n + ends[:, 1]
    traction = summed(key, shared, own)
    return np.where(traction > 0, traction, summed(bend_key, bend_area, own))


def summed(keys: NDArray[np.int64], values: Array, wanted: NDArray[np.int64]) -> Array:
    """Sum of the values of each wanted key; 0 where there is none."""
    distinct, group = np.unique(keys, return_inverse=True)
    if not len(distinct):
        return np.zeros(len(wanted))
    sums = np.bincount(group.reshape(-1), weights=values, minlength=len(distinct))
    place = np.clip(np.searchsorted(distinct, wanted), 0, len(distinct) - 1)
    found: Array = np.where(distinct[place] == wanted, sums[place], 0.0)
    return found


def normalised(values: Array) -> Array:
    """Values relative to their geometric mean; 1 where there is none."""
    known = values > 0
    middle = np.exp(np.log(values[known]).mean()) if known.any() else 1.0
    relative: Array = np.where(known, values, middle) / middle
    return relative
