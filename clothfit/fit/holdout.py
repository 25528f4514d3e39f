"""Keep a part of the targets out of a fit, to see how well the fit predicts it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion, at_frames
from clothfit.motion.times import frame_places
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import fitted_cloths
from clothfit.scene.scene import Scene

SEED = 0


@dataclass(frozen=True)
class HeldOut:
    """How far the fitted motion is from what was kept out of the fit."""

    of: str  # "frames" or "vertices"
    fraction: float  # that was asked for
    observations: int  # positions kept out
    rmse: float  # m, over them; inf where the fitted motion does not stay finite


def split(
    scene: Scene, given: Sequence[Experiment], fraction: float, of: str
) -> tuple[list[Experiment], list[Experiment]]:
    """The experiments of the fit, and those with only what is kept out. Raises InvalidInput where the targets show too
    little to keep something out.
    """
    if of == "frames":
        pairs = [split_frames(experiment, fraction) for experiment in given]
    else:
        chosen = choose_vertices(scene, given, fraction)
        pairs = [split_vertices(experiment, chosen) for experiment in given]
    return [fitted for fitted, _ in pairs], [kept for _, kept in pairs]


def split_frames(experiment: Experiment, fraction: float) -> tuple[Experiment, Experiment]:
    """The experiment without the last of its compared frames, and with only these."""
    motion, scene = experiment
    step, part = frame_places(motion, scene.delta)
    frames = int(np.searchsorted(step + part, scene.frames - 1, side="right"))
    if frames < 3:
        raise InvalidInput(f"{motion.name}: shows {frames} frames, too few to keep some of them out of the fit")
    first = frames - min(max(round(fraction * frames), 1), frames - 2)
    late = np.zeros(seen(motion).shape, bool)
    late[first:frames] = True
    early, rest = at_frames(motion, slice(first)), replace(motion, observed=seen(motion) & late)
    return Experiment(early, scene), Experiment(rest, scene)


def choose_vertices(scene: Scene, given: Sequence[Experiment], fraction: float) -> Flags:
    """Draw the vertices of all objects (vertices,) to keep out; at least one of each fitted object stays in."""
    generator = np.random.default_rng(SEED)
    shown = np.any([moving(experiment) for experiment in given], axis=0)
    owner = np.repeat(np.arange(len(scene.cloths)), scene.vertex_counts)
    chosen = np.zeros(len(owner), bool)
    for cloth in fitted_cloths(scene):
        own = np.flatnonzero(shown & (owner == cloth))
        if len(own) > 1:
            count = min(max(round(fraction * len(own)), 1), len(own) - 1)
            chosen[generator.choice(own, count, replace=False)] = True
    if not chosen.any():
        raise InvalidInput(f"{given[0].motion.name}: shows too few vertices to keep some of them out of the fit")
    return chosen


def moving(experiment: Experiment) -> Flags:
    """Which vertices (vertices,) are free, and observed at some time after the initial state."""
    motion, scene = experiment
    free = ~np.concatenate([cloth.fixed for cloth in scene.cloths])
    return np.asarray(free & seen(motion)[motion.times > 0].any(axis=0))


def split_vertices(experiment: Experiment, chosen: Flags) -> tuple[Experiment, Experiment]:
    """The experiment without the chosen vertices (vertices,), and with only these."""
    motion, scene = experiment
    parts = (replace(motion, observed=seen(motion) & part) for part in (~chosen, chosen))
    fitted, kept = (Experiment(part, scene) for part in parts)
    return fitted, kept


def seen(motion: Motion) -> Flags:
    """Which positions (frames, vertices) count in a comparison."""
    return motion.seen() if motion.weights is None else motion.seen() & (motion.weights > 0)


def held_out(objective: Objective, p: Array, of: str, fraction: float) -> HeldOut:
    """How far the motion of parameters p (P,) is from the objective of what was kept out."""
    try:
        rmse = objective.position_rmse(p)
    except Diverged:
        rmse = np.inf
    return HeldOut(of, fraction, objective.observations, rmse)
