"""What a frame of a subspace costs, and what a full step does, in µs of one thread."""

from __future__ import annotations

from time import process_time

import numpy as np

from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.scene.scene import Scene
from clothfit.subspace.frames import Decoder
from clothfit.subspace.model import Part
from clothfit.subspace.play import rolled, stepper


def cost(part: Part, scene: Scene, cloth: int, steps: int) -> tuple[dict[str, float], float]:
    """The mean over so many frames from the start of a scene: of state, decoding and normals, and of a full step."""
    system = build(scene, cloth, steps=steps)
    own = stepper(part, system, steps, {})
    decoder = Decoder(system.x0, part.basis, scene.cloths[cloth].triangles)
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
    return dict(zip(names, (1e6 / steps * spent).tolist(), strict=True)), 1e6 / steps * whole
