"""One frame of a scene as pixels, shaded smoothly: `kernels.raster` fills them, here is what it fills them with.

The camera projects in parallel: a place is a pixel (u, v), v downwards, and a depth, m. K triangles, n vertices,
H × W pixels.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.kernels.raster import fill, fill_sphere
from clothfit.pictures.camera import LIGHT, normals, project
from clothfit.pictures.palette import GROUND, SPHERE_COLOUR, TARGET_COLOUR
from clothfit.pictures.polygons import BACK_BRIGHTNESS, TARGET_OPACITY, Stage, cloth_colours

SPHERE_SIZE = 0.985
"""Size of a sphere as it is drawn: the faces of a cloth on it cut through it between their vertices."""

BEHIND = 1e300
"""Depth, m, of the ground: behind everything."""


def drawn(on: Stage, frame: int, x: Array, over: Array | None, width: int) -> Array:
    """The picture (H, W, 3) of positions x (n, 3), 0 … 255, with the target `over` (n, 3) over it.

    Colliders hide what is behind them. The target is translucent, and no cloth hides it.
    """
    height = round(width * on.camera.aspect)
    ground = [int(GROUND[at : at + 2], 16) / 255.0 for at in (1, 3, 5)]
    image = np.broadcast_to(np.array(ground), (height, width, 3)).copy()
    depth = np.full((height, width), BEHIND)
    spheres(on, frame, image, depth)
    bodies(on, frame, image, depth)
    veil, veil_depth = image.copy(), depth.copy()
    cloths(on, frame, x, cloth_colours(on.cloth), image, depth)
    if over is not None:
        green = np.broadcast_to(np.array(TARGET_COLOUR), (len(on.triangles), 3)).copy()
        bare = veil_depth.copy()
        cloths(on, frame, over, green, veil, veil_depth)
        seen = veil_depth < bare
        image[seen] += TARGET_OPACITY * (veil[seen] - image[seen])
    return np.round(255.0 * image).astype(np.uint8)


def cloths(on: Stage, frame: int, x: Array, colours: Array, image: Array, depth: Array) -> None:
    """Draw the faces of positions x (n, 3) in these colours (K, 3) into the image and the depths."""
    places = project(on.camera, x - on.middle[frame])
    towards = vertex_normals(places, on.triangles)
    fill(in_pixels(on, places, image), towards, on.triangles, colours, light(), BACK_BRIGHTNESS, image, depth)


def spheres(on: Stage, frame: int, image: Array, depth: Array) -> None:
    """Draw the spheres into the image and the depths."""
    scale = pixels_per_metre(on, image)
    for centre, sphere in zip(on.centres[frame], on.scene.spheres, strict=True):
        place = in_pixels(on, project(on.camera, centre - on.middle[frame])[None], image)[0]
        fill_sphere(place, SPHERE_SIZE * sphere.radius, scale, np.array(SPHERE_COLOUR), light(), image, depth)


def bodies(on: Stage, frame: int, image: Array, depth: Array) -> None:
    """Draw the other colliders."""
    for solid in on.solids:
        places = project(on.camera, solid.at(frame) - on.middle[frame])
        towards = vertex_normals(places, solid.triangles)
        colours = solid.tone[solid.triangles[:, :1]] * np.array(SPHERE_COLOUR)
        pixels = in_pixels(on, places + (0.0, 0.0, on.give), image)
        fill(pixels, towards, solid.triangles, colours, light(), BACK_BRIGHTNESS, image, depth)


def light() -> Array:
    """The unit vector (3,) towards the light, along right, up and forward."""
    return np.asarray(np.array(LIGHT) / np.linalg.norm(LIGHT))


def pixels_per_metre(on: Stage, image: Array) -> float:
    """The scale of an image (H, W, 3)."""
    return float(image.shape[1]) / float(on.camera.high[0] - on.camera.low[0])


def in_pixels(on: Stage, places: Array, image: Array) -> Array:
    """Pixels, counted downwards, and depth (n, 3), m, of places (n, 3) along right, up and forward, m."""
    scale = pixels_per_metre(on, image)
    u, v = scale * (places[:, 0] - on.camera.low[0]), scale * (on.camera.high[1] - places[:, 1])
    return np.stack([u, v, places[:, 2]], axis=1)


def vertex_normals(places: Array, triangles: Indices) -> Array:
    """Normals (n, 3) of places (n, 3): the sum of those of the faces that meet there, each as long as twice its area;
    faces with a corner that is not finite do not count.
    """
    known = np.isfinite(places[triangles]).all(axis=(1, 2))
    own, found = normals(places, triangles[known]), np.zeros(places.shape)
    for corner in range(3):
        np.add.at(found, triangles[known, corner], own)
    return np.asarray(found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-300))
