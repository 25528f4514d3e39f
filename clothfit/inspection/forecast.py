"""What a scene will ask of who simulates or fits it, before that is done: how short steps must be, how much memory."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from clothfit.engine.rollout import state_bytes
from clothfit.engine.stability import frequency, limit
from clothfit.engine.system import IMPLICIT, build
from clothfit.objective import memory_needs as storage
from clothfit.scene.fit_vector import fitted_cloths
from clothfit.scene.scene import INTEGRATORS, Scene


@dataclass(frozen=True)
class Steps:
    """How an integrator would fare with a scene."""

    integrator: str
    limit: float  # longest stable step at the start, s: infinite where all are, 0 where none is
    stable: bool  # whether the scene's delta is within it


@dataclass(frozen=True)
class Forecast:
    """What a scene will ask for."""

    steps: tuple[Steps, ...]  # of each integrator: the limit of the object which bears least
    motion: int  # bytes that the positions of all frames take, in memory and in a file
    fit: int | None  # bytes that a fit takes in all, as `fit_bytes` counts them; None where nothing is flagged


def forecast(scene: Scene) -> Forecast:
    """Look ahead."""
    least, state = dict.fromkeys(range(len(INTEGRATORS)), inf), []
    for index in range(len(scene.cloths)):
        system = build(scene, index)
        state.append(state_bytes(system))
        with np.errstate(all="ignore"):  # of values at the ends of the range of doubles
            omega = frequency(system)
        for method in set(least) - {IMPLICIT}:
            least[method] = min(least[method], limit(system._replace(method=method), omega).step)
    steps = tuple(Steps(name, least[i], scene.delta <= least[i]) for i, name in enumerate(INTEGRATORS))
    return Forecast(steps, motion_bytes(scene), fit_bytes(scene, state))


def motion_bytes(scene: Scene) -> int:
    """What the positions of all frames take."""
    return scene.frames * sum(scene.vertex_counts) * 24


def fit_bytes(scene: Scene, state: list[int]) -> int | None:
    """What a fit takes in all, with every state kept, of `state` bytes of each object, to a target of all vertices
    after every step; None where nothing is flagged. With less it takes longer (`clothfit.base.memory`).
    """
    cloths = fitted_cloths(scene)
    if not cloths:
        return None
    work = sum(storage.WORK * scene.vertex_counts[index] for index in cloths)
    return motion_bytes(scene) + work + (scene.frames - 1) * max(state[index] for index in cloths)
