"""A scene before the camera, and one frame of it as pixels, shaded smoothly: `kernels.raster` fills them, here is what
it fills them with. Both `plots` (matplotlib) and `gif` (Pillow) draw on these pictures.

Of a controlled motion a picture shows `Marks` beside the cloths: forces as arrows, the means that keys ask for as dots,
and the keys in the place of a target.

The camera projects in parallel: a place is a pixel (u, v), v downwards, and a depth, m. K triangles, n vertices,
F frames, H × W pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.inputs.sampling import centres_at, winds
from clothfit.formats.animation import normals_at
from clothfit.kernels.raster import fill, fill_sphere
from clothfit.pictures.camera import LIGHT, Camera, direction, framed, project, shaped, thinned
from clothfit.pictures.picture_file import CLOTHS, GROUND, RED, SPHERE_COLOUR, TARGET_COLOUR, Colour
from clothfit.pictures.solids import Solid, solids
from clothfit.scene.cloth import Cloth
from clothfit.scene.scene import Scene

if TYPE_CHECKING:
    from clothfit.control.control import ControlledMotion

TARGET_OPACITY = 0.40

TO_LIGHT, COLOURS = np.array(LIGHT) / np.linalg.norm(LIGHT), np.array(CLOTHS)
"""The unit vector (3,) towards the light, along right, up and forward; colours of the objects, in turn."""

SPHERE_SIZE = 0.985
"""Size of a sphere as it is drawn: the faces of a cloth on it cut through it between their vertices."""

BEHIND = 1e300
"""Depth, m, of the ground: behind everything."""

BACK_BRIGHTNESS = 0.86
"""Brightness of a cloth's back relative to its front."""

MOST_FRAMED_FRAMES, MOST_FRAMED_VERTICES = 200, 5000
"""Most frames and vertices of a motion that are looked at to choose the camera's view."""

LARGEST_GROWTH = 20.0
"""A motion that has grown to this many times its size at the start has diverged; its later frames are left out."""

GIVE = 0.35
"""How far behind their place solids are drawn, relative to the mean edge of a face: between two vertices on a collider
a face cuts through it.
"""

FOLLOWED_ABOVE = 5.0
"""The camera follows cloths that travel farther than this many times their own size."""


MOST_ARROWS = 200
"""Of a frame; of more vertices every k-th has one."""

LONGEST, SHORTEST = 0.16, 0.006
"""Length of the arrow of the largest force, and of the shortest one that is drawn, relative to the cloths' size."""

ARROW = RED

FORCE: Colour = (0xD5 / 255, 0x5E / 255, 0.0)
"""The same colour for a legend."""

