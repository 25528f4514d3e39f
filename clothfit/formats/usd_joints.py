"""A joint of a skeleton in a USD file: `python -m clothfit.formats.usd_joints FILE ARRAYS NAME JOINT`.

A process of its own reads it, for the reasons that `usd_reader` gives. A joint's name is its path below the skeleton,
such as hips/leg, or the last part of it.
"""

from __future__ import annotations

import json
import os
import sys
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.formats.axes import Axes
from clothfit.formats.joints import absent, sampled
from clothfit.formats.usd_reader import OPENING_BYTES, OPENING_RATIO, alone, limit_memory, units


def joint(path: str, name: str, wanted: str) -> tuple[Array, Array, Axes]:
    """Times (K,), s, from the start of the stage, and matrices (K, 4, 4) of a joint, in the file's axes. Raises
    InvalidMotion.
    """
    from pxr import Sdf, Usd, UsdGeom, UsdSkel

    layer = Sdf.Layer.OpenAsAnonymous(path)
    alone(layer)
    stage = Usd.Stage.Open(layer, Usd.Stage.LoadNone)
    cache = UsdSkel.Cache()
    names: list[str] = []
    found: list[tuple[Any, int]] = []
    for prim in stage.Traverse():
        if prim.IsA(UsdSkel.Skeleton):
            query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
            own = [str(each) for each in query.GetJointOrder()]
            names += own
            found += [(query, k) for k, each in enumerate(own) if wanted in (each, each.rpartition("/")[2])]
    if len(found) != 1:
        raise InvalidMotion(absent(name, wanted, len(found), list(names)))
    (query, index), (axes, rate) = found[0], units(stage, True, name, [])
    animation = query.GetAnimQuery()
    codes = np.array(animation.GetJointTransformTimeSamples() if animation else [], float)
    begin = stage.GetStartTimeCode() if stage.HasAuthoredTimeCodeRange() or not len(codes) else codes.min()
    times = sampled(np.unique(codes - begin) / rate) if len(codes) else np.zeros(1)
    matrices = np.empty((len(times), 4, 4))
    for k, time in enumerate(times):
        place = UsdGeom.XformCache(Usd.TimeCode(float(begin + time * rate)))
        matrices[k] = np.array(query.ComputeJointWorldTransforms(place)[index]).T  # USD multiplies rows
    return times, matrices, axes


def main(path: str, arrays: str, name: str, wanted: str) -> int:
    """Read a joint into an `.npz`; returns 3, with the reason on standard output, when that fails."""
    from pxr import Usd, UsdSkel  # noqa: F401  they take some hundred MB of addresses before they read anything

    limit_memory(OPENING_BYTES + OPENING_RATIO * os.path.getsize(path))
    try:
        times, matrices, axes = joint(path, name, wanted)
    except InvalidMotion as error:
        print(json.dumps(str(error)))
        return 3
    np.savez(arrays, times=times, matrices=matrices, axes=np.array([*map(str, axes)]))
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
