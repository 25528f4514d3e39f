"""Values over time from coarse to fine: one steady wind before that of each key.

The first frames of a motion show a steady wind and its drag in few simulations, also from still air, in which the cost
hardly depends on what the wind does later. So where all keys have the same value at the start, the wind is fitted as
one value of the whole motion first, and the keys go on from it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clothfit.base.arrays import Array
from clothfit.scene.fit_vector import bounds, parameters
from clothfit.scene.scene import Scene


def is_steady(scene: Scene) -> bool:
    """Whether keys of the wind are fitted, and all have the same value."""
    keys = scene.gusts
    return scene.mode("gusts") != "n" and len(keys) > 1 and bool((keys == keys[0]).all())


def steadied(scene: Scene) -> Scene:
    """The scene of a steady wind, which is fitted as one value in place of its keys."""
    keys = scene.gusts
    flags = {**{name: mode for name, mode in scene.fits.items() if name != "gusts"}, "wind": "G"}
    made = scene.with_values(
        [cloth.mass for cloth in scene.cloths], [cloth.stiffness for cloth in scene.cloths],
        wind=scene.wind + keys[0], gusts=np.zeros_like(keys),
    )  # fmt: skip
    return replace(made, fits=flags)


def values(scene: Scene, flags: Scene) -> Array:
    """The parameters (P,) of a scene by the flags of another one; of a scene that was `steadied` for it, the keys have
    the steady wind.
    """
    if scene.mode("gusts") != "n" or flags.mode("gusts") == "n":
        return parameters(scene, flags=flags)
    steady = scene.wind if flags.mode("wind") != "n" else flags.wind
    made = scene.with_values(
        [cloth.mass for cloth in scene.cloths], [cloth.stiffness for cloth in scene.cloths],
        wind=steady, gusts=np.broadcast_to(scene.wind - steady, scene.gusts.shape),
    )  # fmt: skip
    return np.asarray(np.clip(parameters(made, flags=flags), *bounds(flags)))
