"""What commands have in common that read scenes, or read or write motions of other programs.

The scenes that a command reads, how many of their frames, and warnings of simulations that cannot be trusted.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.errors import InvalidInput, InvalidScene
from clothfit.base.limits import doubts, doubts_of_time
from clothfit.base.messages import unreadable
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import Action, F, check_numbers, gathered, option, setting
from clothfit.cli.common.output import STREAM, Output, same_file, uninterrupted
from clothfit.formats.axes import HANDS, UPS, Convention, Reading
from clothfit.formats.registry import foreign, format_of, suffix_of
from clothfit.scene.text import name_of

if TYPE_CHECKING:
    from clothfit.base.arrays import Array, Indices
    from clothfit.formats.axes import Axes
    from clothfit.motion.energy import Energy
    from clothfit.motion.foreign import Loaded
    from clothfit.motion.motion import Motion
    from clothfit.scene.scene import Scene

UNEVEN = 1e-3
"""Of a time step: differences between steps that are no rounding."""

READ_BY = ("target_path", "target_paths", "in_path", "keys_path")
"""Parameters of commands that are motions to read."""


def axes(
    prefix: str = "", what: str = "the motion file", whose: str = "the format's",
    declared: Callable[..., Callable[[F], F]] = option,
) -> Callable[[F], F]:
    """Add the options that say how a file's coordinates are meant, else as `whose` are."""

    def decorate(function: F) -> F:
        own = f"[default: {whose}]"
        hands = declared(f"--{prefix}handedness", f"Handedness of the axes of {what}.  {own}", click.Choice(HANDS))
        up = declared(f"--{prefix}up", f"Axis of {what} that points up.  {own}", click.Choice(UPS))
        return declared(f"--{prefix}scale M", f"Metres per unit of {what}.  {own}", float)(up(hands(function)))

    return decorate


def reads(function: Action) -> Action:
    """Add the options that say what a motion file does not; they come as one argument, `reading`."""

    @wraps(function)
    def described(reading: Reading, **rest: Any) -> int | None:
        if not reading.plain and not any(rest.get(name) for name in READ_BY):
            raise click.UsageError(
                "--scale, --up, --handedness, --fps, --frames, --cloth and --map describe the motion of --target; add "
                "that",
                click.get_current_context(),
            )
        return function(**rest, reading=reading)

    by_default = "[default: its times, else one frame per time step]"
    return gathered(
        "reading", Reading,
        axes(whose="the file's, else the format's"),
        option("--fps F", f"Frames per second of the motion file.  {by_default}", float),
        option("--frames A:B", "Frames of the motion file, as a Python slice.  [default: all]"),
        setting("--cloth NAME", "Mesh of the motion file that is the cloth, where it has several.  [default: the "
               "scene's, else those that move]", name="mesh"),
        setting("--map FILE", "CSV file that maps markers to vertices: marker, object, vertex.  [default: the nearest]",
               name="markers"),
    )(described)  # fmt: skip


writes = gathered("convention", Convention, axes())
"""Adds the options that say how a motion file is written; they come as one argument, `convention`."""


def read_motion(
    path: str, scene: Scene, reading: Reading, console: Console, readings: list[dict[str, Any]] | None = None
) -> Motion:
    """Load a motion of the scene from a path or standard input; what was assumed is said, and added to `readings`."""
    assumed = foreign(path) is not None or not reading.plain
    loaded = load(path, scene, reading, console, assumed)
    if (assumed or loaded.interpretation.doubts) and readings is not None:
        readings.append(loaded.interpretation.summary())
    return loaded.motion


def load(path: str, scene: Scene | None, reading: Reading, console: Console, assumed: bool = True) -> Loaded:
    """Load a motion from a path or standard input, and say what was assumed, where anything was."""
    from clothfit.motion import foreign

    loaded = foreign.load(sys.stdin.buffer if path == STREAM else path, scene, reading)
    if assumed or loaded.interpretation.notes:
        console.say(str(loaded.interpretation))
    console.warn(*loaded.interpretation.doubts)
    if scene is None:  # else its start is compared with the scene's, which says more
        first = loaded.motion.positions[0][loaded.motion.seen()[0]]
        console.warn(*doubts((first.max(axis=0) - first.min(axis=0)).tolist() if len(first) else []), of=path)
    return loaded


def arguments(reading: Reading) -> list[str]:
    """The options of a command that say the same."""
    words = {"markers": "map", "mesh": "cloth"}
    own = {name: value for name, value in vars(reading).items() if value is not None and name != "bind"}
    said = {words.get(name, name): value for name, value in own.items()}
    return [word for name, value in said.items() for word in (f"--{name}", str(value))]


