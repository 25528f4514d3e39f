"""Print how time and memory grow with the cloth: `python benchmarks/scaling.py [SIDE …]`, by default 32 64 128 256.

Grids of SIDE² vertices (`grids.py`): 7 × 7 m held at one side, 4.9 kg in all, springs of 50 N/m along the edges and
12.5 N/m across them, steps of 0.02 s, linear systems solved to 1e-5. Times per step are means over the motion from the
start, cost and gradient by all stiffnesses per step likewise. The programs run in turn in one process on one core,
compiled beforehand: medians over the rounds, and beside those of a peer this program's as a multiple of it. Memory is
the peak of a process of its own that computes a cost and gradient, all of Python included. `× bytes` is the time of
this program's step beside that which memory takes for the bytes that must move (`bytes_of`), at the speed of a STREAM
triad (J. McCalpin, 1995) that is measured at the start: below 1 where the caches hold the matrix. The last lines give
the exponents p of time ~ vertices^p, fitted to the grids from 64² on.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

import measure
from grids import TOLERANCE, grid

Seconds = dict[str, NDArray[np.float64]]
STEPS = {32: 100, 64: 100, 128: 50, 256: 20}
TRIAD = 20_000_000  # numbers in each of its arrays
LARGE = 64  # exponents are fitted to the grids from here on
ABOVE = 128  # of larger grids JAX is left out, and there is one round


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description="Print how time and memory grow with the cloth.")
    parser.add_argument("sides", nargs="*", type=int, metavar="SIDE", help="vertices along a side (default: 32 … 256)")
    parser.add_argument("--steps", type=int, help=f"steps of each motion (default: {STEPS})")
    measure.add_options(parser, rounds=3, peers=["numba", "jax"])
    parser.add_argument("--no-gradient", action="store_true", help="steps only")
    parser.add_argument("--peak", action="store_true", help=argparse.SUPPRESS)  # what `peak_memory` runs
    return parser.parse_args()


def steps_of(given: argparse.Namespace, side: int) -> int:
    """How many steps a grid takes."""
    return given.steps or STEPS.get(side, 20)


def target(side: int, steps: int) -> tuple[Any, NDArray[np.float64], NDArray[np.float64]]:
    """This program on a grid, stiffnesses to take the gradient at, and the motion to compare with."""
    from peers import this_program

    this = this_program.Peer(grid(side, steps + 1))
    return this, 1.1 * np.array(this.system.springs.stiffness), this.steps(steps, TOLERANCE)


def run(given: argparse.Namespace, side: int) -> tuple[dict[str, Any], Seconds, Seconds]:
    """The programs on a grid, with seconds per step and per step of a cost and gradient."""
    from peers.problem import problem

    steps, rounds = steps_of(given, side), given.rounds if side <= ABOVE else 1
    this, k, goal = target(side, steps)
    fresh = measure.fresh(k)
    found = {"clothfit": this}
    names = [name for name in given.peers if side <= ABOVE or name != "jax"]
    found |= {name: peer(problem(this.scene)) for name, peer in measure.peer_classes(names).items()}
    seconds = measure.in_turn({n: lambda p=p: p.steps(steps, TOLERANCE) for n, p in found.items()}, rounds, given.clock)
    works = {
        name: lambda p=p: p.cost_and_gradient(fresh(), goal, TOLERANCE)
        for name, p in found.items()
        if p.cost_and_gradient and not given.no_gradient
    }
    gradient = measure.in_turn(works, rounds, given.clock)
    return found, *({name: each / steps for name, each in times.items()} for times in (seconds, gradient))


def triad() -> float:
    """Bytes per second of a = b + 3 c on one core, arrays far larger than the caches: two are read, one is written."""
    import numba

    @numba.njit
    def run(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> None:
        for i in range(len(a)):
            a[i] = b[i] + 3.0 * c[i]

    a, b, c = (np.ones(TRIAD) for _ in range(3))
    seconds = measure.in_turn({"triad": lambda: run(a, b, c)}, 5)["triad"]
    return 24.0 * TRIAD / float(np.min(seconds))


def bytes_of(system: Any, iterations: float) -> float:
    """Bytes that a step of so many CG iterations must at least move: the matrix is written once, and read once in each
    iteration, each level of the preconditioner is read in both of its sweeps, and each vector once where it is read or
    written; what a sweep touches twice in a row is still in the caches.
    """
    from clothfit.engine.step import implicit

    work, n = implicit.workspace(system), len(system.x0)
    matrix = work.A.upper.nbytes + work.A.diagonal.nbytes + work.A.column.nbytes
    levels = work.solver.large.hierarchy.levels if n >= LARGE**2 else ()
    sweeps = sum(2 * (each.A.upper.nbytes + each.A.column.nbytes + each.inverse.nbytes) for each in levels)
    sweeps += sum(10 * each.r.nbytes for each in levels)  # r, z, rest: read, written, in both sweeps and between
    springs = sum(each.nbytes for each in (system.springs.ends, system.springs.rest, system.springs.stiffness))
    return float(iterations * (matrix + sweeps + 10 * work.solver.cg.x.nbytes) + 2 * matrix + sweeps / 2 + springs)


def peak_memory(given: argparse.Namespace, side: int) -> float:
    """Peak memory, MB, of a cost and gradient in a process of its own.

    To be called while this process is small: a new one counts the memory of the one that starts it.
    """
    command = [sys.executable, __file__, str(side), "--peak", "--steps", str(steps_of(given, side))]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def print_peak(side: int, steps: int) -> None:
    """What that process does."""
    this, k, goal = target(side, steps)
    this.cost_and_gradient(k, goal, TOLERANCE)
    unit = 1e6 if sys.platform == "darwin" else 1e3  # bytes there, kilobytes elsewhere
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit)


def cells(name: str, program: Any, step: Seconds, gradient: Seconds) -> list[str]:
    """What a row says of one program."""
    row = []
    for seconds in (step, gradient):
        row.append(f"{1e3 * np.median(seconds[name]):.3g}" if name in seconds else "–")
        ratio = name in seconds and name != "clothfit"
        row.append(f"{np.median(seconds['clothfit'] / seconds[name]):.2f}" if ratio else "–")
    return [program.name, f"{program.iterations:.0f}", *row]


def exponent(times: dict[int, float]) -> str:
    """The exponent p of time ~ vertices^p, over the large grids; nothing where there is only one."""
    sides = [side for side in times if side >= LARGE]
    if len(sides) < 2:
        return ""
    slope = np.polyfit(np.log(np.square(sides)), np.log([times[side] for side in sides]), 1)[0]
    return f"vertices^{slope:.2f} from {sides[0]}² to {sides[-1]}²"


def main() -> None:
    """Print the table."""
    given = arguments()
    measure.use_cores(given.cores)
    sides = given.sides or list(STEPS)
    if given.peak:
        print_peak(sides[0], given.steps)
        return
    print(f"{measure.heading(given)}\n", flush=True)
    memory = {side: f"{peak_memory(given, side):.0f} MB" for side in sides}
    speed = triad()
    print(f"STREAM triad: {speed / 1e9:.1f} GB/s\n")
    columns = ("grid", "steps", "program", "CG iterations", "ms per step", "clothfit ×", "with gradient", "clothfit ×")
    print(f"| {' | '.join(columns)} | × bytes | peak memory |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    grown: dict[str, dict[str, dict[int, float]]] = {"step": {}, "cost and gradient": {}}
    for side in sides:
        found, *seconds = run(given, side)
        for name, program in found.items():
            own = ["", ""]
            if name == "clothfit":
                least = bytes_of(program.system, program.iterations) / speed
                own = [f"{np.median(seconds[0][name]) / least:.1f}", memory[side]]
            row = [f"{side}²", str(steps_of(given, side)), *cells(name, program, *seconds), *own]
            print(f"| {' | '.join(row)} |", flush=True)
            for kind, times in zip(grown.values(), seconds, strict=True):
                if name in times:
                    kind.setdefault(program.name, {})[side] = float(np.median(times[name]))
    print()
    for what, kind in grown.items():
        for name, times in kind.items():
            if found := exponent(times):
                print(f"- {name}, {what}: {found}")


if __name__ == "__main__":
    main()
