"""The paths of handles, the pins of a scene, as other programs play them: keys of places and turns, in glTF and USD.

Between two keys a program moves on a straight line at one speed, or stands still where the scene says "hold". That is
what linear keys of the scene are; smooth ones, and turns, are given after every time step, which is all that a
simulation sees of them. Coordinates and quaternions are in right-handed axes with y up, as glTF and USD have them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidInput
from clothfit.engine.inputs.interpolation import interpolated, resolved
from clothfit.engine.inputs.sampling import pivot_of, turned
from clothfit.formats.axes import RIGHT, from_scene
from clothfit.formats.glb import Parts, glb
from clothfit.scene.cloth import Cloth
from clothfit.scene.keys import Keys, Pin
from clothfit.scene.scene import Scene

if TYPE_CHECKING:
    from pxr import Usd

JUST_BEFORE = 1e-6
"""Time codes between the end of a place that is held and the next one."""


class Handle(NamedTuple):
    """A path that fixed vertices of an object follow."""

    name: str
    cloth: int  # the object
    vertices: Indices  # (P,), of the object
    times: Array  # (K,), s, from 0 on
    places: Array  # (K, 3), m
    holds: bool  # whether it stays at each place until the next time
    turn_times: Array  # (R,), s
    turns: Array  # (R, 4), quaternions x, y, z, w, of the vertices about the place; (0, 4): they do not turn


def handles(scene: Scene) -> list[Handle]:
    """The handles of all objects, up to the end of the scene's steps. Raises InvalidInput where there is none."""
    if scene.frame:
        raise InvalidInput(f"{scene.name}: frame: paths of pins in axes that move cannot be exported")
    found = []
    for number, cloth in enumerate(scene.cloths):
        for i, pin in enumerate(cloth.pins):
            found += of_pin(scene, number, cloth, pin, f"object{number}_pin{i}")
    if not found:
        raise InvalidInput(
            f"{scene.name}: has no pins; only their paths are exported; for its motion: clothfit simulate SCENE -o "
            "MOTION.usd, or .glb"
        )
    return found


def of_pin(scene: Scene, number: int, cloth: Cloth, pin: Pin, name: str) -> list[Handle]:
    """The handle of a pin; of one whose vertices go their own ways a handle for each."""
    steps = scene.delta * np.arange(scene.frames, dtype=float)
    start = cloth.positions[pin.vertices] + cloth.shift
    times, change = path(pin.position, steps)
    turn_times, turns = rotations(pin.rotation, steps)
    holds = pin.position is not None and pin.position.interpolation == "hold"
    if change.ndim == 2 or change.shape[1] == 1:
        pivot = pivot_of(pin.rotation, pin.pivot, start.mean(axis=0) - cloth.shift) + cloth.shift
        places = from_scene(pivot + change.reshape(-1, 3), RIGHT)
        return [Handle(name, number, pin.vertices, times, places, holds, turn_times, turns)]
    if len(turns):
        raise InvalidInput(f"{scene.name}: {name}: vertices that turn while each follows a point cannot be exported")
    return [
        Handle(f"{name}_{vertex}", number, pin.vertices[j : j + 1], times, from_scene(start[j] + change[:, j], RIGHT),
               holds, turn_times, turns)
        for j, vertex in enumerate(pin.vertices.tolist())
    ]  # fmt: skip


def path(keys: Keys | None, steps: Array) -> tuple[Array, Array]:
    """Times (K,), s, and the change since time 0 there, (K, 3) or (K, P, 3), m."""
    if keys is None:
        return steps[:1], np.zeros((1, 3))
    known = resolved(keys)
    end = float(steps[-1])
    times = steps
    if known.interpolation != "smooth" or len(known.times) == 1:
        inside = known.times[(known.times > 0.0) & (known.times < end)]
        times = np.unique(np.concatenate([[0.0], inside, [end]]))
    found = interpolated(known, np.append(0.0, times))
    return times, found[1:] - found[0]


def rotations(keys: Keys | None, steps: Array) -> tuple[Array, Array]:
    """Times (R,), s, and quaternions (R, 4) in right-handed axes; each within half a turn of the one before."""
    from scipy.spatial.transform import Rotation

    if keys is None:
        return np.zeros(0), np.zeros((0, 4))
    mirror = np.diag([-1.0, 1.0, 1.0])
    found = Rotation.from_matrix(mirror @ turned(keys, steps) @ mirror).as_quat()
    opposite = np.concatenate([[False], (found[1:] * found[:-1]).sum(axis=1) < 0.0])
    return steps, found * np.where(np.cumsum(opposite) % 2 == 1, -1.0, 1.0)[:, None]


