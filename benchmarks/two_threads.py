"""Print what the second thread of a solve gains in a fit: `python benchmarks/two_threads.py [SIDE …]`, else 40 64 88.

Grids of SIDE² vertices (`grids.py`), of the 1,500 or more from which the rows of a solve are shared by two threads;
from 3,000 on the solves are those of multigrid. Each is fitted, one stiffness per spring, to its own motion, from
stiffnesses a third too large, with a few evaluations: all of `estimate`, by `--method`. The default method also solves
dense systems, whose time the second thread does not change; with l-bfgs-b nearly all is steps and gradients. The fit
runs in turn with the second thread and without (NUMBA_NUM_THREADS=1, read at every solve) in one process on two cores,
compiled beforehand. Seconds are medians over the rounds. `gain` is the time without over the time with, the median of
the ratios within each round, and beside it the least and the largest; both results must be the same to the last bit.
The load in the heading counts other programs: where it is above 0.5, the second core is not free and the gain comes out
too low.
"""

from __future__ import annotations

import argparse
import os
from typing import Any

import numpy as np

import measure
from grids import grid

SIDES = (40, 64, 88)
START = 1.3  # of the stiffnesses that the target was made with
SWITCH = "NUMBA_NUM_THREADS"


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description="Print what the second thread of a solve gains in a fit.")
    parser.add_argument("sides", nargs="*", type=int, metavar="SIDE", help=f"vertices along a side (default: {SIDES})")
    parser.add_argument("--frames", type=int, default=30, help="frames of each motion (default: 30)")
    parser.add_argument("--evaluations", type=int, default=6, help="evaluations of each fit (default: 6)")
    parser.add_argument("--method", default="auto", help="method of the fit (default: auto)")
    parser.add_argument("--rounds", type=int, default=5, help="runs of each (default: 5)")
    return parser.parse_args()


def fits(side: int, frames: int, evaluations: int, method: str) -> tuple[dict[str, measure.Work], dict[str, Any]]:
    """A fit with one thread and the same with two, and where their results go."""
    import clothfit

    scene = grid(side, frames)
    target = clothfit.simulate(scene)
    start = clothfit.with_parameters(scene, START * clothfit.parameters(scene))
    found: dict[str, Any] = {}

    def fit(name: str) -> None:
        if name == "one":
            os.environ[SWITCH] = "1"
        else:
            os.environ.pop(SWITCH, None)
        found[name] = clothfit.estimate(
            start, target, method=method, options=clothfit.FitOptions(max_evaluations=evaluations),
        )

    return {name: lambda name=name: fit(name) for name in ("one", "two")}, found


def row(side: int, given: argparse.Namespace) -> str:
    """One line of the table."""
    import clothfit

    works, found = fits(side, given.frames, given.evaluations, given.method)
    seconds = measure.in_turn(works, given.rounds)
    one, two = (np.append(found[name].cost, clothfit.parameters(found[name].scene)) for name in works)
    if one.tobytes() != two.tobytes():
        raise SystemExit(f"{side}²: two threads give another result than one")
    gains = seconds["one"] / seconds["two"]
    times = [f"{np.median(seconds[name]):.2f}" for name in works]
    cells = [f"{side}²", str(found["two"].evaluations), *times, f"{np.median(gains):.2f}"]
    return f"| {' | '.join(cells)} | {gains.min():.2f} … {gains.max():.2f} |"


def main() -> None:
    """Print the table."""
    given = arguments()
    for name in ("OMP_NUM_THREADS", SWITCH):  # a 1 in either would forbid the second thread
        os.environ.pop(name, None)
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    print(f"{measure.machine()}; medians of {given.rounds} rounds{load}\n")
    print("| grid | evaluations | s, one thread | s, two threads | gain | least … largest |")
    print("|---|---|---|---|---|---|", flush=True)
    for side in given.sides or SIDES:
        print(row(side, given), flush=True)


if __name__ == "__main__":
    main()
