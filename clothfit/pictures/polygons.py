"""One frame of a scene as coloured polygons in painting order: cloths, their target in translucent green, and spheres.

Both `filmstrip` (matplotlib) and `gif` (Pillow) paint these lists. A sphere is a disc between the faces behind its
centre and those before it, which is right for everything that touches it from outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.inputs.sampling import centres_at, winds
from clothfit.pictures.camera import LIGHT, Camera, direction, faces, framed, project, shaped, thinned
from clothfit.pictures.palette import CLOTHS, SPHERE_COLOUR, TARGET_COLOUR, Colour
from clothfit.pictures.solids import Solid, solids
from clothfit.scene.cloth import Cloth
from clothfit.scene.scene import Scene

TARGET_OPACITY = 0.40

SPHERE_DISCS, DISC_CORNERS = 24, 64
"""A sphere is shaded by so many discs, each with so many corners."""

BACK_BRIGHTNESS = 0.86
"""Brightness of a cloth's back relative to its front."""

MOST_FRAMED_FRAMES, MOST_FRAMED_VERTICES = 200, 5000
"""Most frames and vertices of a motion that are looked at to choose the camera's view."""

FARTHEST_SHOWN = 20.0
"""A motion that has grown to this many times its size at the start has diverged; its later frames are left out."""

GIVE = 0.35
"""How far behind their place solids are drawn, relative to the mean edge of a face: between two vertices on a collider
a face cuts through it.
"""

FOLLOWED_ABOVE = 5.0
"""The camera follows cloths that travel farther than this many times their own size."""


@dataclass(frozen=True)
class Stage:
    """A scene, the faces that are drawn, and the camera."""

    scene: Scene
    triangles: Indices  # (T, 3) vertices, counted over all objects
    cloth: Indices  # (T,) the object of each triangle
    camera: Camera
    middle: Array  # (F, 3) m, where the camera moves with the cloth; 0 where it stands still
    centres: Array  # (F, C, 3) m, of the spheres
    solids: tuple[Solid, ...]  # the other colliders
    wind: Array  # (F, 3) m/s
    give: float  # m, how far surfaces of solids are drawn behind where they are


class Patches(NamedTuple):
    """Polygons with the same number m of corners and the same opacity, to be painted in order."""

    corners: Array  # (K, m, 2), metres
    colours: Array  # (K, 3) red, green, blue; 0 … 1
    opacity: float = 1.0


