"""`clothfit report`: a page, a picture or an animation that shows a fitted scene."""

from __future__ import annotations

import hashlib
import os
import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import click

from clothfit.base.messages import counted, metres
from clothfit.cli.common import motions, pictures
from clothfit.cli.common.console import Console
from clothfit.cli.common.motions import check_there, frames_of, one_stream, read_scene, under_forces, warn_of_steps
from clothfit.cli.common.options import Setting, check_numbers, option, section, standard_command
from clothfit.cli.common.output import PAGE, STREAM, Output, attributes, output_for, print_json

if TYPE_CHECKING:
    from clothfit.formats.axes import Reading
    from clothfit.motion.motion import Motion
    from clothfit.report.log import Log
    from clothfit.report.showing import View
    from clothfit.scene.scene import Scene

Origin: TypeAlias = tuple[Sequence[str], Sequence[tuple[str, str]]]
"""Of a page: the commands that make it, and name and SHA-256 of each input."""

SILENT = ("quiet", "verbose", "as_json")
"""Parameters of a command that change no result."""


@standard_command("report")
@click.argument("scene_path", metavar="SCENE")
@click.argument("fitted_paths", metavar="FITTED...", nargs=-1, required=True)
@section("What to show")
@option("--target MOTION", "Compare with this motion instead of SCENE's own.", name="target_path")
@option("--steps N", "Show N steps.  [default: 499, fewer for large scenes, but at least the fitted ones]", int)
@motions.with_forces
@option("--log FILE", "Show the course of the fit and its intervals, from a log of estimate --log; may be repeated, in "
        "the order of the fits.", name="log_paths", multiple=True)
@section("The file of the target")
@motions.reads
@section("What is written")
@option("-o --output FILE", "File of the page, or of a picture (.png, .svg, .pdf) or an animation (.gif).  [default: "
        "<stem of the first FITTED>.report.html]", name="path")
def command(
    scene_path: str, fitted_paths: tuple[str, ...], target_path: str | None, reading: Reading, steps: int | None,
    forces_path: str | None, log_paths: tuple[str, ...], path: str | None, console: Console,
) -> None:
    """Write a page that plays FITTED over SCENE, or over a target motion, in 3-D, with charts; or draw it.

    The page is one HTML file and needs no network. Open it in a browser. It plays the motion before the fit beside the
    fitted one: with --target that of SCENE, else what a log tells. Several fits of one target stand side by side; the
    charts of values show the first.

    \b
    clothfit report scene.json scene.fitted.json
    clothfit report scene.json scene.fitted.json --target capture.npz -o page.html
    clothfit report scene.json scene.fitted.json --log fit.jsonl
    clothfit report scene.json one.json two.json --target capture.npz -o both.html
    clothfit report scene.json scene.fitted.json --target capture.npz -o fit.gif
    """
    one_stream(scene_path, *fitted_paths, target_path)
    check_numbers(steps)
    check_there(scene_path, *fitted_paths)
    if len(log_paths) > len(fitted_paths):
        raise click.UsageError(f"{len(log_paths)} logs for {counted(len(fitted_paths), 'fit', 'fits')} are given")
    first, *rest = fitted_paths
    inputs = (scene_path, *rest, target_path, forces_path, *log_paths)
    picture = pictures.named(path)
    if picture is None:
        out = output_for(path, first, ".report.html", inputs, text=PAGE)
    elif rest:
        raise click.UsageError("a picture shows one fit; name a page, .html, for several")
    else:
        picture.check(first, *inputs)
    truth = under_forces(read_scene(scene_path, console), forces_path)
    fitted, *others = [under_forces(read_scene(each, console), forces_path) for each in fitted_paths]
    readings: list[dict[str, Any]] = []
    target = motions.read_motion(target_path, truth, reading, console, readings) if target_path is not None else None
    logs = read_logs(log_paths, truth, target is not None, len(fitted_paths))
    for each in (truth, fitted, *others) if target is None else (fitted, *others):
        warn_of_steps(each, truth.frames, console)
    console.announce_compilation()
    frames = None if steps is None else frames_of(steps, truth)
    if picture:
        picture.fitted(truth, fitted, target, frames or truth.frames, logs[0], console)
        print_json({"output": path} | motions.readings_summary(readings))
        return
    same = evaluation(scene_path, first, target_path, reading, forces_path)
    files = {target_path: target, **dict.fromkeys((forces_path, *log_paths))}
    origin = [same, command_line(click.get_current_context())], digests([truth, fitted, *others], files)
    show, size = write_page(truth, [fitted, *others], target, frames, logs, origin, out)
    show_result(show, size, out, console, show.evaluation.diverged)
    print_json(summary(show, size, out) | motions.readings_summary(readings))
    if show.evaluation.diverged:
        from clothfit.motion.divergence import Diverged

        raise Diverged(f"{show.evaluation.diverged}; the frames before are shown", len(show.times))


