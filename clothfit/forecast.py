"""What a scene will ask of who simulates or fits it, before that is done: how short steps must be, how much memory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

from clothfit import storage
from clothfit.fit_vector import fitted_cloths
from clothfit.rollout import state_bytes
from clothfit.scene import INTEGRATORS, Scene
from clothfit.stability_limit import limit
from clothfit.system import IMPLICIT, build


@dataclass(frozen=True)
class Steps:
    """How an integrator would fare with a scene."""

    integrator: str
    limit: float  # longest stable step at the start, s: infinite where all are, 0 where none is
    stable: bool  # whether the scene's delta is within it


def steps(scene: Scene) -> list[Steps]:
    """The limit of each integrator: that of the object which bears least."""
    found = []
    for method, name in enumerate(INTEGRATORS):
        least = inf
        for index in range(len(scene.cloths)):
            least = min(least, limit(build(replace(scene, method=method), index)).step if method != IMPLICIT else inf)
        found.append(Steps(name, least, scene.delta <= least))
    return found


def motion_bytes(scene: Scene) -> int:
    """What the positions of all frames take, in memory and in a file."""
    return scene.frames * sum(scene.vertex_counts) * 24


def fit_bytes(scene: Scene) -> int | None:
    """What a fit takes in all, with every state kept, to a target of all vertices after every step; None where nothing
    is flagged. With less it takes longer (`clothfit.memory`).
    """
    cloths = fitted_cloths(scene)
    if not cloths:
        return None
    work = sum(storage.WORK * scene.vertex_counts[index] for index in cloths)
    held = motion_bytes(scene) + work
    return held + max((scene.frames - 1) * state_bytes(build(scene, index)) for index in cloths)
