"""Kill runs at random instants and see what is left: `python benchmarks/kills.py [--count 200] [--seed 0]`.

Runs of `clothfit estimate` (a fit to a noisy capture, with a checkpoint) and `clothfit simulate` take turns until so
many have been killed. Each gets a SIGKILL at an instant drawn from its whole length; of three runs, one from its last
fifth, where files are written, and one as soon as a file is being written after the instant that was drawn. In half of
the runs there is an older file in the place of the output. Afterwards

- the output is absent, the older file, or to the last byte that of a run that nobody disturbed: no file is torn;
- the inputs have the bytes they had;
- the checkpoint is absent or whole;
- there is no other file but those, and hidden temporaries;
- the same command, with `--resume` where there is a checkpoint, ends well and leaves no temporary; a simulation gives
  the undisturbed output to the last byte, a fit the same minimum.

Prints a table, and each fault; the exit code is 1 where there is one.
"""

from __future__ import annotations

import math
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import click

from at_random import by_turns, show, total
from clothfit.base.errors import InvalidInput
from clothfit.fit.estimate import record_target
from clothfit.motion.degrade import degrade
from clothfit.motion.motion import save_motion
from clothfit.optimise.checkpoint import decoded
from clothfit.scene.scene import load

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
LATE = 0.2  # the last part of a run
WRITING = 0.003  # s that a file is being written for, at most, when its writer is killed
OLD = b"an older file\n"
LONGEST = 300  # s
SAME_COST = 1e-3  # relative difference of two costs at the same minimum


@dataclass
class Run:
    """A command, what it reads and what it writes."""

    arguments: list[str]
    inputs: dict[str, bytes]  # by name
    output: str
    checkpoint: str | None = None
    result: bytes = b""  # of a run that nobody disturbed
    cost: float = 0.0  # of such a fit
    seconds: float = 0.0  # that it took
    counts: Counter[str] = field(default_factory=Counter)

    @property
    def name(self) -> str:
        """The command."""
        return self.arguments[0]

    def begin(self, folder: Path, *more: str) -> subprocess.Popen[bytes]:
        """Start the command in a folder."""
        command = [sys.executable, "-m", "clothfit", *self.arguments, *more]
        return subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def prepared(folder: Path, scene: Path, frames: int, steps: int, warm: int) -> list[Run]:
    """The two commands: a fit to so many `frames`, a simulation of so many `steps`; measured after `warm` runs."""
    shutil.copy(scene, folder / "scene.json")
    capture = degrade(record_target(load(scene), frames), noise=0.001)
    save_motion(capture, folder / "capture.npz")
    files = {name: (folder / name).read_bytes() for name in ("scene.json", "capture.npz")}
    fit = ["estimate", "scene.json", "--target", "capture.npz", "--start", "0.05", "--no-intervals", "-q"]
    fit += ["--checkpoint", "fit.checkpoint", "-o", "fitted.json"]
    move = ["simulate", "scene.json", "--steps", str(steps), "-q", "-o", "moved.npz"]
    runs = [Run(fit, files, "fitted.json", "fit.checkpoint"), Run(move, files, "moved.npz")]
    for run in runs:
        for _ in range(1 + warm):  # the first may compile
            began = time.perf_counter()
            process = run.begin(folder)
            output = process.communicate(timeout=LONGEST)[1].decode()
            if process.returncode:
                raise SystemExit(f"{run.arguments[0]} fails undisturbed: {output}")
            run.seconds = time.perf_counter() - began
        run.result = (folder / run.output).read_bytes()
        run.cost = cost_of(run, folder)
    return runs


def cost_of(run: Run, folder: Path) -> float:
    """The cost of a fit by its checkpoint; 0 for a simulation."""
    return decoded((folder / run.checkpoint).read_bytes(), run.checkpoint)[1].cost if run.checkpoint else 0.0


