"""`clothfit estimate --report FILE`: the page of a fit, beside the fitted scene."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.errors import InvalidInput
from clothfit.cli import report
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import STREAM, Output, output_for
from clothfit.cli.fitting import outcomes
from clothfit.cli.fitting.files import Files, filled
from clothfit.optimise.status import Status

if TYPE_CHECKING:
    from clothfit.fit.result import Fit
    from clothfit.optimise.progress import Progress
    from clothfit.report.log import Point
    from clothfit.scene.scene import Scene


@dataclass(frozen=True)
class Page:
    """A page that is to be made of a fit."""

    path: str
    command: str  # that makes it
    points: list[Point] = field(default_factory=list)  # of the fit's way

    def output(self, scene_path: str, files: Files, fitted: Output) -> Output:
        """Where it goes, checked before the fit begins. Raises InvalidInput."""
        taken = None if fitted.is_stream else fitted.path
        return output_for(self.path, scene_path, "", (*files.inputs, taken), text=True)

    def listening(self, show: Callable[[Progress], None] | None) -> Callable[[Progress], None]:
        """What notes the fit's progress and passes it on."""
        from clothfit.report.log import recorder

        return recorder(self.points, show)

    def write(
        self, scene_path: str, scene: Scene, found: Fit, files: Files, fitted: Output, targets: list[Any],
        console: Console,
    ) -> None:  # fmt: skip
        """Make and write it, after the fitted scene is written."""
        if found.status == Status.INTERRUPTED:
            console.say("no report, as the fit was interrupted; clothfit report makes one")
            return
        from clothfit.report.log import Log, thinned

        out = self.output(scene_path, files, fitted)
        log = Log(thinned(self.points), outcomes.summary(scene, found, fitted))
        motion = files.pairs[0][0] if files.pairs else None
        commands = [self.command]
        if not fitted.is_stream:
            commands.append(report.evaluation(scene_path, fitted.path, motion, files.reading))
        target = targets[0] if targets else None
        result = replace(found.scene, name=os.path.basename(fitted.name))
        inputs = report.digests(scene, result, {motion: target})
        show, size = report.write(scene, result, target, None, log, commands, inputs, out)
        report.show_result(show, size, out, console)


def chosen(path: str | None, scenes: tuple[str, ...], single: bool, files: Files) -> Page | None:
    """The page that --report asks for; {stem} and {folder} in its name are those of the scene.

    Raises a usage error where the fit is none that one page shows, InvalidInput where the page has no file.
    """
    if path is None:
        return None
    if path == STREAM:
        raise InvalidInput("--report must be a file of its own, not -; clothfit report writes to standard output")
    context = click.get_current_context()
    if not single:
        why = "--report is for one fit of one scene; make the pages of several with clothfit report"
        raise click.UsageError(why, context)
    if files.of(scenes[0]).pairs[:1] and files.of(scenes[0]).pairs[0][1] is not None:
        raise click.UsageError("--report shows the first --target, which must be of SCENE itself, without @", context)
    return Page(filled(path, scenes[0]), report.command_line(context))
