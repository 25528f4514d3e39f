"""What `clothfit control` writes beside forces and motion: a table of the forces, and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import STREAM, Output, is_among, output_for
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

    @property
    def files(self) -> tuple[str | None, ...]:
        """Where it goes."""
        return (self.table.path if self.table else None,)

    def write(
        self, scene: Scene, keys: Sequence[Key], found: Control, pictures: Pictures, console: Console
    ) -> None:
        """Write what is asked for; nobody waits for pictures who has asked for the end."""
        if self.table is not None:
            from clothfit.scene.over_time import force_table

            self.table.put(force_table.encoded(found.forces.times, found.forces.values))
            console.say(f"table → {self.table.name}")
        if not any(pictures.files):
            return
        if found.status == Status.INTERRUPTED:
            console.say("nothing is drawn, as the search was interrupted")
            return
        from clothfit.control.course import course

        over = course(scene, scene.with_forces(found.forces), keys, found.motion)
        pictures.controlled(over, ended(found), console)


def asked(table: str | None, used: Sequence[str | None]) -> Shows:
    """What is asked for, checked before the work begins; `used` are other files. Raises InvalidInput."""
    if table is None:
        return Shows(None)
    if table == STREAM or not table.lower().endswith(".csv"):
        raise InvalidInput(f"--table must be a file .csv; {table} was given")
    if is_among(table, used):
        raise InvalidInput(f"cannot write {table}: it is an input or another output")
    return Shows(output_for(table, "", "", (), text=True))


def ended(found: Control) -> str:
    """How a search ended, in a line."""
    evaluations = counted(found.evaluations, "evaluation", "evaluations")
    return f"{found.status}: effort {found.effort:.4g} N² s, {evaluations} in {found.seconds:.1f} s"
