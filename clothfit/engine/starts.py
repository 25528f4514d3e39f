"""How a motion begins: which vertices start inside of what they cannot pass through, and what is done about it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.messages import counted, metres
from clothfit.engine.forces import collider_rows
from clothfit.engine.forces.selfcontact import pairs
from clothfit.engine.forces.selfcontact.nearest import SEAM
from clothfit.engine.system import System, build
from clothfit.scene.scene import Scene

LEAST = 1e-6
"""Depth, m, below which a vertex counts as on a surface, not inside."""


def sentences(scene: Scene) -> list[str]:
    """What a user should know of a scene whose cloths start inside of colliders or through each other. Raises
    InvalidScene for a mesh or keys that cannot be read.
    """
    doubles = (each for group in scene.groups for each in doubled(scene, group))
    return [*let_go(scene), *(doubles if scene.self_contact else ())]


def let_go(scene: Scene) -> list[str]:
    """Those on what is let go, or drawn back, which gives energy."""
    if not (scene.obstacles or scene.self_contact):
        return []
    systems = [(group, build(scene, group[0], steps=1)) for group in scene.groups]
    return [each for group, own in systems for each in (*inside(scene, group, own), *crossing(scene, group, own))]


def doubled(scene: Scene, group: range) -> Iterator[str]:
    """A sentence for each object that lies on another of its group, triangle on triangle, as a copy of it does."""
    from scipy.spatial import cKDTree

    assert scene.self_contact is not None
    near = SEAM * scene.self_contact.thickness
    for first, second in combinations(group, 2):
        one, other = scene.cloths[first], scene.cloths[second]
        close = np.isfinite(cKDTree(one.positions).query(other.positions, distance_upper_bound=near)[0])
        count = int(close[other.triangles].all(axis=1).sum())
        if count:
            triangles = counted(count, "triangle starts", "triangles start")
            yield (
                f"objects[{second}]: {triangles} where objects[{first}] is, and will not be kept from passing through "
                "it, as at a seam; move it by the thickness"
            )


def inside(scene: Scene, group: range, system: System) -> Iterator[str]:
    """A sentence for each object and each obstacle that it starts in."""
    for name, depth, release in depths(scene, system):
        for cloth, own in zip(group, of_objects(scene, group, depth * system.vertex.free), strict=True):
            count = int((own > LEAST).sum())
            if count:
                vertices = counted(count, "vertex starts", "vertices start")
                how = f"let go over {release:.3g} s (release)" if release else "pushed out at once"
                yield f"objects[{cloth}]: {vertices} up to {metres(own.max())} inside {name}; {how}"


def depths(scene: Scene, system: System) -> Iterator[tuple[str, Array, float]]:
    """Each obstacle, how deep each vertex (n,) starts below its surface, m, and the time in which it is let go, s."""
    for ball in scene.spheres:
        depth = ball.radius - np.linalg.norm(system.x0 - ball.centre, axis=1)
        yield f"the sphere at ({', '.join(f'{x:.4g}' for x in ball.centre)}) m", depth, 0.0
    if system.colliders is not None:
        below, _ = collider_rows.depths(system.colliders._replace(begin=collider_rows.NOBODY), system.x0)
        begin = system.colliders.begin
        for c, (each, depth) in enumerate(zip(scene.colliders, below, strict=True)):
            if not each.release or (len(begin) and begin[c].any()):
                yield f"colliders[{each.place}]", depth - each.thickness, each.release


def crossing(scene: Scene, group: range, system: System) -> Iterator[str]:
    """A sentence where parts of cloths pass through each other."""
    surface = system.surface
    if surface is None or not surface.crossed.any():
        return
    hits = pairs.pierced(surface)
    first = np.cumsum([0, *(scene.vertex_counts[i] for i in group)])
    faces = np.cumsum([0, *(len(scene.cloths[i].triangles) for i in group)])
    edge, triangle = hits[0]
    one = int(np.searchsorted(first, surface.edges[edge, 0], "right")) - 1
    other = int(np.searchsorted(faces, triangle, "right")) - 1
    a, b = (surface.edges[edge] - first[one]).tolist()
    more = f", and {len(hits) - 1} more edges pass so" if len(hits) > 1 else ""
    more += f", up to {metres(surface.beyond.max())} deep" if len(surface.beyond) else ""
    where = ", ".join(f"{x:.4g}" for x in surface.start[surface.triangles[triangle]].mean(axis=0))
    back = counted(len(surface.drawn), "vertex is", "vertices are")
    yield (
        f"objects[{group[one]}]: the edge from vertex {a} to {b} starts through triangle {triangle - faces[other]} of "
        f"objects[{group[other]}], near ({where}) m{more}; {back} drawn back over {surface.release:.3g} s "
        "(selfCollision.release), in which what crosses does not touch"
    )


def of_objects(scene: Scene, group: range, values: Array) -> list[Array]:
    """Values (n,) of vertices that are simulated together, object by object."""
    return np.split(values, np.cumsum([scene.vertex_counts[i] for i in group])[:-1])
