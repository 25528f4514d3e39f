"""Keys at the times of the steps: rotations, places, moving axes, and the tables of a cloth; all keys of a scene."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import NO_VECTORS, Array, Indices
from clothfit.base.errors import InvalidScene
from clothfit.engine.forces.collider_rows import AXES, PLACE, RATE, SIZE, SPIN, STATE, VELOCITY
from clothfit.engine.inputs import fitted_paths
from clothfit.engine.inputs.interpolation import growth, interpolated, resolved
from clothfit.engine.inputs.poses import Poses
from clothfit.engine.inputs.poses import build as build_poses
from clothfit.engine.inputs.tables import Inputs
from clothfit.scene.cloth import AXIS_OF_SIZE, CAPSULE, MESH, SPHERE, Cloth, Collider
from clothfit.scene.keys import Frame, Keys, Pin
from clothfit.scene.scene import Scene

FARTHEST_TURN = 0.8 * np.pi  # rad from the first key, up to which rotation vectors do not jump
MISSED = 1e-6  # rad by which a spline may miss its keys
ANY_NUMBER = 2**31  # of steps: tables without rows have no end


class Axes(NamedTuple):
    """A moving frame of reference at T times: the axes in which a scene is meant move in those of the world.

        X = turn (x − pivot) + pivot + shift

    is the place in the world of what is at x in the scene; at time 0 both are the same. A cloth is simulated in the
    world, where no forces of inertia act: its fixed vertices, pins and colliders are led there, and gravity and wind
    are those of the world. Linear acceleration, Euler, centrifugal and Coriolis force are in it, as exactly as the
    steps are, and so are all derivatives: distances, and with them squared errors, are the same in both. Written as
    forces in the scene's axes, they would ask for a term that depends on velocities by an antisymmetric matrix, which
    a step's symmetric one has no room for; taken at the step's beginning it adds energy.
    """

    turn: Array  # (T, 3, 3)
    pivot: Array  # (3,), m
    shift: Array  # (T, 3), m

    def at(self, place: int) -> Axes:
        """The axes at one of the times."""
        return Axes(self.turn[place : place + 1], self.pivot, self.shift[place : place + 1])

    def world(self, x: Array) -> Array:
        """Places (T, n, 3) of the scene's axes, or (1, n, 3) that stay there, in the world, m."""
        return np.asarray((x - self.pivot) @ self.turn.transpose(0, 2, 1) + (self.pivot + self.shift)[:, None])

    def own(self, places: Array) -> Array:
        """Places (T, n, 3) of the world in the scene's axes, m."""
        away = places - (self.pivot + self.shift)[:, None]
        return np.asarray(away @ self.turn + self.pivot)

    def directions(self, vectors: Array) -> Array:
        """Vectors (T, n, 3) of the world in the scene's axes."""
        return np.asarray(vectors @ self.turn)

    def world_directions(self, vectors: Array) -> Array:
        """Vectors (T, n, 3) of the scene's axes in the world."""
        return np.asarray(vectors @ self.turn.transpose(0, 2, 1))


def build(scene: Scene, cloth: Cloth, steps: int) -> Inputs:
    """The tables of a cloth of the scene for so many steps. Raises InvalidScene for a file that cannot be read or does
    not fit.
    """
    try:
        return sampled(scene, cloth, steps)
    except InvalidScene as error:
        raise InvalidScene(error.problems, scene.name) from None


def sampled(scene: Scene, cloth: Cloth, steps: int) -> Inputs:
    """The tables of a cloth with inputs that change."""
    lead, turns, drift = int(scene.method >= 2), np.zeros((0, 3, 3)), NO_VECTORS
    times: Array = scene.delta * np.arange(steps + 3, dtype=float)  # explicit steps read two rows
    wind, gravity = (
        interpolated(resolved(keys), times) if keys else NO_VECTORS for keys in (scene.wind_keys, scene.gravity_keys)
    )
    moving_axes = axes(scene.frame, times) if scene.frame else None
    own = applied(scene, cloth, times, moving_axes)
    if scene.mode("gusts") != "n" and scene.wind_keys:
        own["gusts"] = np.array(scene.gusts)
        own["share"] = interpolated(replace(scene.wind_keys, values=np.eye(len(scene.gusts))), times)
    pins, path = paths(cloth, times)
    centre = places(scene, times, lead)
    if scene.frame and moving_axes:
        others = np.setdiff1d(np.flatnonzero(cloth.fixed), pins).astype(np.int32)
        still = np.broadcast_to(cloth.positions[others], (len(times), len(others), 3))
        pins, frame = np.concatenate([pins, others]), moving_axes
        path = frame.world(np.concatenate([path if len(path) else still[:, :0], still], axis=1))
        start, first, second = (frame.at(k).world(cloth.positions[None])[0] for k in range(3))
        drift = (4.0 * first - second - 3.0 * start) / (2.0 * scene.delta)
        turns = np.ascontiguousarray(frame.turn) if scene.frame.rotation else turns
    held = np.isin(cloth.springs, pins)
    coupled = np.flatnonzero((held & ~cloth.fixed[cloth.springs][:, ::-1]).any(axis=1)).astype(np.int32)
    moves = scene.changes or cloth.pins
    return Inputs(
        energetic=bool(moves or (scene.forces and scene.forces.pulls)),
        wind=wind, gravity=gravity, centre=centre, path=path, pins=pins, coupled=coupled, **own,
        wind_base=np.array(scene.wind, float), gravity_base=np.array(scene.gravity, float),
        drift=drift, counted=np.zeros(3),
        fitted=fitted_paths.build(cloth, path, turns, partial(moved, times=times)),
        place=np.zeros((len(pins), 3)), later=np.zeros((len(pins), 3)),
        lead=lead, steps=steps if moves or scene.forces else ANY_NUMBER, poses=poses_of(scene, times),
    )  # fmt: skip