def write_page(
    truth: Scene, fits: Sequence[Scene], target: Motion | None, frames: int | None, logs: Sequence[Log], origin: Origin,
    out: Output,
) -> tuple[View, int]:
    """Make the page of one fit, with others beside it, and write it; tells what it shows, and its size, bytes."""
    from clothfit.report.contents import content
    from clothfit.report.page import companions, page
    from clothfit.report.showing import view

    fitted, *others = fits
    log, *other_logs = logs
    show = view(truth, fitted, target, frames, others=companions(log, others))
    made = page(content(truth, fitted, show, log, None if target is None else target.name, other_logs), *origin)
    out.write(made)
    return show, len(made)


def put(page: bytes, out: Output, console: Console) -> None:
    """Write a page, and say so."""
    out.write(page)
    console.say(f"page, {len(page) / 1e6:.2g} MB → {out.name}")


def read_logs(paths: Sequence[str], truth: Scene, has_target: bool, count: int) -> list[Log]:
    """The logs of so many fits, empty ones where none is given. The first knows where its fit began: with the values of
    the scene where it has a target, unless it says otherwise.
    """
    from clothfit.report.log import Log, read_log, start_of

    found = [read_log(path) for path in paths]
    first, *rest = [*found, *(Log() for _ in range(count - len(found)))]
    start = start_of(first.summary, truth)
    return [replace(first, start=truth if start is None and has_target else start), *rest]


def show_result(show: View, size: int, out: Output, console: Console, said: str | None = None) -> None:
    """Tell what was written, and what is to be known of it; not what will be `said` as the command's error."""
    for sentence in show.notes:
        if said is None or not sentence.startswith(said):
            console.warn(sentence)
    frames = counted(len(show.times), "frame", "frames")
    console.say(f"{frames}, RMSE {metres(show.evaluation.fitted.rmse)}, {size / 1e6:.2g} MB → {out.name}")


def summary(show: View, size: int, out: Output) -> dict[str, Any]:
    """What --json prints."""
    found = show.evaluation
    own = {"shown": len(show.times), "notes": show.notes, "bytes": size, "output": out.path}
    return asdict(found.fitted) | attributes(found, "horizon", "diverged") | own


def command_line(context: click.Context) -> str:
    """The command of a context, with the options that were given, as a line to copy."""
    options: list[str] = []
    arguments: list[str] = []
    for parameter in context.command.get_params(context):
        name = parameter.name or ""
        value = context.params.get(name)
        if name in SILENT or value in (None, (), parameter.default) or (value is False and not parameter.default):
            continue
        values = value if isinstance(value, tuple) else (value,)
        given = [str(each) for each in values]
        if isinstance(parameter, Setting):
            options += [part for each in values for part in ("--set", parameter.assigned(each))]
        elif isinstance(parameter, click.Option):
            option = parameter.opts[0]
            options += [option] if value is True else [part for each in given for part in (option, each)]
        else:
            arguments += given
    parts = [*arguments, *options]
    if any(each.startswith("-") and each != "-" for each in arguments):
        parts = [*options, "--", *arguments]
    return shlex.join(["clothfit", context.info_name or "", *parts])


def evaluation(
    scene_path: str, fitted_path: str, target_path: str | None, reading: Reading, forces_path: str | None = None
) -> str:
    """The command that gives the same figures as a table."""
    target = [] if target_path is None else ["--target", target_path, *motions.arguments(reading)]
    forces = [] if forces_path is None else ["--forces", forces_path]
    return shlex.join(["clothfit", "evaluate", scene_path, fitted_path, *target, *forces])


def digests(scenes: Sequence[Scene], files: Mapping[str | None, object]) -> list[tuple[str, str]]:
    """Names and SHA-256 of what was read; without the files, but for scenes, that came through a pipe and are gone."""
    from clothfit.scene.scene import dumps
    from clothfit.scene.text import name_of

    found = [(scene.name, hashlib.sha256(dumps(scene)).hexdigest()) for scene in scenes]
    for path in files:
        if path not in (None, STREAM) and os.path.isfile(str(path)):
            with suppress(OSError), open(str(path), "rb") as file:
                found.append((name_of(path), hashlib.file_digest(file, "sha256").hexdigest()))
    return found
