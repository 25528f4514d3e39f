"""A moment of a scene as coloured polygons, in the order in which they are painted: cloths, another motion of the same
cloths over them as translucent green, and spheres.

Both kinds of pictures (`film` with matplotlib, `gif` with Pillow) paint these lists. A sphere is a disc between the
faces behind its middle and those before it, which is right for all that touches it from outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.pictures.camera import LIGHT, Camera, direction, faces, framed, project, shaped, thinned
from clothfit.pictures.palette import CLOTHS, SPHERE_COLOUR, TARGET_COLOUR, Colour
from clothfit.scene.scene import Scene

TARGET_OPACITY = 0.40

SPHERE_DISCS, DISC_CORNERS = 24, 64
"""A sphere is shaded by so many discs, each with so many corners."""

BACK_BRIGHTNESS = 0.86
"""Brightness of a cloth's other side."""

MOST_FRAMED_FRAMES, MOST_FRAMED_VERTICES = 200, 5000
"""Of a motion, to decide how large a part of the world the camera shows."""

FARTHEST_SHOWN = 20.0
"""Frames with a vertex that many sizes of the scene away show a motion that has lost itself; they are left out."""

FOLLOWED_ABOVE = 5.0
"""The camera follows cloths that go over so many times their own size."""


@dataclass(frozen=True)
class Stage:
    """A scene, what of its faces is drawn, and the camera."""

    scene: Scene
    triangles: Indices  # (T, 3) vertices, counted over all objects
    cloth: Indices  # (T,) the object of each
    camera: Camera
    middle: Array  # (F, 3) m, where the camera goes along; 0 where it stays

    @property
    def size(self) -> float:
        """Of what is shown, m."""
        return float((self.camera.high - self.camera.low).max())


class Patches(NamedTuple):
    """Polygons of one number of corners and one opacity, to be painted one after another."""

    corners: Array  # (K, m, 2), m
    colours: Array  # (K, 3) red, green, blue; 0 … 1
    opacity: float = 1.0


