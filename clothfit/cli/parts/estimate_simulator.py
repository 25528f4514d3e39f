"""`clothfit estimate --simulator`: the values with which another tool's cloth moves like the target."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import metres
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import gathered, given, refuse
from clothfit.cli.common.output import STREAM, print_json, write_into
from clothfit.cli.common.scenes import read_scene
from clothfit.cli.parts.estimate_files import Files, read_target

if TYPE_CHECKING:
    from clothfit.simulators.estimate import Options
    from clothfit.simulators.values import Fitted

MODELS = {"xpbd": ("G", "L"), "blender": ("G",)}
"""The few values of a tool, or those of each constraint and vertex."""


@dataclass(frozen=True)
class Asked:
    """The options as they are given."""

    simulator: str | None = given("--simulator TOOL", "Fit the values of another tool's cloth, so that it moves like "
        "the target: xpbd, or blender, which needs Blender.")
    iterations: int | None = given("--iterations N", "Iterations of xpbd in a substep; --substeps is how many of those "
        "there are in a step.  [default: 10, and 1 substep]", int)
    bends_by: str = given("--bends-by WHAT", "Bending of xpbd: by distance, as the springs, or by angle.  [default: "
        "distance]", default="distance")
    blender: str | None = given("--blender PROGRAM", "Blender, or a Python that has it as a module.  [default: "
        "CLOTHFIT_BPY, else blender]")

    def check(self, model: str | None) -> None:
        """Raise UsageError, InvalidInput on what cannot be."""
        from clothfit.simulators.estimate import SIMULATORS

        if self.simulator is not None and self.simulator not in SIMULATORS:
            raise InvalidInput(f"--simulator: there is no {self.simulator!r}; use {' or '.join(SIMULATORS)}")
        if self.simulator != "xpbd" and (self.iterations is not None or self.bends_by != "distance"):
            raise click.UsageError("--iterations and --bends-by are for --simulator xpbd")
        if self.simulator and model not in (None, *MODELS[self.simulator]):
            known = " and ".join(MODELS[self.simulator])
            raise InvalidInput(f"--model {model}: the values of {self.simulator} are fitted by {known}")
        if self.simulator != "blender" and self.blender is not None:
            raise click.UsageError("--blender is for --simulator blender")

    def options(self, substeps: str | None, model: str | None, console: Console) -> Options:
        """What to fit in. Raises InvalidInput."""
        from clothfit.simulators import xpbd
        from clothfit.simulators.estimate import Options

        if substeps is not None and not substeps.isdigit():
            raise InvalidInput(f"--substeps must be a whole number with --simulator; {substeps!r} was given")
        iterations = 10 if self.iterations is None else self.iterations
        own = xpbd.Settings(int(substeps or 1), iterations, self.bends_by)
        own.check()
        return Options(str(self.simulator), own, self.blender, report=console.detail, model=model or "G")


options = gathered("tool", Asked)
"""Adds the options; the function is given them as `tool`."""


def fit(
    scene_paths: tuple[str, ...], files: Files, asked: Asked, substeps: str | None, model: str | None, console: Console
) -> int:
    """Fit a tool to one scene's target and write its values into a folder; returns the exit code."""
    options = asked.options(substeps, model, console)
    if len(scene_paths) != 1 or len(files.target_paths) > 1:
        raise click.UsageError("--simulator takes one SCENE and one --target")
    without = {"--start": files.start, "--checkpoint": files.checkpoint, "--forces": files.forces_path}
    refuse(without, "{} does not go with --simulator")
    (scene_path,) = scene_paths
    files = files.of(scene_path)
    if files.in_place or files.path == STREAM or (scene_path == STREAM and files.path is None):
        raise InvalidInput("--simulator: the result is several files, which need a folder; name one with -o")
    scene = read_scene(scene_path, console)
    folder = files.path or f"{Path(scene_path).stem}-{asked.simulator}"
    motion = None
    if files.pairs:
        own = read_target(files.pairs[0], scene, files.reading, console, [])
        motion, scene = own if isinstance(own, tuple) else (own, scene)
    if asked.simulator == "blender":
        from clothfit.simulators.blender import left_out

        if lost := left_out(scene):
            console.warn(f"{scene.name}: Blender's cloth is fitted without {' and '.join(lost)}")
    console.announce_compilation()
    from clothfit.simulators import written
    from clothfit.simulators.estimate import estimate

    found = estimate(scene, motion, options)
    made = written.files(scene, found, options)
    write_into(folder, made, scene_path, files.inputs)
    for number, each in enumerate(found):
        describe(number, each, console)
    console.say(f"{scene.name}: values of {asked.simulator} → {folder}: {', '.join(made)}")
    print_json({"scene": scene.name, "output": folder, "files": list(made), **written.summary(found, options)})
    return 0


def describe(number: int, found: Fitted, console: Console) -> None:
    """Print what was found for an object."""
    first = found.few or found
    pairs = zip(first.tool.values, first.found, strict=True)
    rows = [(value.name, f"{value.mapped:.4g}", f"{fitted:.4g}", value.unit) for value, fitted in pairs]
    console.table([("value", "mapped", "fitted", "unit"), *rows])
    if found.few:
        console.say(f"objects[{number}] in {found.tool.name}, few values: RMSE {error(first.rmse, found.travel)}")
        for name, _, _, fitted in found.kinds():
            middle = sorted(fitted)[len(fitted) // 2]
            console.say(f"{name} of each: {fitted.min():.4g} … {fitted.max():.4g}, median {middle:.4g}")
    console.say(
        f"objects[{number}] in {found.tool.name}: RMSE {error(found.rmse, found.travel)}; with the mapped values "
        f"{error(first.mapped_rmse, found.travel)}; {found.simulations} simulations"
    )


def error(rmse: float, travel: float) -> str:
    """A distance, and its part of the way from the start."""
    if rmse == float("inf"):
        return "of a cloth that runs away"
    return f"{metres(rmse)} ({100 * rmse / travel:.2g} % of the way)"
