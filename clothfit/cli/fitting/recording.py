"""Records of one fit beside its result: the log, and the pictures drawn of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from clothfit.cli.common.console import Console
from clothfit.cli.common.pictures import Goal, Pictures
from clothfit.cli.fitting.files import filled

if TYPE_CHECKING:
    from clothfit.cli.fitting.fit_log import FitLog
    from clothfit.fit.result import Fit
    from clothfit.optimise.progress import Progress
    from clothfit.scene.scene import Scene

Report = Callable[["Progress"], None]


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
        from clothfit.cli.fitting.fit_log import log_of

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
