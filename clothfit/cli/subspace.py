"""`clothfit subspace`: record motions, build a subspace of them, play it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clothfit.base import interrupts, threads
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import metres
from clothfit.cli.common import motions
from clothfit.cli.common.console import Console
from clothfit.cli.common.motions import check_there, one_stream, read_scene, with_inputs
from clothfit.cli.common.options import check_least, length, option, refuse, section, setting, standard_command
from clothfit.cli.common.output import STREAM, Output, companion_file, output_for, print_json
from clothfit.formats.axes import Convention, Reading
from clothfit.many.job import INTERRUPTED

if TYPE_CHECKING:
    from clothfit.scene.scene import Scene
    from clothfit.subspace.build import Options, Report
    from clothfit.subspace.inputs import Ranges
    from clothfit.subspace.model import Model
    from clothfit.subspace.network.learn import TrainingOptions
    from clothfit.subspace.network.training import Progress
    from clothfit.subspace.recording import Data

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
@option("--episodes N", f"Record N motions; the last one judges.  [default: {OF_SMALL} up to {SMALL} vertices, else "
        f"{EPISODES}; {MANY_EPISODES} for a network]", int)
@option("--frames N", f"Frames of each motion.  [default: {FRAMES}, {IN_WIND} of small cloths held in a steady wind; "
        "to play those of the scene]", int)
@option("--wind SPEED", "Gusts up to this speed along each axis, m/s.  [default: a push of a quarter of the weight]",
        float)
@setting("--pins METRES", "Move all fixed vertices at random so far.  [default: 0]", float)
@setting("--pace FACTOR", "What moves in the scene does so up to this much faster or slower.  [default: 1.25]", float)
@setting("--seed S", "Seed of all that is random.  [default: 0]", int)
@option("--motion M[@INPUTS]", "Take motions of other programs instead, with the inputs over time (JSON) that moved "
        "them; may be repeated. The last one judges.", name="motions", multiple=True)
@setting("--fps F", "Frames per second of their files.  [default: their times]", float)
@section("What to build (build)")
@option("--basis R", "Number of vectors.  [default: 64, or as --error needs]", int)
@option("--error LENGTH", "Take as many vectors as leave out no more, such as 5mm.")
@setting("--cubature ERROR", "Relative error of the forces' sums; 0 evaluates all elements.  [default: from 0.08 down "
        "to 0.01, as needed]", float)
@setting("--modes N", "So many of the vectors are vibration modes.  [default: one in sixteen]", int)
@option("--method", "How the coordinates step: as the scene does, on the basis, or by a network that learns it from "
        "the motions.  [default: physics]", click.Choice(("physics", "network")))
@setting("--normals", "Keep a regression of the vertices' normals on the coordinates.", default=None)
@setting("--half", "Store the vectors in half precision: half the file.", default=None)
@section("How to train (build --method network)")
@setting("--minutes M", "Processor time of the training.  [default: 10]", float)
@setting("--rounds N", "Rounds of the training in place of --minutes: the same network on every machine, but for "
        "rounding.", int)
@option("--resume", "Go on with the training whose state is beside OUT, <OUT's stem>.training.npz.", default=None)
@section("What to play (play)")
@option("--inputs FILE", "Play with these inputs over time (JSON).", name="inputs_path")
@setting("--push-out LENGTH", "Push vertices out of the scene's obstacles, so far from them, such as 0 or 2mm.")
@setting("--coordinates FILE", "Write the coordinates of each object here, for players that decode them (.npz).")
@option("--instances N", "Play N instances at once, in random gusts within the recorded range, and say how long a "
        "frame of one takes; motions are written with -o only.", int)
@section("What is written")
@option("-o --output OUT", "File of the data, the model or the motion.  [default: <stem>.data.npz, .model.npz, "
        ".played.npz]", name="path")
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
    clothfit subspace build scene.json --method network --set minutes=5
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
    from clothfit.subspace.physics.samples import check_reducible
    from clothfit.subspace.recording import record as record_to

    many, frames = lengths(scene)
    if given["method"] == "network":
        many, frames = MANY_EPISODES, FRAMES
    ranges, count = ranges_of(scene, given), given["episodes"] or many
    steps, seed = (given["frames"] or frames) - 1, given["seed"] or 0
    for c in range(len(scene.cloths)):
        check_reducible(build_system(scene, c, steps=1))
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
    from clothfit.formats.registry import RECORDED, SUBSPACE, kind_of

    kind = None if given_path == STREAM else kind_of(given_path)
    if kind == SUBSPACE:
        raise InvalidInput(f"{given_path} is a subspace already; name a scene, or recorded motions")
    options = options_of(given)
    options.check()
    out = output_for(path, given_path, ".model.npz", ())
    school = training_options_of(given, out)
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
        taken.append((motions.read_motion(name, scene, reading, console), own))
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
    from clothfit.subspace.model import load_model

    model = load_model(model_path)
    scene = with_inputs(model.scene(), given["inputs_path"])
    frames = given["frames"] or scene.frames
    with threads.single():
        if given["instances"] is None:
            play_one(model, scene, frames, model_path, path, given, console)
        else:
            play_instances(model, scene, frames, model_path, path, given, console)


def play_one(
    model: Model, scene: Scene, frames: int, model_path: str, path: str | None, given: dict[str, Any], console: Console,
) -> None:  # fmt: skip
    """Play one instance, and write its motion."""
    import numpy as np

    from clothfit.base import npz
    from clothfit.subspace.play import play as play_model

    distance = length(given["push_out"], "--push-out")
    out = output_for(path, model_path, ".played.npz", (given["inputs_path"],))
    kept = companion_file("--coordinates", given["coordinates"], (model_path, given["inputs_path"], out.path), ".npz")
    motions.check_output(out, Convention(), (model_path,), frames)
    console.announce_compilation()
    played = play_model(model, scene, frames, distance)
    console.warn(*played.clamped)
    motions.write_motion(played.motion, out, scene, Convention(), console)
    if kept is not None:
        kept.write(npz.archive({f"q{c}": q.astype(np.float32) for c, q in enumerate(played.coordinates)}))
    each = {name.replace(" ", "_"): 1e6 * s / max(frames - 1, 1) for name, s in played.seconds.items()}
    console.say(f"{frames} frames, {each['state']:.0f} µs a step → {out.name}")
    print_json({"frames": frames, "us_per_frame": each, "clamped": played.clamped, "output": out.path})


def play_instances(
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
        motions.check_output(out, Convention(), (model_path,), frames)
    console.announce_compilation()
    scenes = instances(model, scene, count, frames, given["seed"] or 0)
    found = play_all(model, scenes, frames)
    console.warn(*found.clamped)
    for i, out in enumerate(outs):
        motions.write_motion(motion_in(model, scenes[i], found, i), out, scenes[i], Convention(), console)
    parts = ", ".join(f"{name} {value:.0f} µs" for name, value in found.us.items())
    whole = sum(found.us.values())
    console.result(f"{count} instances, {frames} frames: a frame of each takes {whole:.0f} µs: {parts}")
    console.result(f"a frame of all of them takes {1e-3 * count * whole:.3g} ms, on one thread")
    done = {"frames": frames, "instances": count, "us_per_frame": found.us, "clamped": found.clamped}
    print_json(done | {"outputs": [out.path for out in outs]})


# ---- `clothfit subspace build`: a model of recorded motions, by physics or by a network, and what is said of it.

POOR = 0.1
"""Error of a motion, relative to its RMS, from which on there is a warning."""

LINES = 6
"""Looks at a training for one line that is printed."""


def options_of(given: dict[str, Any]) -> Options:
    """The options of a build."""
    from clothfit.subspace.build import CUBATURES, Options

    asked = 0 if given["method"] == "network" else given["cubature"]
    cubature = CUBATURES if asked is None else (asked,) if asked else ()
    size, error, seed = given["basis"], length(given["error"], "--error"), given["seed"] or 0
    return Options(size, error, cubature, given["modes"], bool(given["normals"]), bool(given["half"]), seed)


def training_options_of(given: dict[str, Any], out: Output) -> TrainingOptions | None:
    """How to train; None for physics. Raises InvalidInput."""
    if given["method"] != "network":
        refuse({f"--{name}": given[name] for name in TRAINING}, "{} goes with --method network")
        return None
    refuse({"--cubature": given["cubature"]}, "{} does not go with --method network")
    if given["minutes"] is not None and given["rounds"] is not None:
        raise click.UsageError("--minutes and --rounds: give one of them", click.get_current_context())
    from clothfit.subspace.network.learn import TrainingOptions
    from clothfit.subspace.network.training import MINUTES, Budget

    if given["resume"] and out.is_stream:
        raise InvalidInput("--resume needs a file -o; - was given")
    budget = Budget(MINUTES if given["minutes"] is None else given["minutes"], given["rounds"])
    budget.check()
    return TrainingOptions(budget, given["seed"] or 0, state_of(out) if given["resume"] else None)


def state_of(out: Output) -> str:
    """The file of a training's state."""
    return str(Path(out.path).with_suffix("")) + ".training.npz"


