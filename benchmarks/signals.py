"""Ask fits to end at random instants and see what they leave: `python benchmarks/signals.py [--count 100] [--seed 0]`.

Fits of every kind by `clothfit estimate` take turns until so many have been asked, by SIGINT or SIGTERM, at an instant
drawn from the time between their first result and their end. Afterwards

- the exit code is 130, and the summary, valid JSON, says `interrupted`, or how the search had ended before; a fit that
  had only to end has its own exit code;
- the fitted scene is there, and its cost, computed anew, is that of the summary;
- that cost is the best visited: no more than the last that the fit had logged, nor than that of its start.

One more in ten is asked before its first result: it ends with 130 as well, and leaves a whole scene or none.

Prints a table, and each fault; the exit code is 1 where there is one.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np

from at_random import by_turns, show, total
from clothfit.base.errors import InvalidScene
from clothfit.base.limits import FIT_TOLERANCE
from clothfit.fit.estimate import record_target
from clothfit.fit.hierarchy import as_model
from clothfit.fit.holdout import split
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import load_motion, save_motion
from clothfit.objective.experiment import experiments
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.scene import load, save

FRAMES = 40
SCATTER = 0.5  # of the logarithms of the stiffnesses
LONGEST = 300  # s
ROUNDING = 1e-6
"""Relative difference of a cost and the same computed from the written scene."""

EARLY = 10
"""Of so many fits one more is asked before its first result."""

INTERRUPTED, STALLED = 130, 5
"""Exit codes: of a fit that was asked to end; of one that ended without reaching its tolerance."""

LONGEST_ANSWER = "longest answer, ms"

SIGNALS = (signal.SIGINT, signal.SIGTERM)

TARGET = ["scene.json", "--target", "capture.npz", "--start", "20"]
KINDS = {
    "auto, intervals": [*TARGET],
    "windows": [*TARGET, "--method", "gauss-newton", "--prior", "none", "--no-intervals"],
    "windows, prior": [*TARGET, "--method", "gauss-newton"],
    "l-bfgs-b": [*TARGET, "--method", "l-bfgs-b"],
    "nelder-mead": [*TARGET, "--method", "nelder-mead", "--no-intervals"],
    "momentum": ["scene.json", "--target", "dense.npz", "--start", "20", "--method", "momentum"],
    "hold-out": [*TARGET, "--holdout", "0.2"],
    "two scenes": [*TARGET, "--target", "windy.npz@windy.json"],
    "velocities, huber": [*TARGET, "--objective", "position", "--objective", "velocity=0.0001", "--loss", "huber"],
    "one value": ["one.json", "--target", "capture.npz"],
    "its own motion": ["scene.json"],
}


@dataclass
class Kind:
    """A kind of fit and what became of those that were asked to end."""

    name: str
    arguments: list[str]
    seconds: float = 0.0  # from the first result to the end, of a fit that nobody disturbs
    counts: Counter[str] = field(default_factory=Counter)

    def begin(self, folder: Path) -> subprocess.Popen[bytes]:
        """Start a fit in a folder."""
        options = ["-o", "fitted.json", "--log", "fit.jsonl", "--json"]
        command = [sys.executable, "-m", "clothfit", "estimate", *self.arguments, *options]
        return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def inputs(folder: Path) -> None:
    """Write the scenes and the targets of all fits: a cloth of 6 by 6 vertices whose stiffnesses scatter."""
    path = folder / "scene.json"
    command = [sys.executable, "-m", "clothfit", "new", "plane", "--divisions", "4", "--fix-side", "left"]
    subprocess.run([*command, "--fit", "nL", "--frames", str(FRAMES), "-q", "-o", str(path)], check=True)
    scene = load(path)
    values = parameters(scene)
    true = with_parameters(scene, values * np.exp(SCATTER * np.random.default_rng(0).normal(size=len(values))))
    save(true, path)
    made = json.loads(path.read_text())
    (folder / "windy.json").write_text(json.dumps(made | {"windVel": {"x": 2.0, "y": 0.0, "z": 1.0}}))
    made["objects"][0]["optimizationSettings"] = "nG"
    (folder / "one.json").write_text(json.dumps(made))
    for name, own, every in (("capture", "scene", 2), ("dense", "scene", 1), ("windy", "windy", 2)):
        motion = degrade(record_target(load(folder / f"{own}.json")), noise=0.001, every=every)
        save_motion(motion, folder / f"{name}.npz")


def logged(folder: Path) -> list[dict[str, Any]]:
    """The whole lines of a log."""
    path = folder / "fit.jsonl"
    text = path.read_text() if path.exists() else ""
    lines = [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]
    return [line for line in lines if "cost" in line]


def until_result(process: subprocess.Popen[bytes], folder: Path) -> None:
    """Wait for the first line of a log, or the end."""
    while process.poll() is None and not logged(folder):
        time.sleep(0.005)


def measured(kind: Kind, folder: Path) -> None:
    """Run a fit undisturbed; how long it takes after its first result."""
    (folder / "fit.jsonl").unlink(missing_ok=True)
    process = kind.begin(folder)
    until_result(process, folder)
    began = time.perf_counter()
    _, error = process.communicate(timeout=LONGEST)
    if process.returncode not in (0, STALLED):
        raise SystemExit(f"{kind.name} fails undisturbed: {error.decode()}")
    kind.seconds = time.perf_counter() - began


def asked(kind: Kind, folder: Path, chance: random.Random, early: bool) -> list[str]:
    """Ask a fit to end and judge what it left in a folder with its inputs; returns the faults."""
    process = kind.begin(folder)
    if early:
        time.sleep(chance.uniform(0.0, 1.5))
    else:
        until_result(process, folder)
        time.sleep(chance.uniform(0.0, kind.seconds))
    known = logged(folder)
    asked_by, moment = chance.choice(SIGNALS), time.perf_counter()
    if process.poll() is None:
        process.send_signal(asked_by)
    output, error = process.communicate(timeout=LONGEST)
    kind.counts[LONGEST_ANSWER] = max(kind.counts[LONGEST_ANSWER], round(1e3 * (time.perf_counter() - moment)))
    if process.returncode not in (INTERRUPTED, 0, STALLED):
        return [f"{asked_by.name}: ends with {process.returncode}: {error.decode()}"]
    if process.returncode != INTERRUPTED and not early:
        kind.counts["ended before"] += 1
        kind.seconds *= 0.9  # it is faster than it was
    else:
        kind.counts["before a result" if early else "interrupted"] += 1
    if early and not (folder / "fitted.json").exists():
        return [] if b"interrupt" in error.lower() else [f"{asked_by.name}, early: it says {error.decode()!r}"]
    try:
        found = left(kind, folder, json.loads(output), known, process.returncode)
    except (OSError, ValueError, KeyError, InvalidScene) as fault:
        found = [f"no whole result: {fault!r}; it says {error.decode()!r}"]
    kind.counts["result written"] += not found and process.returncode == INTERRUPTED and not early
    return [f"{asked_by.name}: {fault}" for fault in found]


def left(kind: Kind, folder: Path, summary: dict[str, Any], known: list[dict[str, Any]], code: int) -> list[str]:
    """What is wrong with a result; `known` is what had been logged when the fit was asked to end."""
    faults = []
    if code == INTERRUPTED and summary["status"] not in ("interrupted", "converged", "stalled"):
        faults.append(f"the exit code is {code}, the status {summary['status']}")
    cost, own = recomputed(kind, folder), summary["cost"]
    if not abs(cost - own) <= ROUNDING * own:
        faults.append(f"the scene costs {cost:.9g}, the summary says {own:.9g}")
    for line, what in ((known or logged(folder))[:1], "first"), (known[-1:], "last"):
        if line and not cost <= (1.0 + ROUNDING) * line[0]["cost"]:
            faults.append(f"it costs {cost:.9g}, the {what} in the log {line[0]['cost']:.9g}")
    return faults


def recomputed(kind: Kind, folder: Path) -> float:
    """The cost of the scene that a fit wrote."""
    fitted, options = load(folder / "fitted.json"), kind.arguments
    scene = load(folder / kind.arguments[0])
    targets: list[Any] = [record_target(scene)] if "--target" not in options else []
    for flag, value in itertools.pairwise(options):
        if flag == "--target":
            motion, _, other = value.partition("@")
            own = load(folder / other) if other else scene
            targets.append((load_motion(folder / motion, own), own) if other else load_motion(folder / motion, own))
    given = experiments(scene, targets)
    frames = [experiment.scene.frames for experiment in given]
    if "--holdout" in options:
        given, _ = split(scene, given, float(options[options.index("--holdout") + 1]), "frames")
    weights = {"position": 1.0, "velocity": 1e-4} if "--loss" in options else "position"
    loss = "huber" if "--loss" in options else "linear"
    each = as_model(scene, "L", exactly=True)  # as it is: equal values for all may have come no nearer
    objective = Objective(scene, given, FIT_TOLERANCE, frames, objective=weights, loss=loss).flagging(each)
    return objective.cost(parameters(fitted, each))


@click.command()
@click.option("--count", default=100, show_default=True, help="Fits that are asked to end.")
@click.option("--seed", default=0, show_default=True, help="Of the instants.")
@click.option("--seconds", type=float, default=math.inf, help="Begin no other fit after this time.")
def main(count: int, seed: int, seconds: float) -> None:
    """Ask fits to end at random instants and see what they leave."""
    kinds, chance = [Kind(*each) for each in KINDS.items()], random.Random(seed)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory() as directory:
        folder = Path(directory)
        inputs(folder)
        for kind in kinds:
            measured(kind, folder)

        def one(kind: Kind, number: int) -> list[str]:
            for path in (folder / "fitted.json", folder / "fit.jsonl"):
                path.unlink(missing_ok=True)
            return asked(kind, folder, chance, early=number % EARLY == EARLY - 1)

        faults = by_turns(kinds, one, "interrupted", count, seconds)
    names = ("interrupted", "result written", "ended before", "before a result", LONGEST_ANSWER)
    asked_to_end, written = total(kinds, "interrupted"), total(kinds, "result written")
    said = f"{asked_to_end} interrupted, {written} results written, each the best visited"
    show(kinds, "fit", names, said, faults)


if __name__ == "__main__":
    main()
