"""Print how fast this program is on this machine, beside others: `python benchmarks/speed.py [SCENE …]`.

Two tables in Markdown. The first, for each scene (default: the example `side`), has one row for each program of `peers`
whose library, or compiler, is there: a step, and the cost with its exact gradient by all stiffnesses over the scene's
frames, linear systems solved to 1e-5 and to 1e-10; each also as a multiple of the time of the C++ by hand or, where
there is no compiler, of plain numba. NUMBA_CPU_NAME=haswell compares both as for another processor. The programs run in
turn in one process on one core, compiled beforehand; times are medians over the rounds, multiples the medians of the
ratios within each. A program whose motion or gradient is another one is not quoted.

The second (default: all examples) is of this program alone: CG iterations are means over the steps; the gradient is by
all flagged parameters, solved to 1e-10 as in a fit, and the last column its time over that of the cost alone.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import measure

PLAYING, FITTING, REFERENCE = 1e-5, 1e-10, 1e-13
SAME_MOTION, SAME_GRADIENT = 1e-7, 1e-6  # m and relative, at tolerance FITTING: what 99 steps make of it is below 1e-8
BASES = ("cpp", "numba")
EXAMPLES = Path(__file__).parent.parent / "examples"


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description="Print how fast this program is, beside others.")
    parser.add_argument("scenes", nargs="*", type=Path, metavar="SCENE", help="scene files (default: the examples)")
    measure.add_options(parser, rounds=15, peers=list(measure.PEERS))
    parser.add_argument("--table", choices=("programs", "scenes"), help="only one of the tables")
    return parser.parse_args()


def differences(program: Any, this: Any, steps: int) -> tuple[float, float | None]:
    """How far a program's motion, m, and its gradient, relative, are from those of this program, solved tightly."""
    exact = this.steps(steps, REFERENCE)
    motion = float(np.abs(program.steps(steps, FITTING) - exact).max())
    if not program.cost_and_gradient:
        return motion, None
    k = guess(this)
    _, wanted = this.cost_and_gradient(k, exact, REFERENCE)
    _, gradient = program.cost_and_gradient(k, exact, FITTING)
    return motion, float(np.linalg.norm(gradient - wanted) / np.linalg.norm(wanted))


def guess(this: Any) -> NDArray[np.float64]:
    """Stiffnesses to take the gradient at: a tenth above those of the target."""
    return 1.1 * np.asarray(this.system.springs.stiffness)


def programs(path: Path, names: list[str]) -> tuple[dict[str, Any], int]:
    """This program and its peers that compute the same on a scene, by name, and the number of steps."""
    import clothfit
    from peers import this_program
    from peers.problem import problem

    scene = clothfit.load(path)
    this, steps = this_program.Peer(scene), scene.frames - 1
    found = {"clothfit": this}
    for name, peer in measure.peer_classes(names).items():
        program = peer(problem(scene))
        motion, gradient = differences(program, this, steps)
        said = "no gradient" if gradient is None else f"gradient by {gradient:.1e}"
        print(f"{program.name}: motion differs by {motion:.1e} m, {said}", file=sys.stderr)
        if motion > SAME_MOTION or (gradient or 0.0) > SAME_GRADIENT:
            print(f"{program.name}: left out, it computes something else", file=sys.stderr)
        else:
            found[name] = program
    return found, steps


