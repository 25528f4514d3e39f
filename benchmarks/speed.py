"""Print how fast this program is on this machine: `python benchmarks/speed.py [SCENE …]`, by default the examples.

Times are medians of many runs in one process, compiled beforehand; CG iterations are means over the steps. A step is
one time step of one cloth at tolerance 1e-5; the gradient is the cost with its exact derivative by all flagged
parameters over all frames, linear systems solved to 1e-10 as in a fit; the last column is its time over that of the
cost alone.
"""

from __future__ import annotations

import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import clothfit
from clothfit.fit import FIT_TOLERANCE, record_target
from clothfit.rollout import rollout
from clothfit.system import build

PLAYING = 1e-5
EXAMPLES = Path(__file__).parent.parent / "examples"


def median_seconds(work: Callable[[], object], runs: int = 31) -> float:
    """Median duration of `work`, after one run that does not count."""
    work()
    times = []
    for _ in range(runs):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def row(path: Path) -> str:
    """One line of the table."""
    scene = clothfit.load(path)
    steps = scene.frames - 1
    system = build(scene, 0)
    memory, _ = rollout(system, steps, PLAYING)
    step = median_seconds(lambda: rollout(system, steps, PLAYING)) / steps
    objective = clothfit.Objective(scene, record_target(scene), FIT_TOLERANCE)
    p = 1.1 * clothfit.parameters(scene)
    simulation = median_seconds(lambda: objective.cost(p), 15)
    gradient = median_seconds(lambda: objective.cost_and_gradient(p), 15)
    iterations = memory.solves[:, 0].mean()
    return (
        f"| {path.stem} | {len(system.x0)} | {1e3 * step:.3f} | {iterations:.1f} "
        f"| {len(p)} | {steps} | {1e3 * gradient:.1f} | {gradient / simulation:.1f} |"
    )


def main() -> None:
    """Print the table."""
    paths = [Path(argument) for argument in sys.argv[1:]] or sorted(EXAMPLES.glob("*.json"))
    print(f"clothfit {clothfit.__version__}, Python {platform.python_version()}, {platform.machine()}")
    columns = ("scene", "vertices", "ms per step", "CG iterations", "parameters", "steps", "ms per cost and gradient")
    print(f"| {' | '.join(columns)} | … over cost |")
    print("|---|---|---|---|---|---|---|---|")
    for path in paths:
        print(row(path), flush=True)


if __name__ == "__main__":
    main()
