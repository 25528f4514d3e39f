"""`clothfit subspace`: record motions, build a subspace of them, play it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clothfit.base import interrupts
from clothfit.base.errors import InvalidInput
from clothfit.cli.common import motions
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import check_least, length, refuse, section, standard_command
from clothfit.cli.common.output import STREAM, Output, output_for, print_json
from clothfit.cli.common.scenes import check_there, one_stream, read_scene, with_inputs
from clothfit.formats.axes import Convention, Reading

if TYPE_CHECKING:
    from clothfit.scene.scene import Scene
    from clothfit.subspace.inputs import Ranges
    from clothfit.subspace.model import Model
    from clothfit.subspace.play import Crowded

TRAINING = ("minutes", "rounds", "resume")
EPISODES, OF_SMALL, MANY_EPISODES = 9, 25, 41
"""Motions, those of small cloths, and those that a network learns from."""

FRAMES, IN_WIND = 300, 900
"""Of each motion, and of small cloths that may flutter in a steady wind: how they go on differs from how they begin."""

SMALL = 1000
"""Vertices of all cloths up to which motions take little time."""

ONLY = {
    "record": {"episodes", "frames", "wind", "pins", "pace", "seed", "motions", "fps"},
    "build": {"episodes", "frames", "wind", "pins", "pace", "seed", "basis", "error", "cubature", "modes", "method",
              "normals", "half", *TRAINING},
    "play": {"frames", "inputs_path", "push_out", "instances", "seed", "coordinates"},
}


@standard_command("subspace")
@click.argument("action", metavar="record|build|play", type=click.Choice(tuple(ONLY)))
@click.argument("subspace_path", metavar="SCENE|DATA|MODEL")
@section("What to record (record, and build from a SCENE)")
@click.option("--episodes", type=int, metavar="N",
              help=f"Record N motions; the last one judges.  [default: {OF_SMALL} up to {SMALL} vertices, "
              f"else {EPISODES}; {MANY_EPISODES} for a network]")
@click.option("--frames", type=int, metavar="N",
              help=f"Frames of each motion.  [default: {FRAMES}, {IN_WIND} of small cloths held in a steady wind; "
              "to play those of the scene]")
@click.option("--wind", type=float, metavar="SPEED",
              help="Gusts up to this speed along each axis, m/s.  [default: a push of a quarter of the weight]")
@click.option("--pins", type=float, metavar="METRES", help="Move all fixed vertices at random so far.  [default: 0]")
@click.option("--pace", type=float, metavar="FACTOR",
              help="What moves in the scene does so up to this much faster or slower.  [default: 1.25]")
@click.option("--seed", type=int, metavar="S", help="Seed of all that is random.  [default: 0]")
@click.option("--motion", "motions", multiple=True, metavar="M[@INPUTS]",
              help="Take motions of other programs instead, with the inputs over time (JSON) that moved them; may be "
              "repeated. The last one judges.")
@click.option("--fps", type=float, metavar="F", help="Frames per second of their files.  [default: their times]")
@section("What to build (build)")
@click.option("--basis", type=int, metavar="R", help="Number of vectors.  [default: 64, or as --error needs]")
@click.option("--error", metavar="LENGTH", help="Take as many vectors as leave out no more, such as 5mm.")
@click.option("--cubature", type=float, metavar="ERROR",
              help="Relative error of the forces' sums; 0 evaluates all elements.  "
              "[default: from 0.08 down to 0.01, as needed]")
@click.option("--modes", type=int, metavar="N",
              help="So many of the vectors are vibration modes.  [default: one in sixteen]")
@click.option("--method", type=click.Choice(("physics", "network")),
              help="How the coordinates step: as the scene does, on the basis, or by a network that learns it from the "
              "motions.  [default: physics]")
@click.option("--normals", is_flag=True, default=None,
              help="Keep a regression of the vertices' normals on the coordinates.")
@click.option("--half", is_flag=True, default=None, help="Store the vectors in half precision: half the file.")
@section("How to train (build --method network)")
@click.option("--minutes", type=float, metavar="M", help="Processor time of the training.  [default: 10]")
@click.option("--rounds", type=int, metavar="N",
              help="Rounds of the training in place of --minutes: the same network on every machine, but for rounding.")
@click.option("--resume", is_flag=True, default=None,
              help="Go on with the training whose state is beside OUT, <OUT's stem>.training.npz.")
@section("What to play (play)")
@click.option("--inputs", "inputs_path", metavar="FILE", help="Play with these inputs over time (JSON).")
@click.option("--push-out", metavar="LENGTH",
              help="Push vertices out of the scene's obstacles, so far from them, such as 0 or 2mm.")
@click.option("--coordinates", metavar="FILE",
              help="Write the coordinates of each object here, for players that decode them (.npz).")
@click.option("--instances", type=int, metavar="N",
              help="Play N instances at once, in random gusts within the recorded range, and say how long a frame of "
              "one takes; motions are written with -o only.")
@section("What is written")
@click.option("-o", "--output", "path", metavar="OUT",
              help="File of the data, the model or the motion.  [default: <stem>.data.npz, .model.npz, .played.npz]")
def command(action: str, subspace_path: str, path: str | None, console: Console, **given: Any) -> int | None:
    """Play the cloths of a scene in a subspace of their motions: large ones many times faster.

    record simulates SCENE under random inputs and writes DATA; build makes a MODEL of it, or of a SCENE at once; play
    moves MODEL. How far a model is from the full simulation says clothfit evaluate SCENE MODEL.

    \b
    clothfit subspace build scene.json -o scene.model.npz
    clothfit subspace play scene.model.npz --inputs gusts.json --frames 1000 -o motion.npz
    clothfit evaluate scene.json scene.model.npz
    clothfit subspace record scene.json --episodes 20 --wind 8 -o data.npz
    clothfit subspace record scene.json --motion a.abc@a.json --motion b.abc@b.json -o data.npz
    clothfit subspace build data.npz --error 5mm
    clothfit subspace build scene.json --method network --minutes 5
    """
    given["motions"] = given["motions"] or None
    for name, value in given.items():
        if value is not None and name not in ONLY[action]:
            option = "--" + {"motions": "motion"}.get(name, name.removesuffix("_path").replace("_", "-"))
            raise click.UsageError(f"{option} does not go with {action}", click.get_current_context())
    check_least(1, frames=given["frames"], instances=given["instances"])
    check_least(2, episodes=given["episodes"])
    check_least(0, modes=given["modes"], seed=given["seed"])
    one_stream(subspace_path, given["inputs_path"])
    check_there(subspace_path)
    actions: dict[str, Callable[..., int | None]] = {"record": record, "build": build, "play": play}
    return actions[action](subspace_path, path, given, console)


def ranges_of(scene: Scene, given: dict[str, Any]) -> Ranges:
    """The ranges that are asked for. Raises InvalidInput."""
    from clothfit.subspace.inputs import Ranges, gentle_wind

    wind = gentle_wind(scene) if given["wind"] is None else given["wind"]
    pace = 1.25 if given["pace"] is None else given["pace"]
    found = Ranges(wind, given["pins"] or 0.0, pace)
    found.check()
    return found


def lengths(scene: Scene) -> tuple[int, int]:
    """How many motions of a scene are recorded, and frames of each."""
    if sum(scene.vertex_counts) > SMALL:
        return EPISODES, FRAMES
    held = all(cloth.fixed.any() for cloth in scene.cloths)
    flutters = held and scene.wind.any() and not scene.moves and not scene.obstacles
    return OF_SMALL, IN_WIND if flutters else FRAMES


def recorded(scene: Scene, path: str, given: dict[str, Any], console: Console) -> dict[str, Any]:
    """Record motions of a scene to a file, and say what they are; the summary."""
    from clothfit.engine.system import build as build_system
    from clothfit.subspace.inputs import episodes
    from clothfit.subspace.physics.samples import check
    from clothfit.subspace.recording import record as record_to

    many, frames = lengths(scene)
    if given["method"] == "network":
        many, frames = MANY_EPISODES, FRAMES
    ranges, count = ranges_of(scene, given), given["episodes"] or many
    steps, seed = (given["frames"] or frames) - 1, given["seed"] or 0
    for c in range(len(scene.cloths)):
        check(build_system(scene, c, steps=1))
    console.announce_compilation()
    own = episodes(scene, ranges, count, max(steps, 1) * scene.delta, seed)
    with interrupts.heard():
        found = record_to(scene, own, ranges, steps, path, lambda done, _: console.detail(f"{done} motions"))
    gusts = f"wind up to {ranges.wind:g} m/s"
    console.say(f"{count} motions of {steps + 1} frames, {gusts}: {found.frames} frames are kept")
    if found.left_out:
        console.warn(f"{found.left_out} frames are left out, of steps that were shortened or clamped, or that never "
                     f"came; {found.diverged} motions diverged")
    return asdict(found) | {"episodes": count, "ranges": asdict(ranges), "seed": seed}


def record(scene_path: str, path: str | None, given: dict[str, Any], console: Console) -> None:
    """Record motions of a scene."""
    scene = read_scene(scene_path, console)
    out = output_for(path, scene_path, ".data.npz", ())
    if out.is_stream:
        raise InvalidInput("-o must be a file; - was given")
    if given["motions"]:
        found = collected(scene, out.path, given, console)
    else:
        found = recorded(scene, out.path, given, console)
    console.say(f"→ {out.path}")
    print_json(found | {"output": out.path})


def build(given_path: str, path: str | None, given: dict[str, Any], console: Console) -> int | None:
    """Build a model of recorded motions, or of a scene."""
    from clothfit.cli.parts.subspace_building import built, options_of, school_of
    from clothfit.formats.registry import RECORDED, SUBSPACE, kind_of

    kind = None if given_path == STREAM else kind_of(given_path)
    if kind == SUBSPACE:
        raise InvalidInput(f"{given_path} is a subspace already; name a scene, or recorded motions")
    options = options_of(given)
    options.check()
    out = output_for(path, given_path, ".model.npz", ())
    school = school_of(given, out)
    from clothfit.subspace.recording import Data

    if kind == RECORDED:
        asked = [f"--{name}" for name in ONLY["record"] if name != "seed" and given[name] is not None]
        if asked:
            raise click.UsageError(f"{min(asked)} goes with a SCENE", click.get_current_context())
        return built(Data(given_path), options, school, out, {}, console)
    scene = read_scene(given_path, console)
    with tempfile.TemporaryDirectory(prefix="clothfit-", dir=None if out.is_stream else Path(out.path).parent) as place:
        data = f"{place}/data.npz"
        about = recorded(scene, data, given, console)
        return built(Data(data), options, school, out, about, console)


# ---- `clothfit subspace record --motion`: motions of other programs as what a subspace is built of.

RANDOM = ("episodes", "frames", "wind", "pins", "pace", "seed")
"""What says how motions are made at random."""


def collected(scene: Scene, path: str, given: dict[str, Any], console: Console) -> dict[str, Any]:
    """Write the motions that are named to a file, and say what they are; the summary. Raises InvalidInput, UsageError.
    """
    from clothfit.cli.parts.estimate_files import motion_and_scene
    from clothfit.subspace.recording import collect, episode

    refuse({f"--{name}": given[name] for name in RANDOM}, "{} makes motions at random; it does not go with --motion")
    if len(given["motions"]) < 2:
        raise InvalidInput("--motion: name two motions at least; the last one is not learned from, but judges")
    reading, taken = Reading(fps=given["fps"]), []
    for name, inputs in map(motion_and_scene, given["motions"]):
        for each in (name, inputs):
            if each is not None:
                check_there(each)
        own = episode(scene, inputs)
        taken.append((motions.read(name, scene, reading, console), own))
    found = collect(scene, taken, path)
    console.say(f"{len(taken)} motions: {found.frames} frames are kept")
    if found.left_out:
        console.warn(f"{found.left_out} frames are left out, which do not show all vertices")
    return asdict(found) | {"episodes": len(taken)}


# ---- `clothfit subspace play`: a motion of a model, or of many instances at once.

def play(model_path: str, path: str | None, given: dict[str, Any], console: Console) -> None:
    """Play a model."""
    if model_path == STREAM:
        raise InvalidInput("MODEL must be a file; - was given")
    if given["instances"] is not None:
        alone = {"--push-out": given["push_out"], "--coordinates": given["coordinates"]}
        refuse(alone, "{} does not go with --instances")
    from clothfit.base import threads
    from clothfit.subspace.model import load_model

    model = load_model(model_path)
    scene = with_inputs(model.scene(), given["inputs_path"])
    frames = given["frames"] or scene.frames
    with threads.single():
        if given["instances"] is None:
            play_one(model, scene, frames, model_path, path, given, console)
        else:
            play_many(model, scene, frames, model_path, path, given, console)


def play_one(
    model: Model, scene: Scene, frames: int, model_path: str, path: str | None, given: dict[str, Any], console: Console,
) -> None:  # fmt: skip
    """Play one instance, and write its motion."""
    import numpy as np

    from clothfit.base import npz
    from clothfit.subspace.play import play as play_model

    distance = length(given["push_out"], "--push-out")
    out = output_for(path, model_path, ".played.npz", (given["inputs_path"],))
    kept = coordinates_for(given["coordinates"], (model_path, given["inputs_path"], out.path))
    motions.check(out, Convention(), (model_path,), frames)
    console.announce_compilation()
    played = play_model(model, scene, frames, distance)
    for sentence in played.clamped:
        console.warn(sentence)
    motions.write(played.motion, out, scene, Convention(), console)
    if kept is not None:
        kept.write(npz.archive({f"q{c}": q.astype(np.float32) for c, q in enumerate(played.coordinates)}))
    each = {name.replace(" ", "_"): 1e6 * s / max(frames - 1, 1) for name, s in played.seconds.items()}
    console.say(f"{frames} frames, {each['state']:.0f} µs a step → {out.name}")
    found = {"frames": frames, "us_per_frame": each, "clamped": played.clamped, "output": out.path}
    print_json(found)


def coordinates_for(path: str | None, used: tuple[str | None, ...]) -> Output | None:
    """Where the coordinates go. Raises InvalidInput."""
    if path is None:
        return None
    if path == STREAM or not path.lower().endswith(".npz"):
        raise InvalidInput(f"--coordinates must be a file .npz; {path} was given")
    return output_for(path, "", "", used)


def play_many(
    model: Model, scene: Scene, frames: int, model_path: str, path: str | None, given: dict[str, Any], console: Console,
) -> None:  # fmt: skip
    """Play many instances, say how long a frame of one takes, and write their motions where that is asked for."""
    from clothfit.subspace.play import instances, motion_in, play_all

    count, names = given["instances"], []
    if path == STREAM:
        raise InvalidInput("-o must be a file; - was given")
    if path is not None:
        width = len(str(count))
        names = [str(Path(path).with_stem(f"{Path(path).stem}-{i + 1:0{width}d}")) for i in range(count)]
    outs = [output_for(name, model_path, "", (given["inputs_path"],)) for name in names]
    for out in outs:
        motions.check(out, Convention(), (model_path,), frames)
    console.announce_compilation()
    scenes = instances(model, scene, count, frames, given["seed"] or 0)
    found = play_all(model, scenes, frames)
    for sentence in found.clamped:
        console.warn(sentence)
    for i, out in enumerate(outs):
        motions.write(motion_in(model, scenes[i], found, i), out, scenes[i], Convention(), console)
    show_many(found, count, frames, console)
    done = {"frames": frames, "instances": count, "us_per_frame": found.us, "clamped": found.clamped}
    print_json(done | {"outputs": [out.path for out in outs]})


def show_many(found: Crowded, count: int, frames: int, console: Console) -> None:
    """Say what a frame of one of many instances takes."""
    parts = ", ".join(f"{name} {value:.0f} µs" for name, value in found.us.items())
    whole = sum(found.us.values())
    console.result(f"{count} instances, {frames} frames: a frame of each takes {whole:.0f} µs: {parts}")
    console.result(f"a frame of all of them takes {1e-3 * count * whole:.3g} ms, on one thread")