def readings_summary(readings: list[dict[str, Any]]) -> dict[str, Any]:
    """What --json says of the files of other programs that were read."""
    return {"reading": readings} if readings else {}


def check_output(
    out: Output, convention: Convention, inputs: Iterable[str | None], frames: int | None = None, gaps: bool = False
) -> None:
    """Check, before long work, that a motion of so many frames (None: not known yet) can be written, with or without
    `gaps`, and not over any of the `inputs`. Raises InvalidInput.
    """
    from clothfit.formats.obj import ANY, numbered
    from clothfit.motion.files import check_gaps, check_place, sources

    plain = out.is_stream or not suffix_of(out.path)  # a pipe of a shell has no suffix
    found = None if plain else format_of(out.path, writing=True)
    if found is None:
        if convention != Convention():
            raise InvalidInput(
                f"{out.name}: .npz has the scene's axes and metres; leave --scale, --up, --handedness out"
            )
        return
    check_place(out.path, frames)
    if gaps:
        check_gaps(found)
    read = [file for path in inputs if path not in (None, STREAM) for file in sources(str(path))]
    for path in [each for _, each in numbered(out.path)] if ANY in out.path else [out.path]:
        if any(same_file(path, each) for each in read):
            raise InvalidInput(f"cannot write {path}: it is an input, which is never written over; name another")


def write_motion(
    motion: Motion, out: Output, scene: Scene, convention: Convention, console: Console,
    extra: Mapping[str, Array] | None = None,
) -> None:
    """Write a motion of the scene to its file or files, with other arrays beside it where they can hold any."""
    from clothfit.motion.files import for_tools
    from clothfit.motion.motion import archive

    found = foreign(out.path)
    if found is None:
        out.write(archive(motion, extra))
        return
    if extra:
        console.warn(f"{out.name}: holds positions only; what --energy tells is kept in .npz")
    whole, faces = for_tools(motion, scene, found)
    write_foreign(whole, out, convention, console, triangles=faces)


def write_foreign(
    motion: Motion, out: Output, convention: Convention, console: Console, triangles: Indices | None = None,
    names: tuple[str, ...] | None = None, timed: bool = True,
) -> Axes:
    """Write a motion as another program has it; says and returns which axes it got."""
    from clothfit.formats.markers import named
    from clothfit.motion import files as motion_files

    found = foreign(out.path)
    assert found is not None
    motion_files.check_place(out.path, len(motion.times))
    asked = convention.axes(found.axes)
    meant = named(asked) if found.markers else asked
    if meant != asked:
        console.warn(f"{out.name}: {found.name} has no name for a unit of {asked.scale:g} m; it is written in metres")
    made = motion_files.animation(motion, found, meant, triangles, names)
    files = motion_files.files(out.path, found, made)
    if motion.weights is not None:
        console.warn(f"{out.name}: has no place for weights; .npz has")
    with uninterrupted():
        motion_files.write_all(files)
    console.say(f"{out.name}: {found.name}, {meant}{without_times(motion) if timed and not found.times else ''}")
    if found.times and motion.times[0] != 0:
        start = f"begins at {motion.times[0]:g} s; other programs' files are taken to begin where the scene does"
        console.warn(f"{out.name}: {start}")
    return meant


def without_times(motion: Motion) -> str:
    """What to say where a format has no times."""
    steps = motion.times[1:] - motion.times[:-1]
    if not len(steps):
        return ""
    if steps.max() - steps.min() > UNEVEN * steps.max():
        return "; it has no times, and those of the frames are uneven: they are lost"
    return f"; it has no times: there are {len(steps) / (motion.times[-1] - motion.times[0]):.6g} frames a second"


PLACE = re.compile(r"(top level|line \d+, column \d+|(?:[\w.\[\]]|\"[^\"]*\")+): (.*)", re.DOTALL)
"""Where something is wrong, before what is."""

OF_SCENES = "make it again with new --scale {}"
"""What to do with a scene that has another unit."""

STRETCH_ADVICE = "the motion is not to be believed unless they are that soft; try a smaller delta"


FORCES = "--forces FILE", "Let the forces of this file act on the cloths, as clothfit control writes them."
forces = option(*FORCES, name="forces_path")
with_forces = setting(*FORCES, name="forces_path")
"""Of commands that simulate: an option, or a setting."""


