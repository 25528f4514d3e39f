"""Who touches whom in a motion, and for how long: objects among themselves, and what they may lie on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Indices
from clothfit.base.messages import counted
from clothfit.engine.forces import collider_rows
from clothfit.engine.forces.selfcontact import pairs
from clothfit.engine.inputs.tables import set_inputs
from clothfit.engine.system import System, build, meets_itself
from clothfit.motion.motion import Motion, in_groups, in_world
from clothfit.scene.scene import Scene


class Touching(NamedTuple):
    """An object and what it touches."""

    object: int
    other: str  # objects[…], colliders[…] or a sphere
    share: float  # of the frames
    first: float  # s, the first frame in which they touch
    last: float  # s
    vertices: int  # of the object that touch at once, at most

    @property
    def when(self) -> str:
        """How long, in words."""
        most = counted(self.vertices, "vertex", "vertices")
        span = f"{100 * self.share:.3g} % of the time, from {self.first:.4g} to {self.last:.4g} s"
        return f"{span}, with {most} at most"

    @property
    def sentence(self) -> str:
        """The same as a sentence."""
        return f"objects[{self.object}] touches {self.other} {self.when}"


def touches(scene: Scene, motion: Motion) -> list[Touching]:
    """Who touches whom in a motion as `simulate` makes it, a frame after every step; the most often first."""
    if not (scene.obstacles or scene.self_contact) or not len(motion.times):
        return []
    whole, count = in_groups(in_world(motion, scene), scene), len(motion.times)
    found: dict[tuple[int, str], dict[int, int]] = {}
    for group in scene.groups:
        system, own = build(scene, group[0], steps=max(count - 1, 1)), np.ascontiguousarray(whole.of(group[0]))
        objects, counts = np.arange(group.start, group.stop, dtype=np.int32), scene.vertex_counts
        of_vertex = np.repeat(objects, [counts[i] for i in group])
        for frame in range(count):
            place(system, frame)
            for what, vertices in at_once(scene, system, own[frame], of_vertex):
                for i, number in zip(*np.unique(of_vertex[vertices], return_counts=True), strict=True):
                    found.setdefault((int(i), what), {})[frame] = int(number)
    times = motion.times
    listed = [
        Touching(i, what, len(when) / count, float(times[min(when)]), float(times[max(when)]), max(when.values()))
        for (i, what), when in found.items()
    ]
    return sorted(listed, key=lambda each: -each.share)


def place(system: System, frame: int) -> None:
    """Put what moves where it is at a frame."""
    if system.inputs is not None and frame >= system.inputs.lead:
        set_inputs(system.inputs, system, frame - system.inputs.lead)


def at_once(scene: Scene, system: System, x: Array, of_vertex: Indices) -> Iterator[tuple[str, npt.NDArray[np.intp]]]:
    """What is touched at positions x (n, 3), and the vertices of objects before it that touch it."""
    for c in range(len(scene.spheres)):
        near = np.linalg.norm(x - system.spheres.centre[c], axis=1) < system.spheres.radius[c]
        yield f"the sphere at ({', '.join(f'{v:.4g}' for v in scene.spheres[c].centre)}) m", np.flatnonzero(near)
    if system.colliders is not None:
        for each, depth in zip(scene.colliders, collider_rows.depths(system.colliders, x)[0], strict=True):
            yield f"colliders[{each.place}]", np.flatnonzero(depth > 0.0)
    if system.surface and meets_itself(system):
        vertices = pairs.contact_at(system.surface, x).vertices
        first, second = of_vertex[vertices[:, 0]], of_vertex[vertices[:, 3]]
        for i in np.unique(of_vertex).tolist():
            across = np.unique(vertices[(first != second) & ((first == i) | (second == i))])
            yield f"objects[{i}]", across[of_vertex[across] < i]
