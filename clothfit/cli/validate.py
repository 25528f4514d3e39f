"""`clothfit validate`: is it a scene?"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import click

from clothfit.base.errors import InvalidInput, InvalidScene
from clothfit.base.limits import doubts_of_time
from clothfit.cli.common.console import Console
from clothfit.cli.common.motions import better, one_stream, split, unlikely
from clothfit.cli.common.options import option, standard_command
from clothfit.cli.common.output import STREAM, print_json


@dataclass(frozen=True)
class Verdict:
    """What was found in a file."""

    path: str
    error: InvalidScene | None
    warnings: tuple[str, ...]
    note: str | None = None  # what is right, and may not be what one wants


@standard_command("validate")
@click.argument("scene_paths", metavar="SCENE...", nargs=-1, required=True)
@option("--for TOOL", "Say what this tool would play otherwise: unity.", click.Choice(["unity"]), name="tool")
def command(scene_paths: tuple[str, ...], tool: str | None, console: Console) -> None:
    """Check scenes and print every problem, without simulating.

    \b
    clothfit validate scene.json
    clothfit validate scenes/*.json --json
    clothfit validate scene.json --for unity

    The exit code is 0 if all scenes are valid, else 3.
    """
    one_stream(*scene_paths)
    verdicts = [examine(path, tool) for path in scene_paths]
    for verdict in verdicts:
        show(verdict, len(verdicts) == 1, console)
    wrong = [verdict for verdict in verdicts if verdict.error is not None]
    own = [summary(verdict) for verdict in verdicts]
    print_json(own[0] if len(own) == 1 else {"valid": not wrong, "scenes": own})
    if len(verdicts) == 1 and verdicts[0].error:
        raise verdicts[0].error
    if wrong:
        names = ", ".join(verdict.path for verdict in wrong)
        raise InvalidInput(f"{len(wrong)} of {len(verdicts)} scenes are not valid: {names}")


def examine(path: str, tool: str | None = None) -> Verdict:
    """Look at a file, and at what a tool would play otherwise."""
    from clothfit.engine.starts import sentences
    from clothfit.evaluation.forecast import check_inputs
    from clothfit.evaluation.overview import beyond_editor, misspelt_fields
    from clothfit.scene.mesh_numbering import numberings
    from clothfit.scene.scene import load

    try:
        scene = load(sys.stdin.buffer if path == STREAM else path)
        numberings(scene)
        if scene.moves or any(each.body for each in scene.colliders):
            check_inputs(scene)
        starts = sentences(scene)
    except InvalidScene as error:
        return Verdict(path, better(error, path), ())
    doubts = (*doubts_of_time(scene.delta, scene.gravity.tolist()), *unlikely(scene))
    warnings = (*scene.warnings, *doubts, *misspelt_fields(scene), *starts)
    note = None if tool is None else beyond_editor(scene)
    return Verdict(scene.name if path == STREAM else path, None, warnings, note)


def show(verdict: Verdict, alone: bool, console: Console) -> None:
    """Print what was found, a line each. On a terminal, the only problem of the only file is left to the error."""
    console.warn(*verdict.warnings, of=verdict.path)
    if verdict.error is None:
        console.result(f"{verdict.path}: valid" + (f"; {verdict.note}" if verdict.note else ""))
        return
    problems = verdict.error.problems
    if alone and len(problems) == 1 and (console.data or sys.stdout.isatty()):
        return
    console.result(*problems, of=verdict.path)


def summary(verdict: Verdict) -> dict[str, Any]:
    """What --json prints of a file."""
    found = [] if verdict.error is None else [split(problem) for problem in verdict.error.problems]
    warnings = [split(warning) for warning in verdict.warnings]
    valid = verdict.error is None
    return {"scene": verdict.path, "valid": valid, "problems": found, "warnings": warnings, "note": verdict.note}
