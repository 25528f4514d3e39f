"""What `clothfit control` writes beside forces and motion: a table of the forces, a page, pictures."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted
from clothfit.cli import report
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import Output, beside, page_beside
from clothfit.optimise.status import Status

if TYPE_CHECKING:
    from clothfit.cli.common.pictures import Pictures
    from clothfit.control.control import Control
    from clothfit.control.keyframes import Key
    from clothfit.scene.scene import Scene


@dataclass(frozen=True)
class Shows:
    """What is asked for."""

    table: Output | None
    page: Output | None
    command: str  # that makes them

    @property
    def files(self) -> tuple[str | None, ...]:
        """Where they go."""
        return tuple(None if each is None else each.path for each in (self.table, self.page))

    def write(
        self, scene: Scene, keys: Sequence[Key], found: Control, pictures: Pictures,
        written: tuple[Output | None, Output | None], files: Sequence[str], console: Console,
    ) -> None:  # fmt: skip
        """Write what is asked for; nobody waits for pictures who has asked for the end. `written` is where forces and
        scene went, `files` are what was read beside the scene.
        """
        if self.table is not None and found.forces is not None:
            from clothfit.scene.forces import table

            self.table.put(table(found.forces.times, found.forces.values))
            console.say(f"table → {self.table.name}")
        if self.page is None and not any(pictures.files):
            return
        if found.status == Status.INTERRUPTED:
            console.say("nothing is drawn, as the search was interrupted")
            return
        from clothfit.control.control import course

        over = course(scene, found.scene.with_forces(found.forces), keys, found.motion)
        if self.page is not None:
            from clothfit.report.page import control_page

            kept, saved = written
            played = ["clothfit", "simulate", saved.name if saved else scene.name]
            again = shlex.join([*played, *(["--forces", kept.name] if kept else [])])
            page = control_page(over, found, [self.command, again], report.digests([scene], dict.fromkeys(files)))
            self.page.write(page)
            console.say(f"page, {len(page) / 1e6:.2g} MB → {self.page.name}")
        pictures.controlled(over, ended(found), console)


def asked(table: str | None, page: str | None, used: Sequence[str | None]) -> Shows:
    """What is asked for, checked before the work begins; `used` are other files. Raises InvalidInput."""
    if table is not None and not table.lower().endswith(".csv"):
        raise InvalidInput(f"--table must be a file .csv; {table} was given")
    command = report.command_line(click.get_current_context())
    return Shows(beside(table, used), page_beside(page, (*used, table)), command)


def ended(found: Control) -> str:
    """How a search ended, in a line."""
    evaluations = counted(found.evaluations, "evaluation", "evaluations")
    effort = f"effort {found.effort:.4g} N² s, " if found.forces is not None else ""
    return f"{found.status}: {effort}{evaluations} in {found.seconds:.1f} s"
