"""Nudging: springs pull each vertex of a motion to where it was seen, weaker and weaker.

A motion that forgets where it began, as in wind, has a cost with many minima; one that is held near its target has few.
With springs of m ω² a motion follows what it is shown within about 1 / ω, and what is left is what the model does wrong
in that time:

    m a = f(x, v; p) + m ω² (y − x),    Σ |x − y|² → min.

With a large ω that is the balance of momentum from frame to frame, and with ω = 0 the whole motion; the values that one
pull finds start the next, weaker one. States where windows would begin are estimated on the way: what is not seen is
not pulled, and moves as the model moves it. Weak-constraint 4D-Var balances the same, with the forces as unknowns
(Y. Trémolet, Accounting for an imperfect model in 4D-Var, 2006); for models that are pulled while their values are
fitted see H. D. I. Abarbanel et al., Dynamical state and parameter estimation, 2009.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array
from clothfit.motion.motion import Motion
from clothfit.motion.times import frame_places
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.over_time.forces import STRONGEST, Forces
from clothfit.scene.scene import Scene
from clothfit.strategy.first_windows import some_steps

PULLS = (3.0, 1.0, 0.3, 0.1, 0.03)
"""ω, in radians per frame of the target, one after the other."""

STEPS, EACH = 6, 2
"""Steps of Gauss–Newton with each of them; which of the values that they find start a fit, every so many."""

TOLERANCE = 1e-7
"""Of the linear systems: its error is far below what is left of a nudged motion."""


def through_pulls(own: Search) -> list[Array]:
    """Steps of Gauss–Newton on nudged motions, and then on those of the model alone; returns the values (P,) that
    each pull has found. Raises Stop.
    """
    y, found = own.y, list[Array]()
    for pull in PULLS:
        part = Trajectory(own, nudged(own.objective, pull))
        own.enter("nudging", part.objective)
        if own.is_late:
            break
        if not np.isfinite(part.cost(y)):  # explicit steps are unstable with the stiffest springs
            continue
        y = some_steps(part, y, STEPS)
        found.append(own.parameters(y))
        own.visit(found[-1])
    if found and not own.is_late:
        own.enter("nudging")
        own.visit(own.parameters(some_steps(Trajectory(own, own.objective), y, STEPS)))
    return found


def can_nudge(objective: Objective) -> bool:
    """Whether motions can be nudged: by positions, in scenes without forces of their own."""
    return list(objective.weights) == ["position"] and all(scene.forces is None for _, scene in objective.experiments)


def nudged(objective: Objective, pull: float) -> Objective:
    """The objective of motions with a pull, in radians per frame."""
    given = [Experiment(motion, pulled(scene, motion, pull)) for motion, scene in objective.experiments]
    return objective.in_scenes(given, max(TOLERANCE, objective.tolerance))


def pulled(scene: Scene, motion: Motion, pull: float) -> Scene:
    """A scene whose vertices are pulled to where a motion shows them, with springs of the masses that it has; between
    frames to places on the line from one to the next, unless all frames are at ends of steps.
    """
    step, part = frame_places(motion, scene.delta)
    at, seen, aligned = step + part, motion.seen(), not part.any()
    gap = max(float(np.median(np.diff(at))), 1.0) if len(at) > 1 else 1.0
    mass = np.concatenate([cloth.mass for cloth in scene.cloths])
    per_step = gap if aligned else 1.0  # the same impulse for each frame
    stiffness = np.minimum(per_step * mass * (pull / (gap * scene.delta)) ** 2, STRONGEST)
    count = max(int(at[-1]), 1)
    places = np.tile(np.concatenate([cloth.positions for cloth in scene.cloths]), (count, 1, 1)).astype(float)
    gain = np.zeros(places.shape[:2])
    for row in range(count):
        later = int(np.searchsorted(at, row + 1))
        if later == len(at):
            break
        if at[later] == row + 1:
            shown, place = seen[later], motion.positions[later]
        elif later and not aligned:
            share = (row + 1 - at[later - 1]) / (at[later] - at[later - 1])
            shown = seen[later] & seen[later - 1]
            place = (1.0 - share) * motion.positions[later - 1] + share * motion.positions[later]
        else:
            continue
        places[row, shown], gain[row, shown] = place[shown], stiffness[shown]
    times = scene.delta * np.arange(count, dtype=float)
    return scene.with_forces(Forces(times, np.zeros(places.shape), gain, places, pulls=True))
