"""`clothfit control`: the gentlest controls that take a cloth through keyframes."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clothfit.base import interrupts
from clothfit.base.checkpoint import Checkpoint
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import duration
from clothfit.base.messages import counted, metres
from clothfit.cli import report as pages
from clothfit.cli.common import motions, pictures
from clothfit.cli.common.console import Console
from clothfit.cli.common.motions import check_there, one_stream, read_scene, warn_of_steps
from clothfit.cli.common.options import gathered, given, option, section, setting, standard_command, tuned
from clothfit.cli.common.output import PAGE, SCENE, STREAM, Output, attributes, companion_file, output_for, print_json
from clothfit.cli.common.progress import now_and_then
from clothfit.cli.parts import checkpoints
from clothfit.formats.axes import Convention, Reading, positive
from clothfit.many.job import INTERRUPTED
from clothfit.optimise.status import Status

if TYPE_CHECKING:
    from clothfit.base.arrays import Flags
    from clothfit.control.control import Control
    from clothfit.control.controls import Controls, Handle
    from clothfit.control.keyframes import Key
    from clothfit.scene.cloth import Cloth
    from clothfit.scene.scene import Scene

INTERVAL = 2.0
"""Seconds between two lines of progress."""

WIDEST = 1e6
"""The longest time of --smooth, s, and distance of --even, m."""


MOST_MODES = 10_000


@dataclass(frozen=True)
class Moves:
    """The options as they are given."""

    actuate: str | None = given("--actuate all|VERTICES", "Forces on these vertices of the first object with keys, "
        "such as 0,11,20-30, or on a region of the scene.  [default: all, unless something else is to move]")
    handles: str | None = given("--handles VERTICES", "Vertices that are led along a path, such as 0,132-143: each "
        "number, range or region is one handle. pins: those of the scene.")
    wind: bool = given("--wind", "The wind, over time.")
    velocity: bool = given("--velocity", "The velocities at the start.")
    every: float | None = tuned("--every SECONDS", "Time between two keys of paths, of the wind and, then, of forces.  "
        "[default: 0.1; forces of each step]", float)
    modes: int | None = tuned("--modes COUNT", "Forces in the first so many modes of vibration only.", int)

    def check(self) -> None:
        """Raise InvalidInput on values that cannot be."""
        positive("--every", self.every)
        if self.modes is not None and not 1 <= self.modes <= MOST_MODES:
            raise InvalidInput(f"--modes must be within 1 … {MOST_MODES}; {self.modes} was given")
        if self.modes is not None and self.others and self.actuate is None:
            raise InvalidInput("--modes are shapes of forces; ask for these too: --actuate all")

    @property
    def pushes(self) -> bool:
        """Whether forces are asked for."""
        return self.actuate is not None or not self.others

    @property
    def others(self) -> bool:
        """Whether anything else than forces may move."""
        return bool(self.handles or self.wind or self.velocity)

    def of(self, keys: Sequence[Key], scene: Scene) -> Controls:
        """What may move of a scene. Raises InvalidInput."""
        from clothfit.control.controls import Controls

        cloth = min(key.cloth for key in keys)
        pushed = actuated(self.actuate or "all", cloth, scene) if self.pushes else None
        handles = handles_of(self.handles, cloth, scene) if self.handles else ()
        if self.wind and not any(own.feels_air for own in scene.cloths):
            raise InvalidInput("--wind: the air drags no object of the scene (dragCoefficient), so no wind moves one")
        return Controls(pushed, handles, self.wind, self.velocity, self.every, self.modes)


@standard_command("control")
@click.argument("scene_path", metavar="SCENE")
@section("What to do")
@option("--keyframes KEYS", "Where the cloth is to be, and when: JSON, or a motion with few frames.", name="keys_path",
        required=True)
@option("--most N", "Largest force on a vertex, N.  [default: none]", float)
@setting("--smooth SECONDS", "Prefer forces that change slowly: a change within this time costs as much as the force "
        "itself.  [default: 0]", float)
@setting("--even METRES", "Prefer forces that neighbours share: a difference over this distance costs as much as the "
        "force itself.  [default: 0]", float)
@option("--budget SECONDS", "Stop after this time, such as 30, 30s or 2m, with the best so far.  [default: none]",
        name="time_budget")
@section("What may move")
@gathered("moves", Moves)
@section("Long searches")
@setting("--checkpoint FILE", "Save the state of the search here.  [default: <output>.checkpoint, after a minute]",
        name="checkpoint_path")
@option("--resume", "Go on with a search that was ended early, from its checkpoint.")
@section("The file of the keyframes")
@motions.reads
@section("What is written")
@option("-o --output MOTION", "File of the motion, in any format.  [default: <stem>.controlled.npz]", name="path")
@option("--forces FILE", "File of the forces.  [default: <stem>.forces.npz]", name="forces_path")
@option("--save SCENE", "Scene with the paths, the wind and the velocities that were found.  [default: "
        "<stem>.controlled.json, where there are any]", name="save_path")
@setting("--table FILE", "Write the forces as a table too (.csv): a line for each step and vertex.", name="table_path")
@option("--report FILE", "Write a page that plays the motion among its keys, with the forces, in 3-D.",
        name="report_path")
@pictures.options
def command(
    scene_path: str, keys_path: str, reading: Reading, moves: Moves, most: float | None,
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
    positive("--most", most)
    for name, value, unit in (("--smooth", smooth, "s"), ("--even", even, "m")):
        if value is not None and not 0 <= value <= WIDEST:
            raise InvalidInput(f"{name} must be at least 0 and at most {WIDEST:g}; {value:g} {unit} was given")
    moves.check()
    scene = read_scene(scene_path, console)
    out = output_for(path, scene_path, ".controlled.npz", (keys_path,))
    used: list[str | None] = [scene_path, keys_path, out.path]
    stem = Path("scene" if scene_path == STREAM else scene_path)
    kept = saved = None
    if moves.pushes:
        kept = companion_file("--forces", forces_path or str(stem.with_suffix(".forces.npz")), used)
        used.append(kept.path if kept else None)
    if moves.others:
        saved = companion_file("--save", save_path or str(stem.with_suffix(".controlled.json")), used, text=SCENE)
        used.append(saved.path if saved else None)
    motions.check_output(out, Convention(), (scene_path, keys_path))
    table = companion_file("--table", table_path, used, ".csv")
    page = companion_file("--report", report_path, (*used, table_path), text=PAGE)
    pictures.check(*used, table_path, report_path)
    file = checkpoints.chosen(checkpoint_path, resume, out, used, console, partial(Checkpoint, resume=resume))
    for name, own_path in (("--forces", forces_path), ("--table", table_path)):
        if own_path is not None and not moves.pushes:
            raise InvalidInput(f"{name}: no forces are to be found; ask for some with --actuate, or leave it out")
    if save_path is not None and not moves.others:
        raise InvalidInput("--save: only handles, wind and velocities go into a scene; the forces go into --forces")
    seconds = duration(time_budget, "--budget")
    keys = read_keys(keys_path, reading, scene, console)
    controls = moves.of(keys, scene)
    warn_of_steps(scene, scene.frames, console)
    from clothfit.control.closed_loop import Costs
    from clothfit.control.control import find_controls
    from clothfit.scene.forces import archive
    from clothfit.scene.forces import table as rows
    from clothfit.scene.scene import dumps, folder_of

    console.announce_compilation()
    costs = Costs(smooth or 0.0, float("inf") if most is None else most, even or 0.0)
    with interrupts.deferred():
        found = find_controls(
            scene, keys, controls, budget=seconds, costs=costs, report=lines(console), checkpoint=file
        )
        with all_tried() as writing:
            if kept and found.forces:
                writing(kept.write, archive(found.forces))
            if saved:
                writing(saved.write, dumps(found.scene, folder_of(saved.path)))
            writing(motions.write_motion, found.motion, out, scene, Convention(), console)
        if file and file.fault:
            console.warn(file.fault)
        checkpoints.closed(file, checkpoint_path is not None, found.status, console)
    good = report(found, kept, saved, out, console)
    print_json(summary(found, kept, saved, out))
    if table is not None and found.forces is not None:
        table.put(rows(found.forces.times, found.forces.values))
        console.say(f"table → {table.name}")
    if page is not None or any(pictures.files):
        draw(scene, keys, found, page, pictures, (kept, saved), keys_path, console)
    return INTERRUPTED if found.status == "interrupted" else 0 if good else 5


def read_keys(path: str, reading: Reading, scene: Scene, console: Console) -> list[Key]:
    """The keys of a file, JSON or a motion. Raises InvalidInput."""
    from clothfit.control import keyframes

    check_there(path)
    if path.lower().endswith(".json"):
        return keyframes.load_keys(path, scene)
    return keyframes.from_motion(motions.read_motion(path, scene, reading, console), scene)


def lines(console: Console) -> Callable[[float, float, int], None]:
    """What says a line of progress now and then."""
    tell = now_and_then(console.say, INTERVAL)

    def show(effort: float, missed: float, evaluations: int) -> None:
        def line() -> str:
            parts = f"effort {effort:.4g} N² s" * (effort > 0), f"{metres(missed)} beside the keys" * (missed > 0)
            return ", ".join([*filter(None, parts), f"evaluation {evaluations}"])

        tell(line)

    return show


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
        **attributes(found, "status", "effort", "optimality", "evaluations", "seconds", "at_bound"),
        "keys": [asdict(key) | {"free": far} for key, far in zip(found.keys, found.free, strict=True)],
        "forces": kept.path if kept else None,
        "scene": saved.path if saved else None,
        "output": out.path,
    }


def draw(
    scene: Scene, keys: Sequence[Key], found: Control, page: Output | None, pictures: pictures.Pictures,
    written: tuple[Output | None, Output | None], keys_path: str, console: Console,
) -> None:
    """Write page and pictures; nobody waits for them who has asked for the end. `written` is where forces and scene
    went.
    """
    if found.status == Status.INTERRUPTED:
        console.say("nothing is drawn, as the search was interrupted")
        return
    from clothfit.control.control import controlled_motion

    over = controlled_motion(scene, found.scene.with_forces(found.forces), keys, found.motion)
    if page is not None:
        from clothfit.report.control_contents import control_content
        from clothfit.report.page import page as page_of

        kept, saved = written
        played = ["clothfit", "simulate", saved.name if saved else scene.name]
        commands = [pages.command_line(click.get_current_context()),
                    shlex.join([*played, *(["--forces", kept.name] if kept else [])])]  # fmt: skip
        origin = commands, pages.digests([scene], {keys_path: None})
        pages.put(page_of(control_content(over, found), *origin), page, console)
    pictures.controlled(over, ended(found), console)


def ended(found: Control) -> str:
    """How a search ended, in a line."""
    evaluations = counted(found.evaluations, "evaluation", "evaluations")
    effort = f"effort {found.effort:.4g} N² s, " if found.forces is not None else ""
    return f"{found.status}: {effort}{evaluations} in {found.seconds:.1f} s"


# ---- What of a scene may move, from the options.

def actuated(text: str, cloth: int, scene: Scene) -> list[Flags]:
    """Of each object the vertices on which forces act. Raises InvalidInput."""
    flags = [np.ones(count, bool) for count in scene.vertex_counts]
    if text != "all":
        flags[cloth] = named("--actuate", text, scene.cloths[cloth])
        if not (flags[cloth] & ~scene.cloths[cloth].fixed).any():
            raise InvalidInput(f"--actuate {text}: all of these vertices are fixed")
    return flags


def named(option: str, text: str, own: Cloth) -> Flags:
    """The vertices of a region, or of a list of numbers. Raises InvalidInput."""
    from clothfit.cli.new import ranges
    from clothfit.meshes.new_scene import listed

    for region in own.layout.regions:
        if text.strip() == region.name:
            return np.isin(np.arange(len(own.mass)), region.vertices)
    return listed(len(own.mass), ranges(option, text), option)


def handles_of(text: str, cloth: int, scene: Scene) -> tuple[Handle, ...]:
    """The handles, with commas between them. Raises InvalidInput."""
    from clothfit.control.controls import Handle
    from clothfit.scene.keys import Pin

    own, found = scene.cloths[cloth], []
    taken = np.zeros(len(own.mass), bool)
    for part in own.pins if text.strip() == "pins" else text.split(","):
        if isinstance(part, Pin):
            flags = np.isin(np.arange(len(taken)), part.vertices)
        else:
            flags = named("--handles", part, own)
        if (taken & flags).any():
            raise InvalidInput(f"--handles: vertex {np.flatnonzero(taken & flags)[0]} is in two of them")
        taken |= flags
        found.append(Handle(cloth, np.flatnonzero(flags).astype(np.int32)))
    if not found:
        raise InvalidInput(f"--handles pins: objects[{cloth}] has no pins")
    return tuple(found)


@contextmanager
def all_tried() -> Iterator[Callable[..., None]]:
    """What is yielded calls a function that writes a file; where one cannot, the others are written all the same, and
    the first error is raised at the end.
    """
    faults: list[InvalidInput] = []

    def writing(write: Callable[..., object], *arguments: Any) -> None:
        try:
            write(*arguments)
        except InvalidInput as error:
            faults.append(error)

    yield writing
    if faults:
        raise faults[0]