def disturbed(run: Run, folder: Path, chance: random.Random) -> list[str]:
    """Kill a run, judge what it left, go on from there; returns the faults."""
    for name, data in run.inputs.items():
        (folder / name).write_bytes(data)
    older = chance.random() < 0.5
    if older:
        (folder / run.output).write_bytes(OLD)
    kind = chance.choice(("any", "late", "writing"))
    instant = run.seconds * chance.uniform(1.0 - LATE if kind == "late" else 0.0, 1.0)
    began = time.perf_counter()
    process = run.begin(folder)
    try:
        process.communicate(timeout=instant)
    except subprocess.TimeoutExpired:
        while kind == "writing" and process.poll() is None and not temporaries(folder):
            time.sleep(0.0002)
        time.sleep(chance.uniform(0.0, WRITING) if kind == "writing" else 0.0)
        process.kill()
        process.communicate()
    if process.returncode == -signal.SIGKILL:
        run.counts["killed"] += 1
    else:  # it is faster than it was
        run.counts["ended before"] += 1
        run.seconds = min(run.seconds, time.perf_counter() - began)
    found = [f"{kind}, {instant:.3f} s: {fault}" for fault in torn(run, folder, older)]
    return found + [f"{kind}, {instant:.3f} s, then repeated: {fault}" for fault in repeated(run, folder)]


def torn(run: Run, folder: Path, older: bool) -> list[str]:
    """What is wrong with the files that a killed run left."""
    faults = [f"{name} is not as it was" for name, data in run.inputs.items() if (folder / name).read_bytes() != data]
    path = folder / run.output
    now = path.read_bytes() if path.exists() else None
    run.counts["output new" if now == run.result else "output old or absent"] += 1
    if now not in (OLD if older else None, run.result):
        faults.append(f"{run.output} is torn or gone")
    if run.checkpoint and (folder / run.checkpoint).exists():
        try:
            decoded((folder / run.checkpoint).read_bytes(), run.checkpoint)
            run.counts["checkpoint whole"] += 1
        except InvalidInput as error:
            faults.append(str(error))
    left = temporaries(folder)
    run.counts["temporary left"] += bool(left)
    others = {path.name for path in folder.iterdir()} - {*run.inputs, run.output, str(run.checkpoint), *left}
    return faults + [f"there is a file {name}" for name in sorted(others)]


def repeated(run: Run, folder: Path) -> list[str]:
    """What is wrong when the command is given again."""
    resume = ["--resume"] if run.checkpoint and (folder / run.checkpoint).exists() else []
    process = run.begin(folder, *resume)
    output = process.communicate(timeout=LONGEST)[1].decode()
    if process.returncode:
        return [f"ends with {process.returncode}: {output}"]
    faults = []
    if run.checkpoint is None and (folder / run.output).read_bytes() != run.result:
        faults.append(f"{run.output} has another content")
    if not math.isclose(cost_of(run, folder), run.cost, rel_tol=SAME_COST):
        faults.append(f"ends at a cost of {cost_of(run, folder):g}, not {run.cost:g}")
    return faults + [f"{name} stayed" for name in temporaries(folder)]


def temporaries(folder: Path) -> list[str]:
    """Names of files that never came to a final name."""
    return [name for name in os.listdir(folder) if name.startswith(".clothfit-") and name.endswith(".tmp")]


def trials(
    count: int, seed: int, frames: int, steps: int, scene: Path = EXAMPLES / "corners.json", warm: int = 1
) -> tuple[list[Run], list[str]]:
    """Kill so many runs, by turns; returns both commands with what was counted, and the faults."""
    chance = random.Random(seed)
    with tempfile.TemporaryDirectory() as first:
        runs = prepared(Path(first), scene, frames, steps, warm)

    def one(run: Run, _: int) -> list[str]:
        with tempfile.TemporaryDirectory() as folder:
            return disturbed(run, Path(folder), chance)

    return runs, by_turns(runs, one, "killed", count)


@click.command()
@click.option("--count", default=200, show_default=True, help="Kills.")
@click.option("--seed", default=0, show_default=True, help="Of the instants.")
@click.option("--frames", default=12, show_default=True, help="That are fitted.")
@click.option("--steps", default=5000, show_default=True, help="That are simulated.")
def main(count: int, seed: int, frames: int, steps: int) -> None:
    """Kill runs at random instants and see what is left."""
    runs, faults = trials(count, seed, frames, steps)
    names = ("killed", "ended before", "output old or absent", "output new", "checkpoint whole", "temporary left")
    show(runs, "command", names, f"{total(runs, 'killed')} kills", faults)


if __name__ == "__main__":
    main()
