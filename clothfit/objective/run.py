"""One cloth in one experiment: what an objective simulates for each p, in the sight of what tells its cost."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from clothfit.base.arrays import Array, Flags
from clothfit.engine.rollout import Rollout, empty, rollout
from clothfit.engine.snapshots import Plan
from clothfit.engine.system import System, with_elements
from clothfit.engine.tape import Tape
from clothfit.motion.divergence import Diverged
from clothfit.objective.comparison import Comparison
from clothfit.objective.running_cost import Tally, tally
from clothfit.scene.fit_vector import elements
from clothfit.scene.scene import Scene

PART = 16
"""Steps that `still` looks at together."""


class Run(NamedTuple):
    """One cloth in one experiment: what is simulated once for each p."""

    cloth: int
    scene: Scene  # the experiment's, with the flags of the fitted one
    system: System  # with the values of `scene`
    comparison: Comparison
    experiment: int  # counted from 0

    @property
    def steps(self) -> int:
        """Number of steps that are simulated."""
        return self.comparison.last_step

    def changed(self, p: Array) -> System:
        """The system with what is flagged from p (P,), the rest the experiment's own."""
        return with_elements(self.system, elements(self.scene, self.cloth, p))


def tell(run: Run, p: Array, tolerance: float, told: Iterable[Tally], plan: Plan | None) -> tuple[System, Tape]:
    """Simulate a run with parameters p (P,), as far as it is compared, in the sight of some tallies.

    With a `plan` the motion can be swept back. Raises Diverged.
    """
    system = run.changed(p)
    tape = Tape(system, run.steps, tolerance, plan)
    for part in tape.forward():
        for each in told:
            each.see(part)
    check(run, tape.good)
    return system, tape


def roll(run: Run, p: Array, tolerance: float) -> tuple[System, Rollout]:
    """The same with all states kept, and nothing told. Raises Diverged."""
    system = run.changed(p)
    memory, good = rollout(system, run.steps, tolerance)
    check(run, good)
    return system, memory


def check(run: Run, good: int) -> None:
    """Raise Diverged unless all steps are good."""
    if good < run.steps:
        step, t = good + 1, (good + 1) * run.scene.delta
        message = (
            f"{run.scene.name}: objects[{run.cloth}] diverged at step {step} (t = {t:.4g} s); try a smaller delta"
        )
        raise Diverged(message, step)


def still(run: Run) -> float:
    """G of a run in which nothing moves."""
    told, x, steps = tally(run.comparison), run.system.x0, run.steps
    rest = empty(run.system, min(PART, steps))
    rest.x[:] = x
    for first in range(0, steps or 1, PART):
        told.see(rest.part(0, min(PART, steps - first))._replace(first=first))
    return told.value


def seen_in(runs: Iterable[Run]) -> dict[int, Flags]:
    """Of each cloth, which vertices (n,) are compared in one of the runs at some time after the initial state."""
    seen: dict[int, Flags] = {}
    for run in runs:
        seen[run.cloth] = seen.get(run.cloth, False) | run.comparison.seen
    return seen