def applied(scene: Scene, cloth: Cloth, times: Array, frame: Axes | None) -> dict[str, Array]:
    """The tables of what is applied to a cloth in the steps that begin at times (T,), s: forces, and gains and places
    of what pulls it, in the world where the axes of the scene move; none where the scene has none.
    """
    if scene.forces is None:
        return {}
    own = scene.vertices(scene.cloths.index(cloth)) if cloth in scene.cloths else slice(None)
    force, gain, target = scene.forces.at(times)
    mine = force[:, own]
    made = {"force": np.ascontiguousarray(frame.world_directions(mine) if frame else mine)}
    if gain is not None and target is not None:
        gain, target = gain[:, own], target[:, own]
        if frame:
            later = np.minimum(np.arange(len(times)) + 1, len(times) - 1)
            target = Axes(frame.turn[later], frame.pivot, frame.shift[later]).world(target)
        made |= {"gain": np.ascontiguousarray(gain), "target": np.ascontiguousarray(target)}
    return made


def poses_of(scene: Scene, times: Array) -> Poses:
    """The poses of the meshes among the colliders at times (T,), s."""
    if not any(each.body for each in scene.colliders):
        return Poses()
    from clothfit.engine.inputs.body_files import bodies_of  # what reads all formats, which few scenes need

    moving = [each.motion or collider.scaling for collider in scene.colliders if (each := collider.body)]
    ways = [keys.interpolation if keys else "" for keys in moving]
    return build_poses(bodies_of(scene.colliders), ways, times)