def built(
    data: Data, options: Options, school: TrainingOptions | None, out: Output, about: dict[str, Any], console: Console,
) -> int | None:  # fmt: skip
    """Build a model, write it, and say how good it is."""
    from clothfit.subspace.build import build as build_model
    from clothfit.subspace.build import summary
    from clothfit.subspace.model import encoded

    console.announce_compilation()
    with threads.single(), interrupts.deferred():
        model, found = build_model(data, options, console.detail)
        ended = True
        if school:
            model, ended = trained(model, found, data, school, out, console)
        out.write(encoded(model))
    for c, each in enumerate(found):
        show(f"objects[{c}]", each, console)
        show_break_even(data.scene, c, each, model.method, console)
    console.say(f"→ {out.name}")
    more = {"training": model.built["training"]} if school else {}
    objects = [summary(each) for each in found]
    print_json({"recorded": about, "objects": objects, **more, "output": out.path})
    return None if ended else INTERRUPTED


def trained(
    model: Model, found: list[Report], data: Data, school: TrainingOptions, out: Output, console: Console
) -> tuple[Model, bool]:
    """The model with networks, and whether their training came to its end; its state is kept beside."""
    from clothfit.subspace.network.learn import identity, keep, part_trainings, train

    own = part_trainings(model, data, school)
    interrupts.hold()  # from now on there is a network to keep
    states = [each.training.state for each in own]
    if all(school.budget.done(len(own) * state.seconds, state.rounds) >= 1.0 for state in states):
        rounds = max(state.rounds for state in states)
        minutes = sum(state.seconds for state in states) / 60.0
        console.warn(f"the training has had {minutes:.2g} minutes and {rounds} rounds already; ask for more --rounds")

    def say(c: int, progress: Progress) -> None:
        text = f"objects[{c}]: {100 * progress.done:.0f} % of the training, {progress.rounds} rounds: "
        text += f"{100 * progress.error:.2g} % on motions held out, {100 * progress.best:.2g} % at best"
        looks = own[c].training.state.curve
        (console.say if len(looks) % LINES == 0 or progress.done >= 1.0 else console.detail)(text)

    made, ended = train(model, found, data, own, school, say)
    if not out.is_stream:
        keep(state_of(out), own, identity(model, data, school))
        if not ended:
            console.warn(f"interrupted: the best network so far is kept; go on with --resume ({state_of(out)})")
    return made, ended


