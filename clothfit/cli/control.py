"""`clothfit control`: the least forces that take a cloth through keyframes."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from clothfit.base import interrupts
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import metres
from clothfit.cli.common import motions, pictures
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import duration, standard_command
from clothfit.cli.common.output import STREAM, Output, output_for, print_json, same_file
from clothfit.cli.common.scenes import check_there, one_stream, read_scene, warn_of_steps
from clothfit.cli.fitting import shown
from clothfit.many.job import INTERRUPTED

if TYPE_CHECKING:
    from clothfit.base.arrays import Flags
    from clothfit.control.control import Control
    from clothfit.control.keyframes import Key
    from clothfit.formats.convention import Convention, Reading
    from clothfit.scene.scene import Scene

INTERVAL = 2.0
"""Seconds between two lines of progress."""

SECTIONS = {
    "What to do": ("--keyframes", "--actuate", "--most", "--smooth", "--budget", "--adjoint"),
    "The file of the keyframes": motions.FILE_OPTIONS,
    "What is written": ("--output", "--forces", "--table", "--report", "--plot", "--gif"),
}


@standard_command("control", SECTIONS)
@click.argument("scene_path", metavar="SCENE")
@click.option("--keyframes", "keys_path", metavar="KEYS", required=True,
              help="Where the cloth is to be, and when: JSON, or a motion with few frames.")
@motions.reads
@click.option("--actuate", default="all", metavar="all|VERTICES",
              help="Vertices of the first object with keys on which forces act, such as 0,11,20-30.  [default: all]")
@click.option("--most", type=float, metavar="N", help="Largest force on a vertex, N.  [default: none]")
@click.option("--smooth", type=float, metavar="SECONDS",
              help="Prefer forces that change slowly: a change within this time costs as much as the force itself.  "
              "[default: 0]")
@click.option("--budget", "time_budget", metavar="SECONDS",
              help="Stop after this time, such as 30, 30s or 2m, with the best so far.  [default: none]")
@click.option("--adjoint", type=click.Choice(["exact", "approximate"]), default="exact", show_default=True,
              help="exact: the gradient of the steps that are taken. approximate, to compare: that of textbooks, in "
              "the closed loop of the search too; the effort then ends above the least.")
@click.option("-o", "--output", "path", metavar="MOTION",
              help="File of the motion, in any format.  [default: <stem>.controlled.npz]")
@click.option("--forces", "forces_path", metavar="FILE", help="File of the forces.  [default: <stem>.forces.npz]")
@click.option("--table", "table_path", metavar="FILE",
              help="Write the forces as a table too (.csv): a line for each step and vertex.")
@click.option("--report", "report_path", metavar="FILE",
              help="Write a page that plays the motion among its keys, with the forces, in 3-D.")
@pictures.options
def command(
    scene_path: str,
    keys_path: str,
    reading: Reading,
    actuate: str,
    most: float | None,
    smooth: float | None,
    time_budget: str | None,
    adjoint: str,
    path: str | None,
    forces_path: str | None,
    table_path: str | None,
    report_path: str | None,
    pictures: pictures.Pictures,
    as_json: bool,
    console: Console,
) -> int:
    """Find the forces of least effort under which the cloths of SCENE pass through keyframes.

    Effort is the sum of the squared forces on all vertices over time. Played by clothfit simulate --forces, the forces
    give the same motion to the last bit; with --feedback a disturbed cloth arrives too.

    \b
    clothfit control scene.json --keyframes keys.json
    clothfit control scene.json --keyframes pose.npz -o motion.npz --forces forces.npz
    clothfit control scene.json --keyframes keys.json --actuate 0-11,132-143 --budget 30s
    clothfit control scene.json --keyframes keys.json --most 0.5 --smooth 0.1 --gif motion.gif
    """
    one_stream(scene_path, keys_path)
    checked(most, smooth)
    scene = read_scene(scene_path, console)
    out = output_for(path, scene_path, ".controlled.npz", (keys_path,))
    kept = forces_output(forces_path, scene_path, keys_path, out)
    motions.check(out, own_axes(), (scene_path, keys_path))
    shows = shown.asked(table_path, report_path, (scene_path, keys_path, out.path, kept.path))
    pictures.check(scene_path, keys_path, out.path, kept.path, *shows.files)
    seconds = duration(time_budget, "--budget")
    keys = read_keys(keys_path, reading, scene, console)
    pushed = actuated(actuate, keys, scene)
    warn_of_steps(scene, scene.frames, console)
    from clothfit.control.closed_loop import Costs
    from clothfit.control.control import find_forces
    from clothfit.scene.over_time.forces import archive

    console.announce_compilation()
    costs = Costs(smooth or 0.0, float("inf") if most is None else most, adjoint == "approximate")
    with interrupts.deferred():
        found = find_forces(scene, keys, pushed, budget=seconds, costs=costs, report=Lines(console))
        kept.write(archive(found.forces))
        motions.write(found.motion, out, scene, own_axes(), console)
    good = report(found, kept, out, console)
    if adjoint == "approximate":
        console.say("the gradient was approximate: the effort may be above the least, whatever the status says")
    if as_json:
        print_json("control", {**summary(found, kept, out), "adjoint": adjoint}, out)
    shows.write(scene, keys, found, pictures, kept, (keys_path,), console)
    return INTERRUPTED if found.status == "interrupted" else 0 if good else 5


def own_axes() -> Convention:
    """The axes of each format."""
    from clothfit.formats.convention import Convention

    return Convention()


def checked(most: float | None, smooth: float | None) -> None:
    """Raise InvalidInput on values that cannot be."""
    if most is not None and not (math.isfinite(most) and most > 0):
        raise InvalidInput(f"--most must be above 0; {most:g} N was given")
    if smooth is not None and not (math.isfinite(smooth) and smooth >= 0):
        raise InvalidInput(f"--smooth must be at least 0; {smooth:g} s was given")


def forces_output(path: str | None, scene_path: str, keys_path: str, out: Output) -> Output:
    """Where the forces go, checked as any output. Raises InvalidInput."""
    if path == STREAM:
        raise InvalidInput("--forces must be a file; - was given")
    if path is None and scene_path == STREAM:
        path = "scene.forces.npz"
    kept = output_for(path, scene_path, ".forces.npz", (keys_path,))
    if not out.is_stream and same_file(kept.path, out.path):
        raise InvalidInput(f"--forces must be a file of its own; {kept.path} is that of the motion")
    return kept


def read_keys(path: str, reading: Reading, scene: Scene, console: Console) -> list[Key]:
    """The keys of a file, JSON or a motion. Raises InvalidInput."""
    from clothfit.control import keyframes

    check_there(path)
    if path.lower().endswith(".json"):
        return keyframes.load_keys(path, scene)
    return keyframes.from_motion(motions.read(path, scene, reading, console), scene)


def actuated(text: str, keys: list[Key], scene: Scene) -> list[Flags] | None:
    """Of each object the vertices on which forces act; None for all. Raises InvalidInput."""
    if text == "all":
        return None
    import numpy as np

    from clothfit.cli.making.asked import ranges
    from clothfit.meshes.fixing import listed

    flags = [np.ones(count, bool) for count in scene.vertex_counts]
    cloth = min(key.cloth for key in keys)
    flags[cloth] = listed(len(flags[cloth]), ranges("--actuate", text), "--actuate")
    if not (flags[cloth] & ~scene.cloths[cloth].fixed).any():
        raise InvalidInput(f"--actuate {text}: all of these vertices are fixed")
    return flags


class Lines:
    """A line of progress now and then."""

    def __init__(self, console: Console) -> None:
        self.console, self.next = console, interrupts.now() + INTERVAL

    def __call__(self, effort: float, missed: float, evaluations: int) -> None:
        if interrupts.now() >= self.next:
            self.next = interrupts.now() + INTERVAL
            beside = f", {metres(missed)} beside the keys" if missed > 0 else ""
            self.console.say(f"effort {effort:.4g} N² s{beside}, evaluation {evaluations}")


def report(found: Control, kept: Output, out: Output, console: Console) -> bool:
    """Say what was found; whether all keys are reached."""
    rows = [["key", "without forces", "with them"]]
    good = True
    for key, far in zip(found.keys, found.free, strict=True):
        good = good and key.near
        rows.append([f"{key.time:.4g} s", metres(far), metres(key.rmse) + ("" if key.near else "  missed")])
    console.table(rows)
    console.say(
        f"{found.status}: effort {found.effort:.4g} N² s, {found.evaluations} evaluations in {found.seconds:.1f} s → "
        f"{kept.name}, {out.name}"
    )
    if found.at_bound:
        console.warn(f"{found.at_bound} forces are at their bound (--most)")
    if not good:
        console.warn(
            "not all keys are reached; give it more time (--budget), more vertices (--actuate), larger forces (--most)"
        )
    return good


def summary(found: Control, kept: Output, out: Output) -> dict[str, Any]:
    """What --json prints."""
    return {
        "status": str(found.status),
        "keys": [asdict(key) | {"free": far} for key, far in zip(found.keys, found.free, strict=True)],
        "effort": found.effort,
        "optimality": found.optimality,
        "evaluations": found.evaluations,
        "seconds": found.seconds,
        "at_bound": found.at_bound,
        "forces": kept.path,
        "output": out.path,
    }