def rotation(angles: Array) -> Any:
    """Rotations by Euler angles (…, 3), degrees, as Unity applies them: about z, then x, then y."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("YXZ", np.asarray(angles)[..., [1, 0, 2]], degrees=True)


def turned(keys: Keys, times: Array) -> Array:
    """The rotations (T, 3, 3) since time 0 at times (T,), s; between two keys about one axis, at one rate or, smooth,
    by a spline of angular rates, or where that is not found by monotone cubics of rotation vectors, which do not swing
    beyond keys that are unevenly spaced. Raises InvalidScene where these go round too far for that.
    """
    from scipy.interpolate import PchipInterpolator
    from scipy.spatial.transform import Rotation, RotationSpline, Slerp

    known = resolved(keys)
    own, angles = known.times, rotation(known.values)
    inside = np.clip(np.append(0.0, times), own[0], own[-1])
    if known.interpolation == "hold" or len(own) == 1:
        found = angles[np.searchsorted(own, inside, side="right") - 1]
    elif known.interpolation != "smooth":
        found = Slerp(own, angles)(inside)
    else:
        try:
            with np.errstate(all="ignore"):  # its iterations may grow without bounds
                spline = RotationSpline(own, angles)
                if not (spline(own) * angles.inv()).magnitude().max() <= MISSED:
                    raise ValueError
            found = spline(inside)
        except (ValueError, np.linalg.LinAlgError):
            vectors = (angles * angles[0].inv()).as_rotvec()
            if np.linalg.norm(vectors, axis=1).max() > FARTHEST_TURN:
                raise InvalidScene(
                    f"{keys.place}: no smooth rotation goes through keys that turn so far in so little time; give more "
                    'keys, or "interpolation": "linear"'
                ) from None
            found = Rotation.from_rotvec(PchipInterpolator(own, vectors)(inside)) * angles[0]
    return np.asarray((found[1:] * found[0].inv()).as_matrix())


def moved(keys: Keys, times: Array) -> Array:
    """The change (T, …, 3) since time 0, m, at times (T,), s."""
    found = interpolated(resolved(keys), np.append(0.0, times))
    return np.asarray(found[1:] - found[0])


def axes(frame: Frame, times: Array) -> Axes:
    """The axes of a scene in those of the world at times (T,), s."""
    turn = turned(frame.rotation, times) if frame.rotation else np.broadcast_to(np.eye(3), (len(times), 3, 3))
    pivot = pivot_of(frame.rotation, frame.pivot, np.zeros(3))
    return Axes(turn, pivot, shift(frame.position, times) if frame.position else np.zeros((len(times), 3)))


def pivot_of(keys: Keys | None, said: Array | None, otherwise: Array) -> Array:
    """The centre (3,) of a rotation, m: what the scene says; where a joint turns, its place at time 0."""
    if said is not None or keys is None or keys.joint is None:
        return otherwise if said is None else said
    path = replace(keys, place=f"{keys.place.rpartition('.')[0]}.posKeys")  # of the same joint
    return np.asarray(interpolated(replace(resolved(path), interpolation="linear"), np.zeros(1))[0])


def places(scene: Scene, times: Array, lead: int) -> Array:
    """Where spheres and colliders are, (T, C + 8 D, 3), as `tables.Inputs` has it; none where all stay."""
    moving = any(each.position for each in scene.spheres) or any(each.moves for each in scene.colliders)
    if not (moving or scene.frame):
        return np.zeros((0, len(scene.spheres) + STATE * len(scene.colliders), 3))
    frame, centres = axes(scene.frame, times) if scene.frame else None, centres_at(scene, times)
    others = states(scene.colliders, times, scene.delta, lead, frame).reshape(len(times), -1, 3)
    return np.concatenate([frame.world(centres) if frame else centres, others], axis=1)


def shift(keys: Keys, times: Array) -> Array:
    """The change (T, 3) since time 0, m, of what moves as one. Raises InvalidScene for several points of a file."""
    change = moved(keys, times)
    if change.ndim == 3 and change.shape[1] != 1:
        raise InvalidScene(f"{keys.place}.points: {change.shape[1]} points of the file; give the one to follow")
    return change.reshape(len(times), 3)


def states(colliders: Sequence[Collider], times: Array, h: float, lead: int, frame: Axes | None = None) -> Array:
    """The states (T, C, 8, 3) of colliders at times (T,), a step h apart, s: places, velocities, spins, axes, sizes and
    rates (see `forces.collider_rows`), in the world where the axes of the scene move. The velocity at a time is that of
    the step that ends there, with `lead` 0 of that which begins.
    """
    out = np.zeros((len(times), len(colliders), STATE, 3))
    step = np.clip(np.arange(len(times)) - lead, 0, max(len(times) - 2, 0))
    for c, each in enumerate(colliders):
        out[:, c, PLACE] = each.centre
        start = rotation(each.angles).as_matrix() if each.angles.any() else np.eye(3)
        turns = np.broadcast_to(start, (len(times), 3, 3))
        if each.rotation:
            turn = turned(each.rotation, times)
            away = each.pos - pivot_of(each.rotation, None, each.pos)  # an offset moves the whole path
            turns = turn @ turns
            out[:, c, PLACE] += turn @ away - away
        if each.position:
            out[:, c, PLACE] += shift(each.position, times)
        if frame:
            out[:, c, PLACE] = frame.world(out[:, c : c + 1, PLACE])[:, 0]
        if each.moves or frame:
            out[:, c, VELOCITY] = np.diff(out[:, c, PLACE], axis=0, append=out[-1:, c, PLACE])[step] / h
        if frame:
            turns = frame.turn @ turns
        if each.rotation or frame:
            out[:, c, SPIN] = spins(turns)[step] / h
        out[:, c, AXES:SIZE] = turns.transpose(0, 2, 1)
        out[:, c, SIZE] = each.size
        if each.scaling:
            size, rate = stretches(each, times, step, h)
            if each.kind != MESH:  # whose vertices move
                out[:, c, SIZE], out[:, c, RATE] = size, rate
    return out


def stretches(collider: Collider, times: Array, step: Any, h: float) -> tuple[Array, Array]:
    """The sizes (T, 3), m, of a collider over time, and the rates (T, 3), 1/s, at which it stretches along its axes in
    the step that counts at each time.
    """
    assert collider.scaling is not None
    along = growth(collider.scaling, times)[:, list(AXIS_OF_SIZE[collider.kind])]
    change = np.diff(along, axis=0, append=along[-1:])[step]
    rates = change / (h * along)
    if collider.kind in (SPHERE, CAPSULE):  # the radii by x, the distance between the ends, along y, by y
        rates = rates[:, [0, 2, 0]]
    return collider.size * along, rates


def winds(scene: Scene, times: Array) -> Array:
    """The wind (T, 3), m/s, at times (T,), s, in the axes of the scene."""
    added = interpolated(resolved(scene.wind_keys), times) if scene.wind_keys else np.zeros((len(times), 3))
    found = np.asarray(scene.wind + added)
    return axes(scene.frame, times).directions(found[:, None])[:, 0] if scene.frame else found


def poses(colliders: Sequence[Collider], times: Array) -> tuple[Array, Array]:
    """The centres (T, C, 3), m, and axes (T, C, 3, 3), one in each column, of colliders at times (T,), s."""
    found = states(colliders, times, 1.0, 0)
    return found[:, :, PLACE], np.swapaxes(found[:, :, AXES:SIZE], 2, 3)


def spins(turns: Array) -> Array:
    """The rotation vectors (T, 3), rad, from each of the rotations (T, 3, 3) to the next one, the last of them 0."""
    from scipy.spatial.transform import Rotation

    between = turns[1:] @ turns[:-1].transpose(0, 2, 1)
    return np.concatenate([Rotation.from_matrix(between).as_rotvec(), np.zeros((1, 3))])


def centres_at(scene: Scene, times: Array) -> Array:
    """The centres (T, C, 3) of all spheres of a scene at times (T,), s, in m, whether they move or not."""
    found = np.empty((len(times), len(scene.spheres), 3))
    for c, sphere in enumerate(scene.spheres):
        found[:, c] = sphere.centre + (shift(sphere.position, times) if sphere.position else 0.0)
    return found


def paths(cloth: Cloth, times: Array) -> tuple[Indices, Array]:
    """The vertices (P,) of the pins of a cloth, pin by pin, and their places (T, P, 3) at times (T,), s, in m; no times
    without pins.
    """
    if not cloth.pins:
        return np.zeros(0, np.int32), np.zeros((0, 0, 3))
    found = np.concatenate([path(cloth.positions[pin.vertices], pin, times) for pin in cloth.pins], axis=1)
    places = found + cloth.shift if cloth.shift.any() else found
    return np.concatenate([pin.vertices for pin in cloth.pins]).astype(np.int32), places


def path(start: Array, pin: Pin, times: Array) -> Array:
    """The places (T, P, 3) of the vertices of a pin that are at `start` (P, 3) at time 0, m."""
    places = np.broadcast_to(start, (len(times), *start.shape)).copy()
    if pin.rotation:
        pivot = pivot_of(pin.rotation, pin.pivot, start.mean(axis=0))
        places = pivot + np.einsum("tij,pj->tpi", turned(pin.rotation, times), start - pivot)
    if pin.position:
        change = moved(pin.position, times)
        if change.ndim == 3 and change.shape[1] not in (1, len(start)):
            have = f"{change.shape[1]} points of the file for {len(start)} vertices"
            raise InvalidScene(f"{pin.position.place}.points: {have}; give one point for all, or one for each vertex")
        places += change if change.ndim == 3 else change[:, None]
    return places


def keyed(scene: Scene) -> Iterator[tuple[Keys, int | None]]:
    """The keys of a scene, and how many vertices each moves where it is a pin's."""
    for cloth in scene.cloths:
        for pin in cloth.pins:
            for keys in filter(None, (pin.position, pin.rotation)):
                yield keys, len(pin.vertices)
    moved = [each.position for each in scene.spheres]
    for each in scene.colliders:
        moved += [each.position, each.rotation, each.scaling, each.body.motion if each.body else None]
    frame = (scene.frame.position, scene.frame.rotation) if scene.frame else ()
    for keys in filter(None, (scene.wind_keys, scene.gravity_keys, *frame, *moved)):
        yield keys, None


def arrays_from_files(scene: Scene) -> list[Array]:
    """The times and values of all keys and forces, and the meshes, that the text of the scene has not. Raises
    InvalidScene where one cannot be read.
    """
    found = []
    for keys, _ in keyed(scene):
        if keys.file is not None:
            own = resolved(keys)
            found += [own.times, own.values]
    if scene.forces is not None:
        found += [scene.forces.times, scene.forces.values]
    if any(each.body and each.body.file for each in scene.colliders):
        from clothfit.engine.inputs.body_files import bodies_of  # what reads all formats, which few scenes need

        for each in bodies_of(scene.colliders):
            found += [each.surface.place, each.surface.triangles.astype(float)]
    return found
