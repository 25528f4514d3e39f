"""The last motions of an objective: a descent that has measured the cost at a point asks for its derivatives next, and
whoever looks at the result asks for its motion again and again.

Only motions whose states all fit into little memory are kept; others are simulated anew.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from clothfit.base.arrays import Array
from clothfit.derivative.adjoint import Observer
from clothfit.engine.rollout import state_bytes
from clothfit.engine.snapshots import Plan
from clothfit.engine.system import System
from clothfit.engine.tape import Tape
from clothfit.objective.run import Run, shown

KEPT = 2
"""Motions of each run: that of a trial and that of the point it is compared with."""

BYTES, SHARE = 16_000_000, 0.05
"""Of all states that are kept, at most, and of the memory that the objective may use."""


class Recent:
    """The motions that were simulated last, of one objective."""

    def __init__(self, runs: Sequence[Run], tolerance: float, memory: float) -> None:
        """`tolerance` is that of the linear systems, relative; `memory` what the objective may use, bytes."""
        self.tolerance = tolerance
        needed = {(run.cloth, run.experiment): run.steps * state_bytes(run.system) for run in runs}
        touching = any(run.system.surface is not None for run in runs)  # what touches is not counted
        self._small = not touching and KEPT * sum(needed.values()) <= min(BYTES, SHARE * memory)
        self._kept: dict[tuple[int, int], dict[bytes, tuple[System, Tape]]] = {key: {} for key in needed}

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
            shown(run, tape, observers)
            return system, tape
        kept, key = self._kept[run.cloth, run.experiment], key_of(p)
        system, tape = kept.pop(key) if key in kept else self._begun(run, p)
        shown(run, tape, observers)
        kept[key] = system, tape
        while len(kept) > KEPT:
            del kept[next(iter(kept))]
        return system, tape

    def _begun(self, run: Run, p: Array) -> tuple[System, Tape]:
        """A tape that holds all states, and nothing yet."""
        system, steps = run.changed(p), max(run.steps, 1)
        return system, Tape(system, run.steps, self.tolerance, Plan(steps, (steps,)), run.forms)


def key_of(p: Array) -> bytes:
    """What two equal p (P,) share."""
    return np.asarray(p, float).tobytes()