def programs_table(path: Path, names: list[str], rounds: int, clock: str = "wall") -> None:
    """Print the rows of one scene."""
    found, steps = programs(path, names)
    target = found["clothfit"].steps(steps, FITTING)
    k = measure.fresh(guess(found["clothfit"]))
    able = {name: program for name, program in found.items() if program.cost_and_gradient}
    timed, iterations = [], []
    for t in (PLAYING, FITTING):
        works = {n: lambda p=p, t=t: p.steps(steps, t) for n, p in found.items()}
        timed.append(measure.in_turn(works, rounds, clock))
        iterations.append({name: program.iterations for name, program in found.items()})
    for t in (PLAYING, FITTING):
        works = {n: lambda p=p, t=t: p.cost_and_gradient(k(), target, t) for n, p in able.items()}
        timed.append(measure.in_turn(works, rounds, clock))
    print(f"\n{path.stem}: {target.shape[1]} vertices, {steps} steps, gradient by {len(k())} stiffnesses\n")
    columns = ("µs per step to 1e-5", "× base", "to 1e-10", "× base", "ms per gradient to 1e-5", "× base", "to 1e-10")
    print(f"| program | CG iterations | {' | '.join(columns)} | × base |".replace("base", found[base_of(found)].name))
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name in sorted(found, key=lambda name: np.median(timed[0][name])):
        cells = [f"{iterations[0][name]:.1f}, {iterations[1][name]:.1f}"]
        for seconds, count in zip(timed, (1e-3 * steps, 1e-3 * steps, 1, 1), strict=True):
            cells += cell(seconds, name, count, base_of(found))
        print(f"| {found[name].name} | {' | '.join(cells)} |", flush=True)


def base_of(found: dict[str, Any]) -> str:
    """The program that the others are compared with: the fastest that is there."""
    return next((name for name in BASES if name in found), "clothfit")


def cell(seconds: dict[str, NDArray[np.float64]], name: str, count: float, base: str) -> tuple[str, str]:
    """Milliseconds over so many steps, and the ratio to the base; dashes where a program has none."""
    if name not in seconds:
        return "–", "–"
    ratio = f"{np.median(seconds[name] / seconds[base]):.2f}"
    return f"{1e3 * np.median(seconds[name]) / count:.3g}", ratio


def scenes_row(path: Path, rounds: int, clock: str) -> str:
    """One line of the table of scenes."""
    import clothfit
    from clothfit.base.limits import FIT_TOLERANCE
    from clothfit.engine.rollout import rollout
    from clothfit.engine.system import build
    from clothfit.fit.estimate import record_target

    scene = clothfit.load(path)
    steps, system = scene.frames - 1, build(scene, 0)
    memory, _ = rollout(system, steps, PLAYING)
    objective = clothfit.Objective(scene, record_target(scene), FIT_TOLERANCE)
    p = measure.fresh(1.1 * clothfit.parameters(scene))
    seconds = measure.in_turn(
        {
            "step": lambda: rollout(system, steps, PLAYING),
            "cost": lambda: objective.cost(p()),
            "gradient": lambda: objective.cost_and_gradient(p()),
        },
        rounds,
        clock,
    )
    step, gradient = (1e3 * float(np.median(seconds[name])) for name in ("step", "gradient"))
    return (
        f"| {path.stem} | {len(system.x0)} | {step / steps:.3f} | {memory.solves[:, 0].mean():.1f} "
        f"| {len(p())} | {steps} | {gradient:.1f} | {np.median(seconds['gradient'] / seconds['cost']):.1f} |"
    )


def scenes_table(paths: list[Path], rounds: int, clock: str) -> None:
    """Print the table of this program alone."""
    columns = ("scene", "vertices", "ms per step", "CG iterations", "parameters", "steps", "ms per cost and gradient")
    print(f"\n| {' | '.join(columns)} | … over cost |")
    print("|---|---|---|---|---|---|---|---|")
    for path in paths:
        print(scenes_row(path, rounds, clock), flush=True)


def main() -> None:
    """Print the tables."""
    given = arguments()
    measure.use_cores(given.cores)
    print(measure.heading(given))
    if given.table != "scenes":
        for path in given.scenes or [EXAMPLES / "side.json"]:
            programs_table(path, given.peers, given.rounds, given.clock)
    if given.table != "programs":
        scenes_table(given.scenes or sorted(EXAMPLES.glob("*.json")), given.rounds, given.clock)


if __name__ == "__main__":
    main()