def show_break_even(scene: Scene, c: int, found: Report, method: str, console: Console) -> None:
    """Say from how many vertices on such a model is faster than full steps."""
    from clothfit.subspace.break_even import pays_from
    from clothfit.subspace.validation import whole

    count = pays_from(scene, c, found.vectors, method, whole(found.us_per_frame), found.full_us_per_step)
    if found.pays:
        console.result(f"such a model pays from about {count} vertices on; here there are {len(scene.cloths[c].mass)}")
    else:
        console.warn(f"objects[{c}]: a subspace does not pay for so few vertices, but from about {count} on; full "
                     "steps are faster")  # fmt: skip


def show(name: str, found: Report, console: Console) -> None:
    """Say what a model of one object leaves out, evaluates and misses."""
    from clothfit.subspace.validation import whole

    console.result(f"{name}: {found.vectors} vectors")
    console.table([("vectors", "leave out"), *((str(k), metres(v)) for k, v in found.left_out.items())])
    used = ", ".join(f"{a} of {b} {kind}" for kind, (a, b) in found.elements.items() if b)
    network = not any(a for a, _ in found.elements.values())
    if not network:
        console.result(f"evaluated: {used}")
    frame, step = whole(found.us_per_frame), found.full_us_per_step
    console.result(f"a frame takes {frame:.0f} µs, with positions and normals; a full step takes {step:.0f} µs")
    second = "by the network" if network else "as evaluated"
    for what, own in (("with all elements", found.whole), (second, found.sampled)):
        if own is not None:
            console.result(f"a motion beside those, {what}: {metres(own.rmse)}, {100 * own.relative:.2g} % of its RMS")
    if found.sampled is not None and found.sampled.relative > POOR:
        console.warn(f"{name}: the subspace does not follow that motion; try more vectors (--basis), more motions "
                     "(--episodes), or weaker inputs (--wind, --pace)")  # fmt: skip
    if found.floor:
        from clothfit.subspace.validation import at_best

        console.result(at_best(found.floor))
