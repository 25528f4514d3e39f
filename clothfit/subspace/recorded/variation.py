"""Inputs at random, within ranges: what a subspace is to be able to follow is what its recorded motions show.

An episode has gusts, band-limited as splines through keys a `period` apart, each key uniform within ±`wind` along every
axis; steps of all pins together within ±`pins`; and a `pace`: what moves in the scene (pins, obstacles, its axes) does
so that much faster, all of it together, so that a figure stays whole. Every second episode ends with inputs at rest for
a third of its time, so that the motions show how the cloth comes to rest. The same seed gives the same inputs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.engine.inputs.interpolation import resolved
from clothfit.scene.cloth import Cloth
from clothfit.scene.keys import Frame, Keys
from clothfit.scene.scene import Scene
from clothfit.subspace.recorded.inputs import applied

GENTLE = 0.25
"""The push of the gusts on a cloth that faces them, relative to its weight, where nobody says how strong they are."""


@dataclass(frozen=True)
class Ranges:
    """How far the inputs of episodes go."""

    wind: float  # m/s, added to the scene's along each axis; 0: none
    pins: float = 0.0  # m, along each axis
    pace: float = 1.25  # at most, and at least its inverse
    period: float = 0.4  # s between two keys

    def check(self) -> None:
        """Raise InvalidInput where a number is impossible."""
        for name, value, least in (("wind", self.wind, 0.0), ("pins", self.pins, 0.0), ("pace", self.pace, 1.0)):
            if not (np.isfinite(value) and value >= least):
                raise InvalidInput(f"--{name} must be at least {least:g}; {value:g} was given")


@dataclass(frozen=True)
class Episode:
    """What the inputs of one motion are."""

    items: tuple[dict[str, Any], ...]  # as `inputs` has them
    pace: float = 1.0


def gentle_wind(scene: Scene) -> float:
    """The wind, m/s, that pushes the cloths of a scene with a part of their weight; 0 where they feel no air."""
    push = weight = 0.0
    for cloth in scene.cloths:
        push += air_push(cloth)
        weight += float(cloth.mass[~cloth.fixed].sum() * np.linalg.norm(scene.gravity))
    return float(f"{GENTLE * weight / push:.2g}") if push > 0 else 0.0


def air_push(cloth: Cloth) -> float:
    """The push, N, of a wind of 1 m/s on a cloth that faces it with all its faces."""
    a, b, c = (cloth.positions[corner] for corner in cloth.triangles.T)
    return 0.5 * cloth.drag * float((np.linalg.norm(np.cross(b - a, c - a), axis=1) ** 3).sum())


def episodes(scene: Scene, ranges: Ranges, count: int, seconds: float, seed: int) -> list[Episode]:
    """So many episodes of a scene; the same ones for the same seed, however many follow."""
    ranges.check()
    return [episode(scene, ranges, seconds, np.random.default_rng([seed, i]), i % 2 == 1) for i in range(count)]


def episode(scene: Scene, ranges: Ranges, seconds: float, rng: np.random.Generator, rests: bool) -> Episode:
    """One of them; `rests` says whether its inputs come to rest."""
    times: Array = np.arange(0.0, seconds + 3.0 * ranges.period, ranges.period)
    kept = np.where(times < 2.0 / 3.0 * seconds, 1.0, 0.0) if rests else np.ones(len(times))
    items: list[dict[str, Any]] = []
    gusts = rng.uniform(-1.0, 1.0, (len(times), 3)) * ranges.wind
    if ranges.wind > 0:
        own = {"acts": "wind", "times": times.tolist(), "interpolation": "smooth"}
        items.append({**own, "values": (gusts * kept[:, None]).tolist()})
    steps = rng.uniform(-1.0, 1.0, (len(times), 3)) * ranges.pins
    steps[0] = 0.0
    if ranges.pins > 0:
        own = {"acts": "pins", "times": times.tolist(), "interpolation": "smooth"}
        moved = (steps * kept[:, None]).tolist()
        items += [{**own, "object": i, "offsets": moved} for i, c in enumerate(scene.cloths) if c.fixed.any()]
    pace = float(np.exp(rng.uniform(-1.0, 1.0) * np.log(ranges.pace)))
    return Episode(tuple(items), pace if scene.moves else 1.0)


def varied(scene: Scene, own: Episode) -> Scene:
    """The scene of an episode."""
    return applied(paced(scene, own.pace) if own.pace != 1.0 else scene, own.items)


def paced(scene: Scene, pace: float) -> Scene:
    """The scene, whose inputs over time run that much faster, but for its wind and gravity."""

    def faster(keys: Keys | None) -> Keys | None:
        if keys is None:
            return None
        own = resolved(keys)
        return replace(own, times=own.times / pace, file=None, points=(), joint=None, said={})

    cloths = []
    for cloth in scene.cloths:
        pins = [replace(pin, position=faster(pin.position), rotation=faster(pin.rotation)) for pin in cloth.pins]
        cloths.append(replace(cloth, pins=tuple(pins)))
    balls = [replace(each, position=faster(each.position)) for each in scene.spheres]
    others = [replace(c, position=faster(c.position), rotation=faster(c.rotation)) for c in scene.colliders]
    frame = scene.frame and Frame(faster(scene.frame.position), faster(scene.frame.rotation), scene.frame.pivot)
    return replace(scene, cloths=tuple(cloths), spheres=tuple(balls), colliders=tuple(others), frame=frame)
