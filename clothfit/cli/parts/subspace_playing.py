"""`clothfit subspace play`: a motion of a model, or of many instances at once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.errors import InvalidInput
from clothfit.cli.common import motions
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import length
from clothfit.cli.common.output import STREAM, Output, output_for, print_json
from clothfit.cli.common.scenes import with_inputs
from clothfit.formats.axes import Convention

if TYPE_CHECKING:
    from clothfit.scene.scene import Scene
    from clothfit.subspace.crowd import Crowded
    from clothfit.subspace.model import Model


def play(model_path: str, path: str | None, given: dict[str, Any], as_json: bool, console: Console) -> None:
    """Play a model."""
    if model_path == STREAM:
        raise InvalidInput("MODEL must be a file; - was given")
    if given["instances"] is not None and given["push_out"] is not None:
        raise click.UsageError("--push-out does not go with --instances", click.get_current_context())
    if given["instances"] is not None and given["coordinates"] is not None:
        raise click.UsageError("--coordinates does not go with --instances", click.get_current_context())
    from clothfit.base import threads
    from clothfit.subspace.model import load_model

    model = load_model(model_path)
    scene = with_inputs(model.scene(), given["inputs_path"])
    frames = given["frames"] or scene.frames
    with threads.single():
        if given["instances"] is None:
            play_one(model, scene, frames, model_path, path, given, as_json, console)
        else:
            play_many(model, scene, frames, model_path, path, given, as_json, console)


def play_one(
    model: Model, scene: Scene, frames: int, model_path: str, path: str | None, given: dict[str, Any], as_json: bool,
    console: Console,
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
    if as_json:
        found = {"frames": frames, "us_per_frame": each, "clamped": played.clamped, "output": out.path}
        print_json("subspace", found, out)


def coordinates_for(path: str | None, used: tuple[str | None, ...]) -> Output | None:
    """Where the coordinates go. Raises InvalidInput."""
    if path is None:
        return None
    if path == STREAM or not path.lower().endswith(".npz"):
        raise InvalidInput(f"--coordinates must be a file .npz; {path} was given")
    return output_for(path, "", "", used)


def play_many(
    model: Model, scene: Scene, frames: int, model_path: str, path: str | None, given: dict[str, Any], as_json: bool,
    console: Console,
) -> None:  # fmt: skip
    """Play many instances, say how long a frame of one takes, and write their motions where that is asked for."""
    from clothfit.subspace import crowd

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
    scenes = crowd.varied(model, scene, count, frames, given["seed"] or 0)
    found = crowd.play(model, scenes, frames)
    for sentence in found.clamped:
        console.warn(sentence)
    for i, out in enumerate(outs):
        motions.write(crowd.motion(model, scenes[i], found, i), out, scenes[i], Convention(), console)
    show_many(found, count, frames, console)
    if as_json:
        done = {"frames": frames, "instances": count, "us_per_frame": found.us, "clamped": found.clamped}
        print_json("subspace", done | {"outputs": [out.path for out in outs]})


def show_many(found: Crowded, count: int, frames: int, console: Console) -> None:
    """Say what a frame of one of many instances takes."""
    parts = ", ".join(f"{name} {value:.0f} µs" for name, value in found.us.items())
    whole = sum(found.us.values())
    console.result(f"{count} instances, {frames} frames: a frame of each takes {whole:.0f} µs: {parts}")
    console.result(f"a frame of all of them takes {1e-3 * count * whole:.3g} ms, on one thread")
