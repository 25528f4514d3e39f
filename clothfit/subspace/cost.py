"""What a frame of a subspace costs, and what a full step does, in µs of one thread."""

from __future__ import annotations

from collections.abc import Mapping
from time import process_time

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.scene.scene import Scene
from clothfit.subspace.frames import Decoder
from clothfit.subspace.model import Part
from clothfit.subspace.play import rolled, stepper


def cost(part: Part, scene: Scene, cloth: int, steps: int) -> tuple[dict[str, float], float]:
    """The mean over so many frames from the start of a scene: of state, decoding, normals, and normals
    by regression where there is one; and of a full step.
    """
    system = build(scene, cloth, steps=steps)
    own = stepper(part, system, steps, {})
    decoder = Decoder(system.x0, part.basis, scene.cloths[cloth].triangles, part.normals)
    decoder.normals(decoder.positions(np.zeros(own.r)))
    rolled(own, 1, scene.name)
    begin = process_time()
    q = rolled(own, steps, scene.name)
    spent = np.array([process_time() - begin, 0.0, 0.0])
    for each in q[1:]:
        times = [process_time()]
        x = decoder.positions(each)
        times.append(process_time())
        decoder.normals(x)
        spent[1:] += np.diff([*times, process_time()])
    rollout(system, min(steps, 2), scene.tolerance)  # compiled, and its memory touched
    begin = process_time()
    rollout(system, steps, scene.tolerance)
    whole = process_time() - begin
    names = ("state", "decode", "normals")
    found = dict(zip(names, (1e6 / steps * spent).tolist(), strict=True))
    return found | regression(decoder, np.zeros(own.r), steps), 1e6 / steps * whole


def whole(us: Mapping[str, float]) -> float:
    """The µs of a frame: its state, positions and the cheaper of the normals."""
    cheaper = min(us[name] for name in ("normals", "regression") if name in us)
    return us["state"] + us["decode"] + cheaper


def regression(decoder: Decoder, q: Array, steps: int) -> dict[str, float]:
    """The time of normals by regression; nothing where there is none."""
    if decoder.regression is None:
        return {}
    decoder.predicted(q)
    begin = process_time()
    for _ in range(steps):
        decoder.predicted(q)
    return {"regression": 1e6 / steps * (process_time() - begin)}
