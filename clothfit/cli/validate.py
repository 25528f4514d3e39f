"""`clothfit validate`: is it a scene?"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from typing import Any

import click

from clothfit.base.errors import InvalidInput, InvalidScene
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import standard_command
from clothfit.cli.common.output import STREAM, print_json
from clothfit.cli.common.scenes import one_stream

PLACE = re.compile(r"(top level|line \d+, column \d+|(?:[\w.\[\]]|\"[^\"]*\")+): (.*)", re.DOTALL)
"""Where something is wrong, before what is."""


@dataclass(frozen=True)
class Verdict:
    """What was found in a file."""

    path: str
    error: InvalidScene | None
    warnings: tuple[str, ...]
    note: str | None = None  # what is right, and may not be what one wants


@standard_command("validate")
@click.argument("scene_paths", metavar="SCENE...", nargs=-1, required=True)
def command(scene_paths: tuple[str, ...], as_json: bool, console: Console) -> None:
    """Check scenes and print every problem, without simulating.

    \b
    clothfit validate scene.json
    clothfit validate scenes/*.json --json

    The exit code is 0 if all scenes are valid, else 3.
    """
    one_stream(*scene_paths)
    verdicts = [judge(path) for path in scene_paths]
    for verdict in verdicts:
        show(verdict, len(verdicts) == 1, console)
    wrong = [verdict for verdict in verdicts if verdict.error is not None]
    if as_json:
        own = [summary(verdict) for verdict in verdicts]
        print_json("validate", own[0] if len(own) == 1 else {"valid": not wrong, "scenes": own})
    if len(verdicts) == 1 and verdicts[0].error:
        raise verdicts[0].error
    if wrong:
        names = ", ".join(verdict.path for verdict in wrong)
        raise InvalidInput(f"{len(wrong)} of {len(verdicts)} scenes are not valid: {names}")


def judge(path: str) -> Verdict:
    """Look at a file."""
    from clothfit.inspection.overview import beyond_editor
    from clothfit.scene.mesh_numbering import numberings
    from clothfit.scene.scene import load

    try:
        scene = load(sys.stdin.buffer if path == STREAM else path)
        numberings(scene)
    except InvalidScene as error:
        return Verdict(path, error, ())
    return Verdict(scene.name if path == STREAM else path, None, scene.warnings, beyond_editor(scene))


def show(verdict: Verdict, alone: bool, console: Console) -> None:
    """Say what was found, a line each, but for what the command ends with: the only problem of the only file."""
    for warning in verdict.warnings:
        console.warn(f"{verdict.path}: {warning}")
    if verdict.error is None:
        console.say(f"{verdict.path}: valid" + (f"; {verdict.note}" if verdict.note else ""))
        return
    for problem in verdict.error.problems if not alone or len(verdict.error.problems) > 1 else ():
        console.say(f"{verdict.path}: {problem}")


def summary(verdict: Verdict) -> dict[str, Any]:
    """What --json prints of a file."""
    found = [] if verdict.error is None else [split(problem) for problem in verdict.error.problems]
    warnings = [split(warning) for warning in verdict.warnings]
    valid = verdict.error is None
    return {"scene": verdict.path, "valid": valid, "problems": found, "warnings": warnings, "note": verdict.note}


def split(sentence: str) -> dict[str, str | None]:
    """Place and message of a problem; no place where it is the file as a whole."""
    match = PLACE.fullmatch(sentence)
    return {"place": match[1], "message": match[2]} if match else {"place": None, "message": sentence}