LEGEND = (("key", TARGET_COLOUR), ("cloth", CLOTHS[0]), ("force", FORCE))
"""Names and colours, from right to left."""


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
    when = scene.delta * np.arange(len(motions[0]), dtype=float) if times is None else times
    middle, centres = middles(motions[0]), centres_at(scene, when)
    others, air = solids(scene, when, motions[0]), winds(scene, when)
    axes = direction(motions[0], triangles)
    if middle.any():
        seen = framed(axes, some(motions[0] - middle[:, None]))
    else:
        signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
        # the corners of a cube in a sphere: as much of it as a picture must show
        balls = [c + 0.75 * s.radius * signs for c, s in zip(centres.mean(axis=0), scene.spheres, strict=True)]
        looks = {0, len(when) // 2, len(when) - 1}
        bodies = [each.at(frame) for each in others if not each.endless for frame in looks]
        seen = framed(axes, np.concatenate([*map(some, motions), *balls, *bodies]))
    x = motions[0][0]
    edges = np.linalg.norm(x[triangles] - x[np.roll(triangles, 1, axis=1)], axis=2)  # m
    owners, give = np.array(cloth, np.int32), GIVE * float(np.nanmean(edges)) if edges.size else 0.0
    return Stage(scene, triangles, owners, shaped(seen, *shape), middle, centres, others, air, give)


def some(x: Array) -> Array:
    """Points (K, 3) of a motion (F, n, 3); of a large one a sample."""
    frames, count = x.shape[:2]
    return x[:: max(1, frames // MOST_FRAMED_FRAMES), :: max(1, count // MOST_FRAMED_VERTICES)].reshape(-1, 3)


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
        lost = np.flatnonzero(~(size <= LARGEST_GROWTH * size[0]))
    return int(lost[0]) if len(lost) else len(x)


def drawn(on: Stage, frame: int, x: Array, over: Array | None, width: int) -> Array:
    """The picture (H, W, 3) of positions x (n, 3), 0 … 255, with the target `over` (n, 3) over it.

    Colliders hide what is behind them. The target is translucent, and no cloth hides it.
    """
    height = round(width * on.camera.aspect)
    image = np.tile([int(GROUND[at : at + 2], 16) / 255.0 for at in (1, 3, 5)], (height, width, 1))
    depth = np.full((height, width), BEHIND)
    colliders(on, frame, image, depth)
    veil, veil_depth = image.copy(), depth.copy()
    places = project(on.camera, x - on.middle[frame])
    surface(on, places, on.triangles, COLOURS[on.cloth % len(CLOTHS)], 0.0, image, depth)
    if over is not None:
        green, before = np.tile(TARGET_COLOUR, (len(on.triangles), 1)), veil_depth.copy()
        surface(on, project(on.camera, over - on.middle[frame]), on.triangles, green, 0.0, veil, veil_depth)
        seen = veil_depth < before
        image[seen] += TARGET_OPACITY * (veil[seen] - image[seen])
    return np.round(255.0 * image).astype(np.uint8)


def colliders(on: Stage, frame: int, image: Array, depth: Array) -> None:
    """Draw the spheres and the other colliders into the image and the depths."""
    width = image.shape[1]
    for centre, sphere in zip(on.centres[frame], on.scene.spheres, strict=True):
        place = in_pixels(on, project(on.camera, centre - on.middle[frame]), width)
        radius, scale = SPHERE_SIZE * sphere.radius, pixels_per_metre(on, width)
        fill_sphere(place, radius, scale, np.array(SPHERE_COLOUR), TO_LIGHT, image, depth)
    for solid in on.solids:
        colours = solid.tone[solid.triangles[:, :1]] * np.array(SPHERE_COLOUR)
        places = project(on.camera, solid.at(frame) - on.middle[frame])
        surface(on, places, solid.triangles, colours, on.give, image, depth)


def surface(
    on: Stage, places: Array, triangles: Indices, colours: Array, back: float, image: Array, depth: Array
) -> None:
    """Draw triangles (K, 3) between places (n, 3) along right, up and forward, moved `back` from the camera, m."""
    towards = normals_at(places, triangles[np.isfinite(places[triangles]).all(axis=(1, 2))])
    pixels = in_pixels(on, places + (0.0, 0.0, back), image.shape[1])
    fill(pixels, towards, triangles, colours, TO_LIGHT, BACK_BRIGHTNESS, image, depth)


def pixels_per_metre(on: Stage, width: int) -> float:
    """The scale of an image so many pixels wide."""
    return width / float(on.camera.high[0] - on.camera.low[0])


def in_pixels(on: Stage, places: Array, width: int) -> Array:
    """Pixels, counted downwards, of places (…, 2) along right and up, m, in an image so wide; depths stay."""
    flat = pixels_per_metre(on, width) * (places[..., :2] - (on.camera.low[0], on.camera.high[1])) * (1.0, -1.0)
    return np.concatenate([flat, places[..., 2:]], axis=-1)


def flat(on: Stage, frame: int, x: Array) -> Array:
    """The places (n, 2), m, of positions x (n, 3) in the picture."""
    return project(on.camera, x - on.middle[frame])[:, :2]


def pins(on: Stage, frame: int, x: Array) -> Array:
    """The places (K, 2), m, of the fixed vertices in the picture, but of those that only fixed ones surround."""
    shown: Flags = np.concatenate([border(cloth) for cloth in on.scene.cloths])
    return flat(on, frame, x[shown])


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
    return flat(on, frame, x[shown]), COLOURS[own % len(CLOTHS)]


def sightings(on: Stage, frame: int, over: Array) -> Array:
    """The places (K, 2), m, of the observed vertices of a target (n, 3) that is observed in part; else none."""
    known = np.isfinite(over).all(axis=1)
    shown = known & (not known.all())
    return flat(on, frame, over[shown])


def wind(on: Stage, frame: int) -> tuple[Array, float] | None:
    """The wind's unit vector projected into the picture (2,), and its speed, m/s; None without wind."""
    speed = float(np.linalg.norm(on.wind[frame]))
    return (project(on.camera, on.wind[frame] / speed)[:2], speed) if speed > 0 else None


class Marks(NamedTuple):
    """What is drawn at each frame."""

    keys: Array  # (F, n, 3), m, the key that comes next
    arrows: Array  # (F, n, 3), m, from each vertex; 0 where there is none
    dots: tuple[Array, ...]  # of each frame the places (M, 3), m, that means are to be at
    held: Indices  # frames that a film shows for longer
    largest: float  # N, of the longest arrow; 0: there are none

    @property
    def legend(self) -> tuple[tuple[str, Colour], ...]:
        """Names and colours, from right to left."""
        return LEGEND if self.largest > 0 else LEGEND[:-1]

    def seen(self, x: Array) -> list[Array]:
        """What a picture of a motion x (F, n, 3), m, shows beside it: keys and tips of arrows."""
        return [self.keys, x + self.arrows[: len(x)]]


def marks(motion: ControlledMotion) -> Marks:
    """The marks of a course."""
    near = [motion.next(frame) for frame in range(len(motion.times))]
    size = float(np.linalg.norm(np.ptp(motion.own[0], axis=0)))
    strength = np.linalg.norm(motion.forces, axis=2)
    largest = float(strength.max(initial=0.0))
    arrows = motion.forces * (LONGEST * size / largest if largest > 0 else 0.0)
    pushed = np.flatnonzero(strength.any(axis=0))
    kept = np.zeros(arrows.shape[1], bool)
    kept[pushed[:: max(1, -(-len(pushed) // MOST_ARROWS))]] = True
    arrows[:, ~kept] = 0.0
    arrows[np.linalg.norm(arrows, axis=2) < SHORTEST * size] = 0.0
    return Marks(motion.poses[near], arrows, tuple(motion.means[k] for k in near), motion.due, largest)


def arrows(on: Stage, frame: int, x: Array, found: Marks) -> tuple[Array, Array]:
    """Tails and tips (K, 2), m, in the picture, of the arrows at positions x (n, 3)."""
    own = found.arrows[frame]
    drawn = own.any(axis=1)
    tails = x[drawn] - on.middle[frame]
    return project(on.camera, tails)[:, :2], project(on.camera, tails + own[drawn])[:, :2]


def dots(on: Stage, frame: int, found: Marks) -> Array:
    """The places (M, 2), m, in the picture, that means are to be at."""
    return flat(on, frame, found.dots[frame])
