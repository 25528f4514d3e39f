"""What a frame of a subspace costs, and what a full step does, in µs of one thread."""

from __future__ import annotations

from time import process_time

import numpy as np

from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.scene.scene import Scene
from clothfit.subspace.frames import Decoder
from clothfit.subspace.model import Part, reduced


def cost(part: Part, scene: Scene, cloth: int, steps: int) -> tuple[dict[str, float], float]:
    """The mean over so many frames from the start of a scene: of state, decoding and normals, and of a full step."""
    system = build(scene, cloth, steps=steps)
    own = reduced(part, system)
    decoder = Decoder(system.x0, part.basis, scene.cloths[cloth].triangles)
    decoder.normals(decoder.positions(np.zeros(own.r)))
    state, spent = own.start(), np.zeros(3)
    own.advance(state)
    for _ in range(steps):
        times = [process_time()]
        state, _ = own.advance(state)
        times.append(process_time())
        x = decoder.positions(state.q)
        times.append(process_time())
        decoder.normals(x)
        spent += np.diff([*times, process_time()])
    rollout(system, min(steps, 2), scene.tolerance)  # compiled, and its memory touched
    begin = process_time()
    rollout(system, steps, scene.tolerance)
    whole = process_time() - begin
    names = ("state", "decode", "normals")
    return dict(zip(names, (1e6 / steps * spent).tolist(), strict=True)), 1e6 / steps * whole
