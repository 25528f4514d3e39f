"""Records of one fit beside its result: the log, and the pictures drawn of it.

`clothfit estimate --log FILE` writes the way of a fit as JSON lines, for other programs to follow: one object for each
iteration, which is a change of the parameters that was accepted, and another where its point turns out to be the best
over all frames: `iteration`, `evaluations`, `seconds`, `cost`, `rmse`, `step`, `stage`, `window` and `frames`,
`window_rmse`, all as in `progress.Progress`; null where a number is not finite. At the end `{"summary": …}` with what
--json prints. Every line is written at once.

A log that cannot be written any more is given up with a warning: the fit is worth more.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import IO, TYPE_CHECKING, Any

from clothfit.base.errors import InvalidInput
from clothfit.base.writing import is_output
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import STREAM, is_among, plain
from clothfit.cli.common.pictures import Goal, Pictures
from clothfit.cli.parts.estimate_files import filled

if TYPE_CHECKING:
    from clothfit.fit.result import Fit
    from clothfit.optimise.progress import Progress
    from clothfit.scene.scene import Scene

Report = Callable[["Progress"], None]

KEYS = ("iteration", "evaluations", "seconds", "cost", "rmse", "step", "stage", "window", "frames", "window_rmse")


def log_of(path: str | None, used: tuple[str | None, ...], resume: bool, console: Console) -> FitLog | None:
    """The log that is asked for. Raises InvalidInput where it cannot be written, or is a file that is `used`."""
    if path is None:
        return None
    from clothfit.base.writing import check_writable

    if path == STREAM or is_among(path, used):
        raise InvalidInput(f"--log: {path}: must be a file of its own, not an input or an output")
    check_writable(path)
    return FitLog(path, earlier(path) if resume else [], console)


def earlier(path: str) -> list[dict[str, Any]]:
    """The iterations in the log of an earlier part of the same fit; lines that are none are left out."""
    if not os.path.isfile(path):
        return []
    found = []
    with open(path, encoding="utf-8", errors="replace") as file:
        for line in file:
            try:
                item = json.loads(line)
            except (ValueError, RecursionError):
                continue
            if isinstance(item, dict) and all(isinstance(item.get(key), int) for key in ("iteration", "evaluations")):
                found.append(item)
    return found


class FitLog:
    """An open log."""

    def __init__(self, path: str, known: list[dict[str, Any]], console: Console) -> None:
        """`known`: the iterations of the part of the fit that is resumed."""
        self.path, self.known, self.console = path, known, console
        self.file: IO[bytes] | None = None
        self.given_up = False
        self.last: tuple[int, float] | None = None  # iteration and cost
        self.skipped = 0  # iterations that the resumed fit does not count

    def record(self, progress: Progress) -> None:
        """Write what is new: an iteration, or that the point it led to is the best over all frames."""
        self.begin(progress)
        if (progress.iteration, progress.cost) == self.last:
            return
        self.last = progress.iteration, progress.cost
        values = {key: getattr(progress, key) for key in KEYS}
        self.write({**values, "iteration": self.skipped + progress.iteration})

    def end(self, summary: dict[str, Any]) -> None:
        """Write the summary and close."""
        self.begin(None)
        self.write({"summary": summary})
        if self.file is not None:
            self.file.close()

    def begin(self, progress: Progress | None) -> None:
        """Open it, where that is not done, with what is known of the way before."""
        if self.file is not None or self.given_up:
            return
        try:
            place = os.dup(sys.stdout.fileno()) if is_output(self.path) else self.path
            self.file = open(place, "wb", buffering=0)  # noqa: SIM115  for as long as the fit runs
        except OSError as error:
            self.give_up(error)
            return
        before = [one for one in self.known if progress is None or one["evaluations"] < progress.evaluations]
        if before and progress is not None:
            self.skipped = before[-1]["iteration"] + 1 - progress.iteration
        for item in before:
            self.write(item)

    def write(self, item: dict[str, Any]) -> None:
        """Write a line, all of it now."""
        if self.file is None or self.given_up:
            return
        rest = json.dumps(plain(item), allow_nan=False).encode() + b"\n"
        try:
            while rest:
                rest = rest[self.file.write(rest) or 0 :]
        except OSError as error:
            self.give_up(error)

    def give_up(self, error: OSError) -> None:
        """Write no more, and say why."""
        self.given_up = True
        self.console.warn(f"the log ends here: {self.path}: {error.strerror or error}")


@dataclass
class Recording:
    """The options of records, and the progress so far."""

    pictures: Pictures
    log_path: str | None
    log: FitLog | None = None
    history: list[Progress] = field(default_factory=list)

    def of(self, scene_path: str) -> Recording:
        """The same for a scene: {stem} and {folder} stand for its name and its folder."""
        plot, gif, log = (path and filled(path, scene_path) for path in (*self.pictures.files, self.log_path))
        return replace(self, pictures=Pictures(plot, gif), log_path=log)

    def check(self, used: tuple[str | None, ...], resume: bool, console: Console) -> None:
        """Raise InvalidInput, before long work, where a file cannot be made, or is one of those `used` otherwise."""
        self.pictures.check(*used)
        self.log = log_of(self.log_path, (*used, *self.pictures.files), resume, console)

    def report(self, show: Report | None) -> Report | None:
        """The function that receives the progress of the fit; None where nothing records it."""
        own = [] if show is None else [show]
        if self.log is not None:
            own.append(self.log.record)
        if self.pictures.plot is not None:
            own.append(self.history.append)

        def report_all(progress: Progress) -> None:
            for one in own:
                one(progress)

        return report_all if own else None

    def draw(self, found: Fit, scene: Scene, targets: Sequence[Goal], console: Console) -> None:
        """Draw the pictures of the finished fit."""
        self.pictures.estimated(found, scene, targets, self.history, console)
