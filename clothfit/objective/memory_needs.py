"""What the runs of an objective keep in memory, and how that fits into a budget."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from clothfit.base.errors import InvalidInput
from clothfit.base.memory import human
from clothfit.engine import tape
from clothfit.engine.rollout import state_bytes
from clothfit.engine.step import implicit
from clothfit.engine.system import BDF2, System
from clothfit.engine.tape import Plan
from clothfit.motion.motion import Motion
from clothfit.objective.run import Run
from clothfit.objective.running_cost import running_cost

WORK = 3000
"""Bytes per vertex of a cloth's arrays, its matrix and the vectors of a sweep, roughly."""

DIRECT = 20_000
"""Bytes per vertex that a direct solve takes for a moment (`linear`), on cloths of some thousand vertices."""

COUNTED = 0.85
"""Part of a budget that a plan may use where not every state fits; the rest is for vectors of the parameters,
libraries and text, which are not counted.
"""


class Needs(NamedTuple):
    """The memory of a gradient, in bytes."""

    held: int  # kept beside the states: the targets, and the arrays of the cost
    predicted: int  # in all, if every state is kept
    budget: int  # that a fit may use
    plans: dict[tuple[tuple[int, ...], int], Plan]  # by shape of the state and number of steps

    @property
    def snapshots(self) -> int | None:
        """How many states are kept of the motion that needs most; None: every one."""
        return max((plan.snapshots for plan in self.plans.values() if plan.snapshots), default=None)

    def summary(self) -> dict[str, int | None]:
        """The numbers for JSON summaries."""
        return {"foreseen": self.predicted, "budget": self.budget, "snapshots": self.snapshots}

    def __str__(self) -> str:
        text = f"foreseen: {human(self.predicted)} of memory; budget {human(self.budget)}"
        if self.snapshots is None:
            return text
        length = max(plan.length for plan in self.plans.values() if plan.snapshots)
        return f"{text}: keeps 1 state in {length} and computes the others again"


def needs(runs: Sequence[Run], targets: Sequence[Motion], budget: int) -> Needs:
    """What a gradient of these runs needs, one of which is simulated at a time. Raises InvalidInput when the budget is
    too small for any plan.
    """
    held = sum(motion_bytes(motion) for motion in targets) + sum(run_bytes(run, targets) for run in runs)
    most, plans = 0, {}
    for run in runs:
        steps, state, snapshot = run.steps, state_bytes(run.system), snapshot_bytes(run.system)
        most = max(most, steps * state)
        found = tape.plan_for(steps, state, snapshot, budget - held)
        if found is None or found.snapshots is not None:
            room = COUNTED * budget - held - DIRECT * len(run.system.x0)
            found = tape.plan_for(steps, state, snapshot, max(room, tape.least_bytes(steps, state, snapshot))) or found
            if found is not None and held + tape.plan_bytes(found, state, snapshot) > budget:
                found = None
        if found is None:
            least = held + tape.least_bytes(steps, state, snapshot)
            raise InvalidInput(too_little(budget, held, steps, len(run.system.x0), least))
        plans[run.system.x0.shape, steps] = found
    return Needs(held, held + most, budget, plans)


def check_own(systems: Sequence[System], frames: int, budget: int) -> None:
    """Raise InvalidInput where the budget is too small for a fit to the systems' own motion of so many frames, before
    that is simulated. A bound from below: `needs` knows more.
    """
    held, steps = sum(frames * system.x0.nbytes for system in systems), frames - 1
    for system in systems:
        least = held + tape.least_bytes(steps, state_bytes(system), snapshot_bytes(system))
        if least > budget:
            raise InvalidInput(too_little(budget, held, steps, len(system.x0), least))


def too_little(budget: int, held: int, steps: int, vertices: int, least: int) -> str:
    """The sentence that refuses a budget."""
    return (
        f"memory: {human(budget)} is too little: the targets take {human(held)}, and a fit of {steps} steps of "
        f"{vertices} vertices needs {human(least)} in all"
    )


def snapshot_bytes(system: System) -> int:
    """Bytes of a snapshot: position and velocity, of BDF2 of two steps, and what the first guesses are made of."""
    past = implicit.workspace(system).past
    return (4 if system.method == BDF2 else 2) * system.x0.nbytes + sum(np.asarray(field).nbytes for field in past)


def motion_bytes(motion: Motion) -> int:
    """Bytes of the arrays of a target."""
    arrays = (motion.positions, motion.observed, motion.weights, *motion.correspondence[3:6])
    return sum(array.nbytes for array in arrays if array is not None)


def run_bytes(run: Run, targets: Sequence[Motion]) -> int:
    """Bytes of a run: its own copies of the target, and what it works with beside the states."""
    goal, motion = run.comparison.goal, targets[run.experiment]
    given = [array for array in (motion.positions, motion.observed, motion.weights) if array is not None]
    used = (goal.positions, goal.observed, goal.weights)
    own = sum(a.nbytes for a in used if not any(np.may_share_memory(a, b) for b in given))
    return own + running_cost(run.comparison).bytes + WORK * len(run.system.x0)
