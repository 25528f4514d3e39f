"""One cloth in one experiment: what an objective simulates for each p, observed by its cost.

The last motions of an objective: a descent that has measured the cost at a point asks for its derivatives next, and
whoever looks at the result asks for its motion again and again.

Only motions whose states all fit into little memory are kept; others are simulated anew.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.derivative.adjoint import Observer
from clothfit.engine.fallbacks import Fallbacks
from clothfit.engine.inputs.sampling import Axes, axes
from clothfit.engine.prescribed import Forms
from clothfit.engine.rollout import empty, state_bytes
from clothfit.engine.stability import NO_REST
from clothfit.engine.step.implicit import Workspace, workspace
from clothfit.engine.system import System, meets_itself, mobile, rests, with_elements
from clothfit.engine.tape import Plan, Tape
from clothfit.motion.divergence import Diverged
from clothfit.objective.comparison import Comparison
from clothfit.objective.measures import Cloud
from clothfit.objective.running_cost import running_cost
from clothfit.scene.block import Block
from clothfit.scene.fit_vector import acting, elements
from clothfit.scene.kinds import REST
from clothfit.scene.scene import Scene

REST_STEPS = 16
"""Steps that `at_rest` shows together."""


class Run(NamedTuple):
    """One cloth in one experiment: what is simulated once for each p."""

    cloth: int  # the first of those that are simulated together
    scene: Scene  # the experiment's, with the flags of the fitted one
    system: System  # with the values of `scene`
    comparison: Comparison
    experiment: int  # counted from 0
    forms: Forms | None = None  # of the steps, where they are given

    @property
    def steps(self) -> int:
        """Number of steps that are simulated."""
        return self.comparison.last_step

    @property
    def acting(self) -> list[tuple[Block, slice]]:
        """The blocks that act in it, each with the places of its values."""
        return acting(self.scene, self.cloth)

    @property
    def axes(self) -> Axes | None:
        """The axes of the scene after each step, where they move."""
        times = self.scene.delta * np.arange(self.steps + 1, dtype=float)
        return axes(self.scene.frame, times) if self.scene.frame else None

    def changed(self, p: Array) -> System:
        """The system with the flagged values from p (P,) and all others of the experiment."""
        return with_elements(self.system, elements(self.scene, self.cloth, p))


def play(run: Run, tape: Tape, observers: Iterable[Observer]) -> None:
    """Show the motion of a tape, as far as the run is compared, to the observers. Raises Diverged."""
    for chunk in tape.forward():
        for observe in observers:
            observe(chunk)
    check_complete(run, tape.good)


def check_complete(run: Run, good: int) -> None:
    """Raise Diverged unless all steps of the run are good; `good` is the number of those that are."""
    if good < run.steps:
        step = good + 1
        if run.scene.method == REST:
            raise Diverged(f"{run.scene.name}: objects[{run.cloth}]: {NO_REST}", step)
        place = f"objects[{run.cloth}] diverged at step {step} (t = {step * run.scene.delta:.4g} s)"
        raise Diverged(f"{run.scene.name}: {place}; try a smaller delta", step)


def at_rest(run: Run, observe: Observer) -> None:
    """Show an observer a motion in which nothing moves, but with the axes of the scene."""
    rest = empty(run.system, min(REST_STEPS, run.steps))
    rest.x[:] = run.system.x0
    for first in range(0, run.steps or 1, REST_STEPS):
        if run.scene.frame:
            times = run.scene.delta * np.arange(first, first + len(rest.x), dtype=float)
            rest.x[:] = axes(run.scene.frame, times).world(run.system.x0[None])
        observe(rest.part(0, min(REST_STEPS, run.steps - first))._replace(first=first))


def cost_at_rest(run: Run) -> float:
    """G of a run in which nothing moves."""
    cost = running_cost(run.comparison)
    at_rest(run, cost.update)
    return cost.value


def residual_count(run: Run) -> int:
    """Number of residuals of a run that a parameter can change: not of the initial state or of fixed vertices."""
    return running_cost(run.comparison).squares(mobile(run.system), partial(at_rest, run))[1]


def seen_in(runs: Iterable[Run]) -> dict[int, Flags]:
    """For each cloth, the vertices (n,) that one of the runs compares at some time after the initial state."""
    seen: dict[int, Flags] = {}
    for run in runs:
        cloths = run.scene.together(run.cloth)
        ends = np.cumsum([run.scene.vertex_counts[i] for i in cloths])
        for cloth, own in zip(cloths, np.split(run.comparison.seen, ends[:-1]), strict=True):
            seen[cloth] = seen.get(cloth, False) | own
    return seen


KEPT = 2
"""Motions of each run: that of a trial and that of the point it is compared with."""

ALIKE = 0.01
"""Relative difference of values up to which the shape at rest of the one is near that of the other."""

BYTES, SHARE = 64_000_000, 0.05
"""Of all states that are kept, at most, and of the memory that the objective may use."""


class Recent:
    """The motions that were simulated last, of one objective."""

    def __init__(self, runs: Sequence[Run], tolerance: float, memory: float) -> None:
        """`tolerance` is that of the linear systems, relative; `memory` what the objective may use, bytes."""
        self.tolerance = tolerance
        needed = {(run.cloth, run.experiment): run.steps * state_bytes(run.system) for run in runs}
        touching = any(meets_itself(run.system) for run in runs)  # what touches is not counted
        self._small = not touching and KEPT * sum(needed.values()) <= min(BYTES, SHARE * memory)
        self._kept: dict[tuple[int, int], dict[bytes, tuple[System, Tape]]] = {key: {} for key in needed}
        self._work: dict[tuple[int, int], Workspace] = {}
        # of the motions that are too large to be kept
        self._fallbacks: dict[tuple[int, int], tuple[bytes, Fallbacks]] = {}
        # of cloths at rest (n, 3) m, where a search begins: the first, and where shadows are compared those that are
        # found, with their p
        self._first = {(run.cloth, run.experiment): first_shape(run) for run in runs if rests(run.system)}
        self._found: dict[tuple[int, int], list[tuple[Array, Array]]] = {key: [] for key in self._first}

    def has(self, run: Run, p: Array) -> bool:
        """Whether the motion of p (P,) is kept."""
        return key_of(p) in self._kept[run.cloth, run.experiment]

    def simulate(self, run: Run, p: Array, observers: Iterable[Observer], plan: Plan | None) -> tuple[System, Tape]:
        """The motion of a run with parameters p (P,), as far as it is compared, shown to the observers; with a `plan`
        it can be swept back. Raises Diverged.
        """
        if not self._small or (plan is not None and plan.snapshots is not None):
            system = run.changed(p)
            tape = Tape(system, run.steps, self.tolerance, plan, run.forms)
            play(run, tape, observers)
            self._fallbacks[run.cloth, run.experiment] = key_of(p), tape.fallbacks
            return system, tape
        kept, key = self._kept[run.cloth, run.experiment], key_of(p)
        if key not in kept:  # a tape that holds all states, and nothing yet
            system, steps = run.changed(p), max(run.steps, 1)
            if rests(system):
                system = system._replace(x0=self.rest_guess(run, p))
            place = run.cloth, run.experiment
            work = self._work[place] = self._work.get(place) or workspace(system)
            kept[key] = system, Tape(system, run.steps, self.tolerance, Plan(steps, (steps,)), run.forms, work)
        system, tape = kept.pop(key)
        play(run, tape, observers)
        if rests(system) and "position" not in run.comparison.scales:
            self._found[run.cloth, run.experiment].append((np.array(p), tape.shape))
        kept[key] = system, tape
        while len(kept) > KEPT:
            del kept[next(iter(kept))]
        return system, tape

    def fallbacks(self, run: Run, p: Array) -> Fallbacks:
        """The fallbacks of the steps of a run with parameters p (P,). Raises Diverged."""
        key, found = self._fallbacks.get((run.cloth, run.experiment), (b"", None))
        return found if found is not None and key == key_of(p) else self.simulate(run, p, (), None)[1].fallbacks

    def rest_guess(self, run: Run, p: Array) -> Array:
        """Where the search for the shape at rest at p (P,) begins: that found for the nearest p, unless it is far."""
        found = self._found[run.cloth, run.experiment]
        away = [float((np.abs(p - other) / np.maximum(np.abs(other), 1e-300)).max(initial=0.0)) for other, _ in found]
        least = int(np.argmin(away)) if found else 0
        if found and away[least] < ALIKE:
            return found[least][1]
        return self._first[run.cloth, run.experiment]

    def begin_at(self, run: Run, p: Array) -> None:
        """Let searches for shapes at rest begin at that of p (P,), as it is found first of all, from now on."""
        key = run.cloth, run.experiment
        self._first[key], self._found[key], self._kept[key] = first_shape(run), [], {}
        self._first[key] = self.simulate(run, p, (), None)[1].shape


def first_shape(run: Run) -> Array:
    """Where the search for the shape of a cloth at rest begins (n, 3), m: the target, where that shows all vertices, or
    where it was drawn to a scan, so that the folds are the same; else the start.
    """
    x0, goal = run.system.x0, run.comparison.goal
    drawn = isinstance(run.comparison.surface, Cloud) and np.isfinite(goal.positions[-1:]).all()
    whole = goal.observed[-1:].any() and goal.observed[-1].all()
    if "position" not in run.comparison.scales or not (drawn or whole):
        return x0
    return np.where(run.system.vertex.free[:, None], goal.positions[-1], x0)


def key_of(p: Array) -> bytes:
    """What two equal p (P,) share."""
    return np.asarray(p, float).tobytes()
