"""`clothfit evaluate SCENE MODEL`: how far a subspace is from the full simulation, and what both cost."""

from __future__ import annotations

import os
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING

import click

from clothfit.base.messages import metres
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import Output, page_beside, print_json
from clothfit.cli.common.pictures import Pictures
from clothfit.cli.common.scenes import check_there, frames_of, read_scene

if TYPE_CHECKING:
    from clothfit.subspace.judge import Compared, Judgement

NORMALS = {"faces": "(of the faces)", "regression": "(by regression)"}
NAMES = {"regression": "(normals by regression)"}

ROUNDING = 1e-9
"""Relative energy that is none."""


def measure(
    scene_path: str, model_path: str, inputs_path: str | None, steps: int | None, pictures: Pictures,
    page_path: str | None, as_json: bool, console: Console,
) -> None:  # fmt: skip
    """Compare a model with the scene's own simulation."""
    from clothfit.cli.common.scenes import with_inputs
    from clothfit.subspace.judge import compare
    from clothfit.subspace.model import load_model

    check_there(scene_path, model_path)
    pictures.check(scene_path, model_path, inputs_path, page_path)
    page = page_beside(page_path, (scene_path, model_path, inputs_path, *pictures.files))
    model = load_model(model_path)
    scene = with_inputs(read_scene(scene_path, console), inputs_path)
    console.announce_compilation()
    over = compare(model, scene, frames_of(steps, scene))
    for sentence in over.found.clamped:
        console.warn(sentence)
    if as_json:
        print_json("evaluate", asdict(over.found) | {"forgets": over.found.forgets})
    else:
        show(over.found, console)
    draw(over, model_path, inputs_path, pictures, page, console)


def draw(
    over: Compared, model_path: str, inputs_path: str | None, pictures: Pictures, page: Output | None, console: Console
) -> None:
    """Write the pictures and the page that are asked for."""
    if pictures.plot is not None:
        from clothfit.pictures import picture_file as picture
        from clothfit.pictures import plots

        picture.save(pictures.plot, partial(plots.comparison, over))
        console.say(f"picture → {pictures.plot}")
    pictures.animated(over.scene, over.full.times, over.own.positions, over.full.positions, console)
    if page is not None:
        from clothfit.cli import report
        from clothfit.report.page import subspace_page

        files: dict[str | None, object] = dict.fromkeys((model_path, inputs_path))
        origin = [report.command_line(click.get_current_context())], report.digests([over.scene], files)
        made = subspace_page(over, os.path.basename(model_path), *origin)
        page.write(made)
        console.say(f"page, {len(made) / 1e6:.2g} MB → {page.name}")


def show(found: Judgement, console: Console) -> None:
    """Print the judgement as tables."""
    console.table([("frames", "RMSE until then"), *((str(end), metres(error)) for end, error in found.over_time)])
    console.result(f"{100 * found.relative_rmse:.2g} % of the motion's RMS, {metres(found.max_error)} at most")
    if found.chaotic:
        console.result(
            f"a small difference at the start grows {found.growth:.2g}-fold in the full simulation, and so does what a "
            "basis leaves out"
        )
    if found.forgets:
        console.result(
            f"the two motions have parted: compare their spectra and deviations, not their points: spectrum within "
            f"{100 * found.spectrum:.2g} %, standard deviations of the vertices within {100 * found.deviation:.2g} %"
        )
    if found.floor:
        from clothfit.subspace.judge import at_best

        console.result(at_best(found.floor))
    gain = "never more than was given"
    if found.energy_gain > ROUNDING:
        gain = f"at most {100 * found.energy_gain:.2g} % more than was given"
    energy = f"stored energy within {100 * found.energy:.2g} %, {gain}"
    console.result(f"drift {metres(found.drift)}, of the mean shape in the last fifth; {energy}")
    parts = [f"{value:.2g}° {NORMALS[name]}" for name, value in found.normals.items()]
    if parts:
        console.result(f"normals off by {', '.join(parts)}")
    rows = [(NAMES.get(name, name), f"{value:.0f} µs") for name, value in found.us_per_frame.items()]
    console.table([("a frame", "time"), *rows, ("together", f"{found.us_whole:.0f} µs"),
                   ("a full step", f"{found.full_us_per_step:.0f} µs")])  # fmt: skip
    faster = found.full_us_per_step / found.us_whole
    console.result(f"{found.megabytes:.2g} MB; {faster:.2g} times as fast as full steps")
    if faster <= 1.0:
        console.warn("the subspace does not pay: a frame of it takes longer than a full step")
