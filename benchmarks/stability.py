"""Print what hard cases come to: `python benchmarks/stability.py [--only NAME] [--steps 1000] [--json]`.

Each case of `hard_cases.py` is moved by the linearised step as the format has it and by this program. A rise is the
most that the total energy gains over a frame beyond the work of the wind, relative to the energy at the start; where
that is 0, to the most that is ever in one place (`clothfit.motion.energy`). Compiled beforehand, one thread, linear
systems solved to 1e-5, as for playing. The last lines evaluate a fit's cost and gradient at the ends of its bounds.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, dataclass

import numpy as np

from clothfit.base import threads
from clothfit.base.arrays import Array
from clothfit.engine.fallbacks import NO_FALLBACKS
from clothfit.engine.rollout import Rollout, rollout
from clothfit.engine.step.states import velocity
from clothfit.engine.system import BDF2, System
from clothfit.motion import divergence
from clothfit.motion.divergence import Diverged
from clothfit.motion.energy import CONTACT, GRAVITY, WIND, balances
from clothfit.objective.objective import Objective
from hard_cases import CASES, Case, bounds_objective

TOLERANCE = 1e-5
CORNERS = 20  # of the bounds, drawn at random


@dataclass(frozen=True)
class Run:
    """What a case comes to with one kind of step."""

    steps: int
    good: int  # steps that stay finite
    where: str  # the place where it diverged, "" where it did not
    rise: float  # largest over a frame, J, beyond the work of the wind
    start: float  # energy at the start, J, without that of the weight
    scale: float  # the most that is ever in one place, J
    direct_solves: int
    clamped_steps: int
    shortened_steps: int
    early_contacts: int
    euler_steps: int
    longer_steps: int
    ms_per_step: float

    @property
    def ends(self) -> str:
        """How it ends, in a word or two."""
        return f"diverged at step {self.good + 1}, {self.where}" if self.where else "finite"


def run(systems: list[System], steps: int) -> Run:
    """Move all cloths of a case."""
    began = time.perf_counter()
    made = [rollout(system, steps, TOLERANCE) for system in systems]
    seconds = time.perf_counter() - began
    good = min(good for _, good in made)
    (bad,) = [index for index, (_, own) in enumerate(made) if own == good][:1]
    accounts = np.sum([balances(s, m.x[: good + 1]) for s, (m, _) in zip(systems, made, strict=True)], axis=0)
    accounts[:, GRAVITY] -= accounts[0, GRAVITY]
    total = accounts[:, : CONTACT + 1].sum(axis=1)
    rises = np.diff(total) - accounts[1:, WIND]
    remedies = NO_FALLBACKS
    for system, (memory, _) in zip(systems, made, strict=True):
        remedies = remedies.with_those_of(memory.part(0, good), system.method == BDF2)
    return Run(
        steps=steps,
        good=good,
        where=place(bad, made[bad][0], good) if good < steps else "",
        rise=float(rises.max(initial=0.0)),
        start=float(total[0]),
        scale=float(np.abs(accounts[:, : CONTACT + 1]).max()),
        **remedies._asdict(),
        ms_per_step=1e3 * seconds / max(good, 1),
    )


def place(index: int, memory: Rollout, good: int) -> str:
    """Where a motion diverged."""
    return f"objects[{index}], vertex {divergence.worst(memory.x[good + 1], velocity(memory, good))}"


def cells(name: str, case: Case, plain: Run, own: Run) -> list[str]:
    """A row of the table."""
    unit = own.start or own.scale or 1.0
    rises = ["–" if case.windy else f"{r.rise / unit:.1g}" if r.rise > 1e-12 * unit else "0" for r in (plain, own)]
    counts = [str(n) for n in (own.clamped_steps, own.shortened_steps, own.direct_solves)]
    ms = [f"{r.ms_per_step:.2g}" for r in (plain, own)]
    return [name, plain.ends, rises[0], ms[0], own.ends, rises[1], *counts, ms[1]]


HEAD = ["case", "plain step", "rise", "ms", "clothfit", "rise", "clamped", "shortened", "direct", "ms"]


def at_bounds() -> list[tuple[str, str]]:
    """What cost and gradient are at the ends of a fit's bounds, each with a name."""
    objective, lower, upper = bounds_objective()
    rng = np.random.default_rng(4)
    drawn = [np.where(rng.random(len(lower)) < 0.5, lower, upper) for _ in range(CORNERS)]
    one = [("all at the lower ends", [lower]), ("all at the upper ends", [upper])]
    return [(name, counted([outcome(objective, p) for p in ps])) for name, ps in [*one, ("at random ends", drawn)]]


def outcome(objective: Objective, p: Array) -> str:
    """Of cost and gradient at p (P,): finite, diverged, or wrong."""
    try:
        cost, gradient = objective.cost_and_gradient(p)
    except Diverged:
        return "diverged"
    return "finite" if np.isfinite(cost) and np.isfinite(gradient).all() else "WRONG"


def counted(outcomes: list[str]) -> str:
    """How many of each."""
    return ", ".join(f"{outcomes.count(each)} {each}" for each in sorted(set(outcomes)))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Print what hard cases come to.")
    parser.add_argument("--only", default="", metavar="NAME", help="cases whose name holds it")
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--json", action="store_true", help="one object per case instead of the table")
    given = parser.parse_args()
    with threads.single():
        table(given.only, given.steps, given.json)
        if given.only in "bounds":
            for name, found in at_bounds():
                record = {"case": f"bounds: {name}", "clothfit": found}
                print(json.dumps(record) if given.json else f"\n{name}: {found}")


def table(only: str, steps: int, as_json: bool) -> None:
    """Print a row for each case whose name holds a text."""
    run(CASES["one spring"].systems(), 2)
    if not as_json:
        print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
    for name, case in CASES.items():
        if only in name:
            systems = case.systems()
            plain, own = (run(each, steps) for each in ([s._replace(guarded=False) for s in systems], systems))
            record = {"case": name, "plain": asdict(plain), "clothfit": asdict(own)}
            print(json.dumps(record) if as_json else f"| {' | '.join(cells(name, case, plain, own))} |", flush=True)


if __name__ == "__main__":
    main()