def gltf(scene: Scene) -> dict[str, bytes]:
    """One GLB file: a node for each handle, where the vertices of its pin turn about, their mean where they do not,
    moved by an animation; `extras` have the object and the vertices. Keys are float32, linear, or steps where the scene
    holds its keys.
    """
    parts, found = Parts(), handles(scene)
    nodes: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    for node, each in enumerate(found):
        extras = {"object": each.cloth, "vertices": each.vertices.tolist()}
        nodes.append({"name": each.name, "translation": each.places[0].tolist(), "extras": extras})
        tracks = [("translation", each.times, each.places, "VEC3", "STEP" if each.holds else "LINEAR")]
        tracks += [("rotation", each.turn_times, each.turns, "VEC4", "LINEAR")] if len(each.turns) else []
        for name, times, values, kind, way in tracks:
            channels.append({"sampler": len(samplers), "target": {"node": node, "path": name}})
            before, after = parts.add(singles(times), "SCALAR", True), parts.add(values.astype(np.float32), kind)
            samplers.append({"input": before, "output": after, "interpolation": way})
    document = {
        "asset": {"version": "2.0", "generator": "clothfit"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(found)))}],
        "nodes": nodes,
        "animations": [{"name": "handles", "samplers": samplers, "channels": channels}],
        "accessors": parts.accessors,
        "bufferViews": parts.views,
    }
    return {"handles.glb": glb(document, parts, "handles.glb")}


def singles(times: Array) -> NDArray[np.float32]:
    """Times as float32, none later than it was: at the end of a step a place that is held has begun."""
    found = times.astype(np.float32)
    return np.where(found > times, np.nextafter(found, np.float32(0.0)), found)




def usd(scene: Scene) -> dict[str, bytes]:
    """One file, text with all digits of a place: an Xform for each handle, with samples of its place, and of its turn,
    over time. A time code is a time step. Raises InvalidInput where the library is not installed.
    """
    found = handles(scene)
    try:
        from pxr import Usd, UsdGeom
    except ImportError:
        raise InvalidInput("USD needs pxr; install it with: pip install 'clothfit[usd]'") from None
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    rate = 1.0 / scene.delta
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    stage.SetStartTimeCode(0.0)
    stage.SetEndTimeCode(float(scene.frames - 1))
    root = UsdGeom.Xform.Define(stage, "/handles")
    stage.SetDefaultPrim(root.GetPrim())
    for each in found:
        define(stage, each, scene.delta)
    return {"handles.usda": stage.GetRootLayer().ExportToString().encode()}


def define(stage: Usd.Stage, handle: Handle, delta: float) -> None:
    """The Xform of a handle."""
    from pxr import Gf, UsdGeom

    made: Any = UsdGeom.Xform.Define(stage, f"/handles/{handle.name}")
    made.GetPrim().SetCustomDataByKey("object", handle.cloth)
    made.GetPrim().SetCustomDataByKey("vertices", " ".join(map(str, handle.vertices.tolist())))
    codes, places = samples(handle, delta)
    place = made.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble)
    for code, (x, y, z) in zip(codes.tolist(), places.tolist(), strict=True):
        place.Set(Gf.Vec3d(x, y, z), code)
    if len(handle.turns):
        turn = made.AddOrientOp(UsdGeom.XformOp.PrecisionDouble)
        for code, (x, y, z, w) in zip((handle.turn_times / delta).tolist(), handle.turns.tolist(), strict=True):
            turn.Set(Gf.Quatd(w, x, y, z), round(code))


def samples(handle: Handle, delta: float) -> tuple[Array, Array]:
    """Time codes (S,) and places (S, 3) that straight lines join; where the scene holds its keys, each place stands a
    second time just before the next one.
    """
    codes = handle.times / delta
    codes = np.where(np.abs(codes - np.round(codes)) < 1e-6, np.round(codes), codes)
    if not handle.holds:
        return codes, handle.places
    ends = np.concatenate([codes, codes[1:] - JUST_BEFORE])
    places = np.concatenate([handle.places, handle.places[:-1]])
    order = np.argsort(ends, kind="stable")
    return ends[order], places[order]
