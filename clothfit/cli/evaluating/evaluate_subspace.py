"""`clothfit evaluate SCENE MODEL`: how far a subspace is from the full simulation, and what both cost."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from clothfit.base.messages import metres
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import print_json
from clothfit.cli.common.scenes import frames_of, read_scene

if TYPE_CHECKING:
    from clothfit.subspace.judge import Judgement


NORMALS = {"faces": "(of the faces)", "regression": "(by regression)"}
NAMES = {"regression": "(normals by regression)"}

ROUNDING = 1e-9
"""Relative energy that is none."""


def measure(
    scene_path: str, model_path: str, inputs_path: str | None, steps: int | None, as_json: bool, console: Console
) -> None:
    """Compare a model with the scene's own simulation."""
    from clothfit.cli.subspaces.inputs import with_inputs
    from clothfit.subspace.judge import judge
    from clothfit.subspace.model import load_model

    model = load_model(model_path)
    scene = with_inputs(read_scene(scene_path, console), inputs_path)
    console.announce_compilation()
    found = judge(model, scene, frames_of(steps, scene))
    for sentence in found.clamped:
        console.warn(sentence)
    if as_json:
        print_json("evaluate", asdict(found) | {"forgets": found.forgets})
    else:
        show(found, console)


def show(found: Judgement, console: Console) -> None:
    """Print the judgement as tables."""
    console.table([("frames", "RMSE until then"), *((str(end), metres(error)) for end, error in found.over_time)])
    console.result(f"{100 * found.relative_rmse:.2g} % of the motion's RMS, {metres(found.max_error)} at most")
    if found.forgets:
        console.result(
            "the two motions have parted: compare their spectra and deviations, not their points: spectrum within "
            f"{100 * found.spectrum:.2g} %, standard deviations of the vertices within {100 * found.deviation:.2g} %"
        )
    console.result(
        f"drift {metres(found.drift)} in the last fifth; stored energy within {100 * found.energy:.2g} %, "
        + (f"at most {100 * found.energy_gain:.2g} % more than was given" if found.energy_gain > ROUNDING
           else "never more than was given")
    )  # fmt: skip
    parts = [f"{value:.2g}° {NORMALS[name]}" for name, value in found.normals.items()]
    if parts:
        console.result(f"normals off by {', '.join(parts)}")
    whole = found.us_whole
    rows = [(NAMES.get(name, name), f"{value:.0f} µs") for name, value in found.us_per_frame.items()]
    console.table([("a frame", "time"), *rows, ("together", f"{whole:.0f} µs"),
                   ("a full step", f"{found.full_us_per_step:.0f} µs")])  # fmt: skip
    console.result(f"{found.megabytes:.2g} MB; {found.full_us_per_step / whole:.2g} times as fast as full steps")
    if whole >= found.full_us_per_step:
        console.warn("the subspace does not pay: a frame of it takes longer than a full step")