def stage(scene: Scene, motions: Sequence[Array], most: int, shape: tuple[float, float] = (0.4, 1.6)) -> Stage:
    """The stage for motions (F, n, 3) of a scene, with `most` faces at most, and height by width within `shape`."""
    parts, cloth = [], []
    start = 0
    total = sum(len(own.triangles) for own in scene.cloths)
    for index, own in enumerate(scene.cloths):
        kept = thinned(own.positions, own.triangles, max(1, most * len(own.triangles) // max(total, 1)))
        parts.append(kept + start)
        cloth += [index] * len(kept)
        start += len(own.mass)
    triangles = np.concatenate(parts).astype(np.int32) if parts else np.zeros((0, 3), np.int32)
    middle = middles(motions[0])
    axes = direction(motions[0], triangles)
    if middle.any():
        seen = framed(axes, some(motions[0] - middle[:, None]))
    else:
        balls = [ball(sphere.centre, sphere.radius) for sphere in scene.spheres]
        seen = framed(axes, np.concatenate([*map(some, motions), *balls]))
    return Stage(scene, triangles, np.array(cloth, np.int32), shaped(seen, *shape), middle)


def some(x: Array) -> Array:
    """Points (K, 3) of a motion (F, n, 3): all, or of a large one enough to know where it goes."""
    frames, count = x.shape[:2]
    return x[:: max(1, frames // MOST_FRAMED_FRAMES), :: max(1, count // MOST_FRAMED_VERTICES)].reshape(-1, 3)


def ball(centre: Array, radius: float) -> Array:
    """The corners (8, 3) of a cube in a sphere, which is enough of it to be seen."""
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    return np.asarray(centre + 0.75 * radius * signs)


def middles(x: Array) -> Array:
    """Where the camera goes along with a motion (F, n, 3): (F, 3), 0 unless that goes far."""
    low, high = np.nanmin(x, axis=1), np.nanmax(x, axis=1)  # (F, 3)
    own = float((high - low).max())
    way = float((np.nanmax(high, axis=0) - np.nanmin(low, axis=0)).max())
    return 0.5 * (low + high) if way > FOLLOWED_ABOVE * own else np.zeros((len(x), 3))


def good_frames(x: Array) -> int:
    """How many frames of a simulated motion (F, n, 3) can be shown: those before it loses itself."""
    with np.errstate(invalid="ignore"):
        size = np.ptp(x, axis=1).max(axis=1)  # NaN where a position is not finite
        lost = np.flatnonzero(~(size <= FARTHEST_SHOWN * size[0]))
    return int(lost[0]) if len(lost) else len(x)


def painted(on: Stage, frame: int, x: Array, over: Array | None = None) -> list[Patches]:
    """All polygons of a frame with positions x (n, 3), with the target `over` (n, 3) it.

    Spheres hide what is behind them. Of what is left the target is always seen, so that none of it gets lost.
    """
    away = on.middle[frame]
    skins = [skin(on, x - away)]
    if over is not None:
        skins.append(skin(on, over - away, TARGET_COLOUR, TARGET_OPACITY))
    found: list[Patches] = []
    nearest = np.inf
    for sphere in sorted(on.scene.spheres, key=lambda s: -float(s.centre @ on.camera.forward)):
        depth = float((sphere.centre - away) @ on.camera.forward)
        found += [one.between(nearest, depth) for one in skins]
        found.append(disc(on.camera, sphere.centre - away, sphere.radius))
        nearest = depth
    return [*found, *(one.between(nearest, -np.inf) for one in skins)]


class Skin(NamedTuple):
    """The faces of cloths, farthest first."""

    patches: Patches
    depth: Array  # (K,), m

    def between(self, far: float, near: float) -> Patches:
        """Those that are not farther than one depth, and farther than another."""
        own = slice(*np.searchsorted(-self.depth, (-far, -near)))
        return self.patches._replace(corners=self.patches.corners[own], colours=self.patches.colours[own])


def skin(on: Stage, x: Array, colour: Colour | None = None, opacity: float = 1.0) -> Skin:
    """The faces at x (n, 3), in the objects' colours or in one."""
    seen = faces(on.camera, x, on.triangles)
    every = [colour or CLOTHS[i % len(CLOTHS)] for i in range(len(on.scene.cloths))]
    base = np.array(every)[on.cloth[seen.which]]
    rgb = lit(base, seen.shade * np.where(seen.outside, 1.0, BACK_BRIGHTNESS))
    return Skin(Patches(seen.corners, rgb, opacity), seen.depth)


def lit(colour: Array, shade: Array) -> Array:
    """Colours (K, 3) in some light (K,), 0 … 1: darker towards 0, and whiter towards 1."""
    dark = colour * (0.48 + 0.82 * shade[:, None])
    white = np.clip(2.6 * (shade - 0.62), 0.0, 1.0)[:, None]
    return np.clip(dark + 0.45 * white * (1.0 - dark), 0.0, 1.0)


def disc(seen: Camera, centre: Array, radius: float) -> Patches:
    """A sphere: discs, each smaller and lighter, that move towards the light."""
    angle = np.linspace(0.0, 2.0 * np.pi, DISC_CORNERS, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    inward = np.linspace(0.0, 1.0, SPHERE_DISCS)[:, None, None]
    towards = np.array(LIGHT[:2]) / np.linalg.norm(LIGHT)
    middle = project(seen, centre)[:2] + radius * inward * towards * 0.8
    corners = middle + radius * (1.0 - 0.88 * inward) * ring
    rgb = lit(np.broadcast_to(SPHERE_COLOUR, (SPHERE_DISCS, 3)), np.linspace(0.28, 0.78, SPHERE_DISCS))
    return Patches(corners, rgb)


def pins(on: Stage, frame: int, x: Array) -> Array:
    """Where the fixed vertices are in the picture (K, 2), m."""
    fixed: Flags = np.concatenate([cloth.fixed for cloth in on.scene.cloths])
    return project(on.camera, x[fixed] - on.middle[frame])[:, :2]


def bare(on: Stage, frame: int, x: Array) -> tuple[Array, Array]:
    """Where vertices are that no face shows (K, 2), m, some of very many, and their colours (K, 3)."""
    counts = on.scene.vertex_counts
    faceless = [len(cloth.triangles) == 0 for cloth in on.scene.cloths]
    shown = np.flatnonzero(np.repeat(faceless, counts))
    shown = shown[:: max(1, len(shown) // MOST_FRAMED_VERTICES)]
    own = np.repeat(np.arange(len(counts)), counts)[shown]
    colours = np.array([CLOTHS[i % len(CLOTHS)] for i in range(len(counts))])[own]
    return project(on.camera, x[shown] - on.middle[frame])[:, :2], colours


def sightings(on: Stage, frame: int, over: Array) -> Array:
    """Where a target (n, 3) that is not seen as a whole is seen (K, 2), m; nothing of one that is."""
    known = np.isfinite(over).all(axis=1)
    shown = known & (not known.all())
    return project(on.camera, over[shown] - on.middle[frame])[:, :2]


def wind(on: Stage) -> tuple[Array, float] | None:
    """The direction of the wind in the picture (2,), shorter where it goes into it, and its speed, m/s."""
    speed = float(np.linalg.norm(on.scene.wind))
    return (project(on.camera, on.scene.wind / speed)[:2], speed) if speed > 0 else None
