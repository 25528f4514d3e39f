"""USD: an Xform for each handle of a scene, with samples of its place, and of its turn, over time.

A time code is a time step. Text (.usda), with all digits of a place. Samples are joined by straight lines; where the
scene holds its keys, each place stands a second time just before the next one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.export.handles import Handle, handles
from clothfit.scene.scene import Scene

if TYPE_CHECKING:
    from pxr import Usd

JUST_BEFORE = 1e-6
"""Time codes between the end of a place that is held and the next one."""


def files(scene: Scene) -> dict[str, bytes]:
    """One file. Raises InvalidInput where the library is not installed."""
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
    """Time codes (S,) and places (S, 3) that straight lines join."""
    codes = handle.times / delta
    codes = np.where(np.abs(codes - np.round(codes)) < 1e-6, np.round(codes), codes)
    if not handle.holds:
        return codes, handle.places
    ends = np.concatenate([codes, codes[1:] - JUST_BEFORE])
    places = np.concatenate([handle.places, handle.places[:-1]])
    order = np.argsort(ends, kind="stable")
    return ends[order], places[order]
