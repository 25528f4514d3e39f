"""`clothfit control`: the gentlest controls that take a cloth through keyframes."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from clothfit.base import interrupts
from clothfit.base.checkpoint import Checkpoint
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted, metres
from clothfit.cli import report as pages
from clothfit.cli.common import motions, pictures
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import duration, section, standard_command
from clothfit.cli.common.output import STREAM, Output, beside, is_among, output_for, page_beside, print_json
from clothfit.cli.common.scenes import check_there, one_stream, read_scene, warn_of_steps
from clothfit.cli.parts import checkpoints, control_moves
from clothfit.formats.axes import Convention
from clothfit.many.job import INTERRUPTED
from clothfit.optimise.status import Status

if TYPE_CHECKING:
    from clothfit.cli.common.pictures import Pictures
    from clothfit.control.control import Control
    from clothfit.control.keyframes import Key
    from clothfit.formats.axes import Reading
    from clothfit.scene.scene import Scene

INTERVAL = 2.0
"""Seconds between two lines of progress."""

WIDEST = 1e6
"""The longest time of --smooth, s, and distance of --even, m."""


@standard_command("control")
@click.argument("scene_path", metavar="SCENE")
@section("What to do")
@click.option("--keyframes", "keys_path", metavar="KEYS", required=True,
              help="Where the cloth is to be, and when: JSON, or a motion with few frames.")
@click.option("--most", type=float, metavar="N", help="Largest force on a vertex, N.  [default: none]")
@click.option("--smooth", type=float, metavar="SECONDS",
              help="Prefer forces that change slowly: a change within this time costs as much as the force itself.  "
              "[default: 0]")
@click.option("--even", type=float, metavar="METRES",
              help="Prefer forces that neighbours share: a difference over this distance costs as much as the force "
              "itself.  [default: 0]")
@click.option("--budget", "time_budget", metavar="SECONDS",
              help="Stop after this time, such as 30, 30s or 2m, with the best so far.  [default: none]")
@section("What may move")
@control_moves.options
@section("Long searches")
@click.option("--checkpoint", "checkpoint_path", metavar="FILE",
              help="Save the state of the search here.  [default: <output>.checkpoint, after a minute]")
@click.option("--resume", is_flag=True, help="Go on with a search that was ended early, from its checkpoint.")
@section("The file of the keyframes")
@motions.reads
@section("What is written")
@click.option("-o", "--output", "path", metavar="MOTION",
              help="File of the motion, in any format.  [default: <stem>.controlled.npz]")
@click.option("--forces", "forces_path", metavar="FILE", help="File of the forces.  [default: <stem>.forces.npz]")
@click.option("--save", "save_path", metavar="SCENE",
              help="Scene with the paths, the wind and the velocities that were found.  "
              "[default: <stem>.controlled.json, where there are any]")
@click.option("--table", "table_path", metavar="FILE",
              help="Write the forces as a table too (.csv): a line for each step and vertex.")
@click.option("--report", "report_path", metavar="FILE",
              help="Write a page that plays the motion among its keys, with the forces, in 3-D.")
@pictures.options
def command(
    scene_path: str, keys_path: str, reading: Reading, moves: control_moves.Moves, most: float | None,
    smooth: float | None, even: float | None, time_budget: str | None, checkpoint_path: str | None, resume: bool,
    path: str | None, forces_path: str | None, save_path: str | None, table_path: str | None, report_path: str | None,
    pictures: pictures.Pictures, console: Console,
) -> int:
    """Find the gentlest controls under which the cloths of SCENE pass through keyframes.

    By default these are forces on all vertices, of the least sum of squares over time. Played by clothfit simulate
    --forces, they give the same motion to the last bit; with --feedback a disturbed cloth arrives too. Handles, wind
    and velocities go into a scene, which plays as any other.

    \b
    clothfit control scene.json --keyframes keys.json
    clothfit control scene.json --keyframes pose.npz -o motion.npz --forces forces.npz
    clothfit control scene.json --keyframes keys.json --handles 0,11 --wind --save steered.json
    clothfit control scene.json --keyframes keys.json --actuate 0-11,132-143 --budget 30s
    clothfit control scene.json --keyframes keys.json --most 0.5 --smooth 0.1 --gif motion.gif
    """
    one_stream(scene_path, keys_path)
    checked(most, smooth, even)
    moves.check()
    scene = read_scene(scene_path, console)
    out = output_for(path, scene_path, ".controlled.npz", (keys_path,))
    place = partial(own_output, scene_path=scene_path, keys_path=keys_path)
    kept = place("--forces", forces_path, suffix=".forces.npz", others=(out,)) if moves.pushes else None
    saved = place("--save", save_path, suffix=".controlled.json", others=(out, kept)) if moves.others else None
    motions.check(out, Convention(), (scene_path, keys_path))
    used = scene_path, keys_path, out.path, *(each.path for each in (kept, saved) if each)
    shows = asked(table_path, report_path, used)
    pictures.check(*used, *shows.files)
    file = checkpoints.chosen(checkpoint_path, resume, out, used, console, partial(Checkpoint, resume=resume))
    refuse_unused(moves, forces_path, save_path, table_path)
    seconds = duration(time_budget, "--budget")
    keys = read_keys(keys_path, reading, scene, console)
    controls = moves.of(keys, scene)
    warn_of_steps(scene, scene.frames, console)
    from clothfit.control.closed_loop import Costs
    from clothfit.control.control import find_controls
    from clothfit.scene.forces import archive
    from clothfit.scene.scene import dumps, folder_of

    console.announce_compilation()
    costs = Costs(smooth or 0.0, float("inf") if most is None else most, even or 0.0)
    with interrupts.deferred():
        found = find_controls(
            scene, keys, controls, budget=seconds, costs=costs, report=Lines(console), checkpoint=file
        )
        with control_moves.all_tried() as writing:
            if kept and found.forces:
                writing(kept.write, archive(found.forces))
            if saved:
                writing(saved.write, dumps(found.scene, folder_of(saved.path)))
            writing(motions.write, found.motion, out, scene, Convention(), console)
        control_moves.closed(file, checkpoint_path is not None, str(found.status), console)
    good = report(found, kept, saved, out, console)
    print_json(summary(found, kept, saved, out))
    shows.write(scene, keys, found, pictures, (kept, saved), (keys_path,), console)
    return INTERRUPTED if found.status == "interrupted" else 0 if good else 5


def checked(most: float | None, smooth: float | None, even: float | None) -> None:
    """Raise InvalidInput on values that cannot be."""
    if most is not None and not (math.isfinite(most) and most > 0):
        raise InvalidInput(f"--most must be above 0; {most:g} N was given")
    for option, value, unit in (("--smooth", smooth, "s"), ("--even", even, "m")):
        if value is not None and not 0 <= value <= WIDEST:
            raise InvalidInput(f"{option} must be at least 0 and at most {WIDEST:g}; {value:g} {unit} was given")


def own_output(
    option: str, path: str | None, scene_path: str, suffix: str, keys_path: str, others: Sequence[Output | None]
) -> Output:
    """Where something goes beside the motion: none of the `others`; checked as any output. Raises InvalidInput."""
    if path == STREAM:
        raise InvalidInput(f"{option} must be a file; - was given")
    if path is None and scene_path == STREAM:
        path = f"scene{suffix}"
    out = output_for(path, scene_path, suffix, (keys_path,), text=True)
    if is_among(out.path, [each.path for each in others if each]):
        raise InvalidInput(f"{option} must be a file of its own; {out.path} is another output")
    return out


def refuse_unused(moves: control_moves.Moves, forces: str | None, saved: str | None, table: str | None) -> None:
    """Raise InvalidInput where a file is asked for that nothing goes into."""
    for option, path in (("--forces", forces), ("--table", table)):
        if path is not None and not moves.pushes:
            raise InvalidInput(f"{option}: no forces are to be found; ask for some with --actuate, or leave it out")
    if saved is not None and not moves.others:
        raise InvalidInput("--save: only handles, wind and velocities go into a scene; the forces go into --forces")


def read_keys(path: str, reading: Reading, scene: Scene, console: Console) -> list[Key]:
    """The keys of a file, JSON or a motion. Raises InvalidInput."""
    from clothfit.control import keyframes

    check_there(path)
    if path.lower().endswith(".json"):
        return keyframes.load_keys(path, scene)
    return keyframes.from_motion(motions.read(path, scene, reading, console), scene)


class Lines:
    """A line of progress now and then."""

    def __init__(self, console: Console) -> None:
        self.console, self.next = console, interrupts.now() + INTERVAL

    def __call__(self, effort: float, missed: float, evaluations: int) -> None:
        if interrupts.now() >= self.next:
            self.next = interrupts.now() + INTERVAL
            parts = [f"effort {effort:.4g} N² s"] if effort > 0 else []
            parts += [f"{metres(missed)} beside the keys"] if missed > 0 else []
            self.console.say(", ".join([*parts, f"evaluation {evaluations}"]))


def report(found: Control, kept: Output | None, saved: Output | None, out: Output, console: Console) -> bool:
    """Say what was found; whether all keys are reached."""
    rows = [["key", "without control", "with it"]]
    for key, far in zip(found.keys, found.free, strict=True):
        speed = "" if key.speed is None else f", {key.speed:.2g} m/s beside its velocities"
        rows.append([f"{key.time:.4g} s", metres(far), metres(key.rmse) + speed + ("" if key.near else "  missed")])
    console.table(rows)
    files = ", ".join(each.name for each in (kept, saved, out) if each)
    console.say(f"{ended(found)} → {files}")
    if found.at_bound:
        console.warn(f"{found.at_bound} forces are at their bound (--most)")
    for key in found.keys:
        if key.immovable and not key.near:
            vertices = counted(key.immovable, "vertex", "vertices")
            console.warn(f"no control moves {vertices} of the key at {key.time:.4g} s")
    good = all(key.near for key in found.keys)
    if not good:
        console.warn(
            "not all keys are reached; give it more time (--budget), more controls (--actuate, --handles, --wind), "
            "larger forces (--most)"
        )
    return good


def summary(found: Control, kept: Output | None, saved: Output | None, out: Output) -> dict[str, Any]:
    """What --json prints."""
    return {
        "status": str(found.status),
        "keys": [asdict(key) | {"free": far} for key, far in zip(found.keys, found.free, strict=True)],
        "effort": found.effort,
        "optimality": found.optimality,
        "evaluations": found.evaluations,
        "seconds": found.seconds,
        "at_bound": found.at_bound,
        "forces": kept.path if kept else None,
        "scene": saved.path if saved else None,
        "output": out.path,
    }


# ---- What is written beside forces and motion: a table of the forces, a page, pictures.

@dataclass(frozen=True)
class Shows:
    """What is asked for."""

    table: Output | None
    page: Output | None
    command: str  # that makes them

    @property
    def files(self) -> tuple[str | None, ...]:
        """Where they go."""
        return tuple(None if each is None else each.path for each in (self.table, self.page))

    def write(
        self, scene: Scene, keys: Sequence[Key], found: Control, pictures: Pictures,
        written: tuple[Output | None, Output | None], files: Sequence[str], console: Console,
    ) -> None:  # fmt: skip
        """Write what is asked for; nobody waits for pictures who has asked for the end. `written` is where forces and
        scene went, `files` are what was read beside the scene.
        """
        if self.table is not None and found.forces is not None:
            from clothfit.scene.forces import table

            self.table.put(table(found.forces.times, found.forces.values))
            console.say(f"table → {self.table.name}")
        if self.page is None and not any(pictures.files):
            return
        if found.status == Status.INTERRUPTED:
            console.say("nothing is drawn, as the search was interrupted")
            return
        from clothfit.control.control import course

        over = course(scene, found.scene.with_forces(found.forces), keys, found.motion)
        if self.page is not None:
            from clothfit.report.control_contents import control_content
            from clothfit.report.page import page as made

            kept, saved = written
            played = ["clothfit", "simulate", saved.name if saved else scene.name]
            again = shlex.join([*played, *(["--forces", kept.name] if kept else [])])
            digests = pages.digests([scene], dict.fromkeys(files))
            page = made(control_content(over, found), [self.command, again], digests)
            self.page.write(page)
            console.say(f"page, {len(page) / 1e6:.2g} MB → {self.page.name}")
        pictures.controlled(over, ended(found), console)


def asked(table: str | None, page: str | None, used: Sequence[str | None]) -> Shows:
    """What is asked for, checked before the work begins; `used` are other files. Raises InvalidInput."""
    if table is not None and not table.lower().endswith(".csv"):
        raise InvalidInput(f"--table must be a file .csv; {table} was given")
    command = pages.command_line(click.get_current_context())
    return Shows(beside(table, used), page_beside(page, (*used, table)), command)


def ended(found: Control) -> str:
    """How a search ended, in a line."""
    evaluations = counted(found.evaluations, "evaluation", "evaluations")
    effort = f"effort {found.effort:.4g} N² s, " if found.forces is not None else ""
    return f"{found.status}: {effort}{evaluations} in {found.seconds:.1f} s"
