"""Where a motion touches obstacles: which vertex is at which part of which one, at the forces of each step.

Where a vertex enters or leaves an obstacle, the matrix of the step jumps. Where it passes from one part of a surface to
another, from a face of a box or a mesh over its edge, from the mantle of a capsule to its end, the normal goes on and
its derivative jumps. At both the cost has derivatives from two sides. So a part is a number, 0 outside, and two motions
with the same numbers lie on one smooth piece of the cost. A cloth that touches itself is one more obstacle; its numbers
stand for the pairs that a vertex is in, and the parts of triangles and edges that are nearest there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.forces import touch
from clothfit.engine.forces.selfcontact import force, pairs
from clothfit.engine.forces.surfaces import BOX, CONE
from clothfit.engine.forces.touch import AXES, PLACE, SHAPE, SIZE
from clothfit.engine.inputs.tables import set_inputs
from clothfit.engine.rollout import Rollout
from clothfit.engine.system import BDF2, System, meets_itself
from clothfit.scene.scene import Scene

Parts = NDArray[np.int32]

MANY = 2**31 - 3
"""Numbers that pairs are spread over."""


class Switch(NamedTuple):
    """The first difference between two motions of a cloth."""

    step: int  # counted from 1
    vertex: int
    obstacle: int  # counted from 0: the spheres, then the colliders
    within: bool = False  # whether both motions touch it, at different parts

    def __str__(self) -> str:
        return self.at(f"sphere {self.obstacle}")

    def at(self, obstacle: str) -> str:
        """The sentence, with a name for the obstacle."""
        where = f"two parts of {obstacle}" if self.within else obstacle
        return f"vertex {self.vertex} at {where}, step {self.step}"


def name_of(scene: Scene, obstacle: int) -> str:
    """What a switch calls an obstacle of a scene."""
    if obstacle < len(scene.spheres):
        return f"sphere {obstacle}"
    if obstacle == scene.obstacles:
        return "the cloth itself"
    each = scene.colliders[obstacle - len(scene.spheres)]
    return f"the {each.name} colliders[{each.place}]"


def contacts(system: System, part: Rollout) -> Parts:
    """At which parts of C obstacles n vertices are (T, N, C, n), at the forces of T steps of N iterations."""
    steps, iterations, n = part.w.shape[:3]
    count = len(system.spheres.radius) + (0 if system.colliders is None else len(system.colliders.rows))
    count += meets_itself(system)
    found = np.zeros((steps, iterations, count, n), np.int32)
    if not found.size:
        return found
    for t in range(steps):
        set_inputs(system.inputs, system, part.first + t)
        for k in range(int(part.used[t])):
            y = linearised_at(system, part, t, k)
            others = touched(system, y, None if part.met is None else part.met[t, k])
            found[t, k, : len(others)] = others
            if system.surface and meets_itself(system):
                found[t, k, -1] = touched_by_itself(system.surface, part.x[t], part.touches[t].numbers, y)
    return found


def linearised_at(system: System, part: Rollout, t: int, k: int) -> Array:
    """The positions (n, 3), m, that iteration k of step t takes its forces at."""
    x, h = part.x[t], system.h
    if system.method == BDF2 and not part.euler[t]:
        v, (x_before, v_before) = part.velocity(t), (part.x_before, part.v_before)
        if t:
            x_before, v_before = part.x[t - 1], part.velocity(t - 1)
        x, h = x + (x - x_before) / 3.0, 2.0 / 3.0 * h
        return np.asarray(x + h * (2.0 * v - v_before if k == 0 else part.w[t, k - 1]))
    return np.asarray(x if k == 0 else x + h * part.w[t, k - 1])


def touched(system: System, y: Array, met: Flags | None) -> Parts:
    """At which parts of C obstacles points y (n, 3) are, (C, n), where the obstacles are now, those that are `met`
    outside of them included.
    """
    gaps = np.linalg.norm(y - system.spheres.centre[:, None], axis=2) - system.spheres.radius[:, None]
    plain: Parts = (gaps < 0).astype(np.int32)
    if system.colliders is None or met is None:
        return plain
    inside = met | (touch.depths(system.colliders, y)[0] > 0)
    places = np.array([part_of(row, y) for row in system.colliders.rows], np.int32).reshape(-1, len(y))
    spots = touch.spots(system.colliders, y)
    places = np.where(spots < 0, places, 1 + spots)
    return np.concatenate([plain, np.where(inside, places, 0)], dtype=np.int32)


def touched_by_itself(surface: pairs.Surface, x: Array, numbers: Indices, y: Array) -> Parts:
    """A number (n,) for what each vertex of a cloth touches of it at y, in a step from x, (n, 3) each."""
    contact = pairs.of_numbers(surface, x, numbers)
    place = np.zeros(len(numbers), np.int32)
    force.find_parts(contact, y, place)
    total = np.zeros(len(x), np.int64)
    np.add.at(total, contact.vertices.ravel(), np.repeat(1 + (7919 * numbers + place) % MANY, 4))
    return np.asarray(np.where(total > 0, 1 + total % MANY, 0), np.int32)


def part_of(row: Array, y: Array) -> Parts:
    """The part of a collider's surface (`surfaces`) that points y (n, 3) are nearest to, (n,), from 1 on."""
    p = (y - row[PLACE]) @ row[AXES : AXES + 3].T
    shape = int(row[SHAPE, 0])
    if shape == BOX:
        return part_of_box(row[SIZE], p)
    if shape == CONE:
        return part_of_cone(row[SIZE], p)
    return np.ones(len(p), np.int32)


def part_of_box(half: Array, p: Array) -> Parts:
    """Outside, on which side of each pair of faces, or between them; inside, the nearest face."""
    q = np.abs(p) - half
    side = np.where(p < 0, 1, 2)
    beyond = (np.where(q > 0, side, 0) @ [1, 3, 9]) + 1
    nearest = np.argmax(q, axis=1)
    within = 28 + 2 * nearest + side[np.arange(len(p)), nearest]
    return np.asarray(np.where((q > 0).any(axis=1), beyond, within), np.int32)


def part_of_cone(size: Array, p: Array) -> Parts:
    """Its mantle, or one of its ends."""
    r, s, length = size
    if length <= abs(r - s):
        return np.ones(len(p), np.int32)
    sine = (r - s) / length
    along = np.sqrt(1.0 - sine * sine) * (p[:, 1] + 0.5 * length) - sine * np.hypot(p[:, 0], p[:, 2])
    ends = np.array([0.0, np.sqrt(1.0 - sine * sine) * length])
    return np.asarray(1 + (along[:, None] > ends).sum(axis=1), np.int32)


def first_switch(a: Parts, b: Parts) -> Switch | None:
    """The first difference between the contacts of two motions; None where there is none."""
    if np.array_equal(a, b):
        return None
    place = tuple(int(i) for i in np.argwhere(a != b)[0])
    step, _, obstacle, vertex = place
    return Switch(step + 1, vertex, obstacle, bool(a[place] and b[place]))