def stage(
    scene: Scene,
    motions: Sequence[Array],
    most: int,
    shape: tuple[float, float] = (0.4, 1.6),
    times: Array | None = None,
) -> Stage:
    """The stage for motions (F, n, 3) of a scene at `times` (F,), s, by default its own steps, with at most `most`
    faces, its height by width within `shape`.
    """
    parts, cloth = [], []
    start = 0
    total = sum(len(own.triangles) for own in scene.cloths)
    for index, own in enumerate(scene.cloths):
        kept = thinned(own.positions, own.triangles, max(1, most * len(own.triangles) // max(total, 1)))
        parts.append(kept + start)
        cloth += [index] * len(kept)
        start += len(own.mass)
    triangles = np.concatenate(parts).astype(np.int32) if parts else np.zeros((0, 3), np.int32)
    when = times_of(scene, motions[0], times)
    middle, centres = middles(motions[0]), centres_at(scene, when)
    others, air = solids(scene, when, motions[0]), winds(scene, when)
    axes = direction(motions[0], triangles)
    if middle.any():
        seen = framed(axes, some(motions[0] - middle[:, None]))
    else:
        balls = [ball(c, s.radius) for c, s in zip(centres.mean(axis=0), scene.spheres, strict=True)]
        looks = {0, len(when) // 2, len(when) - 1}
        bodies = [each.at(frame) for each in others if not each.endless for frame in looks]
        seen = framed(axes, np.concatenate([*map(some, motions), *balls, *bodies]))
    owners, give = np.array(cloth, np.int32), GIVE * mean_edge(motions[0][0], triangles)
    return Stage(scene, triangles, owners, shaped(seen, *shape), middle, centres, others, air, give)


def mean_edge(x: Array, triangles: Indices) -> float:
    """Mean length of the sides of triangles (T, 3) between points x (n, 3), m; 0 without any."""
    lengths = np.linalg.norm(x[triangles] - x[np.roll(triangles, 1, axis=1)], axis=2)
    return float(np.nanmean(lengths)) if lengths.size else 0.0


def times_of(scene: Scene, x: Array, times: Array | None) -> Array:
    """The times (F,), s, of a motion (F, n, 3)."""
    return scene.delta * np.arange(len(x), dtype=float) if times is None else times


def some(x: Array) -> Array:
    """Points (K, 3) of a motion (F, n, 3); of a large one a sample."""
    frames, count = x.shape[:2]
    return x[:: max(1, frames // MOST_FRAMED_FRAMES), :: max(1, count // MOST_FRAMED_VERTICES)].reshape(-1, 3)


def ball(centre: Array, radius: float) -> Array:
    """The corners (8, 3) of a cube in a sphere: as much of it as a picture must show."""
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    return np.asarray(centre + 0.75 * radius * signs)


def middles(x: Array) -> Array:
    """The middle (F, 3) of each frame of a motion (F, n, 3) that travels far; else 0."""
    low, high = np.nanmin(x, axis=1), np.nanmax(x, axis=1)  # (F, 3)
    own = float((high - low).max())
    way = float((np.nanmax(high, axis=0) - np.nanmin(low, axis=0)).max())
    return 0.5 * (low + high) if way > FOLLOWED_ABOVE * own else np.zeros((len(x), 3))


def good_part(times: Array, x: Array, over: Array | None) -> tuple[Array, Array, Array | None]:
    """Times, motion and target as far as the motion x (F, n, 3) can be shown; at least the first frame."""
    good = max(1, good_frames(x))
    return times[:good], x[:good], None if over is None else over[:good]


def good_frames(x: Array) -> int:
    """The number of frames of a simulated motion (F, n, 3) before it diverges."""
    with np.errstate(invalid="ignore"):
        size = np.ptp(x, axis=1).max(axis=1)  # NaN where a position is not finite
        lost = np.flatnonzero(~(size <= FARTHEST_SHOWN * size[0]))
    return int(lost[0]) if len(lost) else len(x)


def painted(on: Stage, frame: int, x: Array, over: Array | None = None) -> list[Patches]:
    """All polygons of a frame with positions x (n, 3), and the target `over` (n, 3) over them.

    Spheres hide what is behind them. The rest of the target is painted last, so that no cloth hides it.
    """
    away = on.middle[frame]
    skins = [skin(on, x - away)]
    if over is not None:
        skins.append(skin(on, over - away, TARGET_COLOUR, TARGET_OPACITY))
    found: list[Patches] = []
    nearest = np.inf
    balls = zip(on.centres[frame], on.scene.spheres, strict=True)
    for centre, sphere in sorted(balls, key=lambda each: -float(each[0] @ on.camera.forward)):
        depth = float((centre - away) @ on.camera.forward)
        found += [one.between(nearest, depth) for one in skins]
        found.append(disc(on.camera, centre - away, sphere.radius))
        nearest = depth
    return [*found, *(one.between(nearest, -np.inf) for one in skins)]


class Skin(NamedTuple):
    """The faces of cloths, farthest first."""

    patches: Patches
    depth: Array  # (K,), m

    def between(self, far: float, near: float) -> Patches:
        """The faces at depths from `far` down to `near`, `near` excluded."""
        own = slice(*np.searchsorted(-self.depth, (-far, -near)))
        return self.patches._replace(corners=self.patches.corners[own], colours=self.patches.colours[own])


def skin(on: Stage, x: Array, colour: Colour | None = None, opacity: float = 1.0) -> Skin:
    """The faces at x (n, 3), in the colours of the objects or in a given one."""
    seen = faces(on.camera, x, on.triangles)
    owners = on.cloth[seen.which]
    base = cloth_colours(owners) if colour is None else np.broadcast_to(colour, (len(owners), 3))
    rgb = lit(base, seen.shade * np.where(seen.outside, 1.0, BACK_BRIGHTNESS))
    return Skin(Patches(seen.corners, rgb, opacity), seen.depth)


def cloth_colours(cloth: Indices) -> Array:
    """The colours (K, 3) of objects (K,)."""
    return np.array(CLOTHS)[cloth % len(CLOTHS)]


def lit(colour: Array, shade: Array) -> Array:
    """Colours (K, 3) under light `shade` (K,), 0 … 1: darker towards 0, whiter towards 1."""
    dark = colour * (0.48 + 0.82 * shade[:, None])
    white = np.clip(2.6 * (shade - 0.62), 0.0, 1.0)[:, None]
    return np.clip(dark + 0.45 * white * (1.0 - dark), 0.0, 1.0)


def disc(seen: Camera, centre: Array, radius: float) -> Patches:
    """A sphere as discs, each smaller, lighter and nearer to the light than the last."""
    angle = np.linspace(0.0, 2.0 * np.pi, DISC_CORNERS, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    inward = np.linspace(0.0, 1.0, SPHERE_DISCS)[:, None, None]
    towards = np.array(LIGHT[:2]) / np.linalg.norm(LIGHT)
    middle = project(seen, centre)[:2] + radius * inward * towards * 0.8
    corners = middle + radius * (1.0 - 0.88 * inward) * ring
    rgb = lit(np.broadcast_to(SPHERE_COLOUR, (SPHERE_DISCS, 3)), np.linspace(0.28, 0.78, SPHERE_DISCS))
    return Patches(corners, rgb)


def pins(on: Stage, frame: int, x: Array) -> Array:
    """The places (K, 2), m, of the fixed vertices in the picture, but of those that only fixed ones surround."""
    shown: Flags = np.concatenate([border(cloth) for cloth in on.scene.cloths])
    return project(on.camera, x[shown] - on.middle[frame])[:, :2]


def border(cloth: Cloth) -> Flags:
    """Which vertices (n,) of a cloth are fixed and not surrounded by fixed ones: an edge or a spring leads to a free
    one, or none leads anywhere.
    """
    faces = cloth.triangles
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]) if len(faces) else cloth.springs
    free = ~cloth.fixed
    beside, alone = np.zeros(len(free), bool), np.ones(len(free), bool)
    beside[edges[free[edges[:, 1]], 0]] = beside[edges[free[edges[:, 0]], 1]] = True
    alone[edges] = False
    return np.asarray(cloth.fixed & (beside | alone))


def bare(on: Stage, frame: int, x: Array) -> tuple[Array, Array]:
    """The places (K, 2), m, and colours (K, 3) of vertices of objects without faces; of very many a sample."""
    counts = on.scene.vertex_counts
    faceless = [len(cloth.triangles) == 0 for cloth in on.scene.cloths]
    shown = np.flatnonzero(np.repeat(faceless, counts))
    shown = shown[:: max(1, len(shown) // MOST_FRAMED_VERTICES)]
    own = np.repeat(np.arange(len(counts), dtype=np.int32), counts)[shown]
    return project(on.camera, x[shown] - on.middle[frame])[:, :2], cloth_colours(own)


def sightings(on: Stage, frame: int, over: Array) -> Array:
    """The places (K, 2), m, of the observed vertices of a target (n, 3) that is observed in part; else none."""
    known = np.isfinite(over).all(axis=1)
    shown = known & (not known.all())
    return project(on.camera, over[shown] - on.middle[frame])[:, :2]


def wind(on: Stage, frame: int) -> tuple[Array, float] | None:
    """The wind's unit vector projected into the picture (2,), and its speed, m/s; None without wind."""
    speed = float(np.linalg.norm(on.wind[frame]))
    return (project(on.camera, on.wind[frame] / speed)[:2], speed) if speed > 0 else None