def read_scene(path: str, console: Console) -> Scene:
    """Load a scene from a path or standard input, and pass its warnings on."""
    check_there(path)
    import clothfit
    from clothfit.base.deferred import defer

    defer()
    try:
        scene = clothfit.load(sys.stdin.buffer if path == STREAM else path)
    except InvalidScene as error:
        raise better(error, path) from None
    console.warn(*scene.warnings, *doubts_of_time(scene.delta, scene.gravity.tolist()), *unlikely(scene), of=scene.name)
    console.detail(f"{scene.name}: {len(scene.cloths)} objects, {sum(scene.vertex_counts)} vertices")
    return scene


def unlikely(scene: Scene) -> list[str]:
    """Doubts about the units of its objects."""
    found = []
    for index, cloth in enumerate(scene.cloths):
        size = (cloth.positions.max(axis=0) - cloth.positions.min(axis=0)).tolist()
        found += [f"objects[{index}]: {each}" for each in doubts(size, float(cloth.mass.sum()), OF_SCENES)]
    return found


def under_forces(scene: Scene, path: str | None, feedback: bool = False) -> Scene:
    """The scene with the forces of a file, where there is one, and their feedback. Raises InvalidInput."""
    if path is None:
        return scene
    from clothfit.scene.forces import load_forces

    return scene.with_forces(load_forces(path, sum(scene.vertex_counts), feedback))


def better(error: InvalidScene, path: str) -> InvalidScene:
    """The error of a file that was read as a scene, or what the file is where it cannot be meant as one."""
    from clothfit.formats.registry import no_scene, suffix_of

    found = None if path == STREAM else no_scene(path, suffix_of(path))
    return error if found is None else InvalidScene(found, error.name)


def split(sentence: str) -> dict[str, str | None]:
    """Place and message of a problem; no place where it is the file as a whole."""
    match = PLACE.fullmatch(sentence)
    return {"place": match[1], "message": match[2]} if match else {"place": None, "message": sentence}


def check_there(*paths: str) -> None:
    """Check that the files exist, before the libraries load. Raises InvalidScene."""
    for path in paths:
        if not path:
            raise InvalidInput("the name of a file is empty; name one")
        try:
            with suppress(ValueError):  # an impossible name; reading it gives the message
                if path != STREAM:
                    os.stat(path)
        except OSError as error:
            raise InvalidScene(unreadable(error), name_of(path)) from None


def frames_of(steps: int | None, scene: Scene) -> int:
    """Number of frames for --steps. Raises InvalidInput when it is not positive."""
    check_numbers(steps)
    return scene.frames if steps is None else steps + 1


def one_stream(*paths: str | None) -> None:
    """Raise InvalidInput when standard input would be read twice."""
    if sum(path == STREAM for path in paths) > 1:
        raise InvalidInput("standard input (-) can be only one of the inputs")


def warn_of_steps(scene: Scene, frames: int, console: Console) -> None:
    """Warn, before the simulation, when explicit or symplectic steps will not stay stable, and of what starts inside
    of something.
    """
    from clothfit.engine.stability import warning
    from clothfit.engine.starts import sentences

    sentence = warning(scene, frames - 1)
    if sentence:
        console.warn(sentence)
    console.warn(*sentences(scene), of=scene.name)


def warn_of_energy(scene: Scene, motion: Motion, console: Console, energy: Energy | None = None) -> None:
    """Warn when steps have given cloths energy where they touch something."""
    from clothfit.motion.energy import faults

    console.warn(*faults(scene, motion, energy))


def warn_of_stretch(scene: Scene, motion: Motion, console: Console) -> None:
    """Warn when a simulated motion is finite but ends in a state that cannot be right."""
    from clothfit.motion.divergence import overstretched, overstretched_from

    for index in range(len(scene.cloths)):
        begins = overstretched_from(scene, index, motion.of(index))
        if begins is not None:
            console.warn(f"{scene.name}: objects[{index}]: {overstretched(begins)}; {STRETCH_ADVICE}")


# ---- Inputs over time from a file, in place of those of a scene.

def with_inputs(scene: Scene, path: str | None) -> Scene:
    """The scene with the inputs of a file. Raises InvalidInput."""
    if path is None:
        return scene
    from clothfit.subspace.inputs import applied, load

    check_there(path)
    return applied(scene, load(path), str(Path(path).parent), path)


def vector(values: Sequence[float]) -> str:
    """Three components, for people; -0 is 0."""
    return f"({', '.join(f'{value + 0.0:.4g}' for value in values)})"
