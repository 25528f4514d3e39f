"""What simulating or fitting a scene will need: how short its steps must be, and how much memory it takes."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from clothfit.engine.rollout import state_bytes
from clothfit.engine.stability import UNLIMITED, frequency, limit
from clothfit.engine.system import build
from clothfit.objective import memory_needs as storage
from clothfit.scene.fit_vector import fitted_cloths
from clothfit.scene.kinds import INTEGRATORS
from clothfit.scene.scene import Scene


@dataclass(frozen=True)
class Steps:
    """The longest stable step of an integrator."""

    integrator: str
    limit: float  # longest stable step at the start, s; infinite where all steps are stable, 0 where none is
    stable: bool  # whether the scene's delta is stable


@dataclass(frozen=True)
class Forecast:
    """What a scene will need."""

    steps: tuple[Steps, ...]  # of each integrator; the limit is that of the object with the shortest
    motion: int  # bytes of the positions of all frames, in memory and in a file
    fit: int | None  # bytes that a fit needs in all, see `fit_bytes`; None where nothing is flagged


def forecast(scene: Scene) -> Forecast:
    """Predict stable steps and memory of a scene."""
    least, state = dict.fromkeys(range(len(INTEGRATORS)), inf), []
    for index in range(len(scene.cloths)):
        system = build(scene, index)
        state.append(state_bytes(system))
        with np.errstate(all="ignore"):  # of values at the ends of the range of doubles
            omega = frequency(system)
        for method in set(least) - set(UNLIMITED):
            least[method] = min(least[method], limit(system._replace(method=method), omega).step)
    steps = tuple(Steps(name, least[i], scene.delta <= least[i]) for i, name in enumerate(INTEGRATORS))
    return Forecast(steps, motion_bytes(scene), fit_bytes(scene, state))


def motion_bytes(scene: Scene) -> int:
    """Bytes of the positions of all frames."""
    return scene.frames * sum(scene.vertex_counts) * 24


def fit_bytes(scene: Scene, state: list[int]) -> int | None:
    """Bytes that a fit needs in all if it keeps every state; None where nothing is flagged.

    `state` has the bytes of a state of each object. The target has all vertices after every step. With less memory a
    fit takes longer (`clothfit.base.memory`).
    """
    cloths = fitted_cloths(scene)
    if not cloths:
        return None
    work = sum(storage.WORK * scene.vertex_counts[index] for index in cloths)
    return motion_bytes(scene) + work + (scene.frames - 1) * max(state[index] for index in cloths)
