"""`--plot FILE` and `--gif FILE`: the pictures that commands draw when they are done."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

from clothfit.base.messages import counted, metres
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import gathered, tuned
from clothfit.cli.common.output import check_unused
from clothfit.formats.registry import suffix_of
from clothfit.optimise.status import Status

if TYPE_CHECKING:
    from clothfit.base.arrays import Array
    from clothfit.control.control import ControlledMotion
    from clothfit.evaluation.evaluate import Evaluation, Overlay
    from clothfit.fit.result import Fit
    from clothfit.motion.energy import Energy
    from clothfit.motion.motion import Motion
    from clothfit.optimise.progress import Progress
    from clothfit.pictures.stage import Marks
    from clothfit.report.log import Log
    from clothfit.scene.scene import Scene

Goal: TypeAlias = "Motion | tuple[Motion, Scene]"
"""A target, alone or with the scene it was recorded in."""

MOST_FITTED_LENGTHS = 5
"""How many times the frames that are fitted a target is shown, at most."""


@dataclass(frozen=True)
class Pictures:
    """Which pictures are asked for."""

    plot: str | None = tuned("--plot FILE", "Write a picture here: .png, .svg or .pdf. Needs matplotlib.")
    gif: str | None = tuned("--gif FILE", "Write an animation here, as a GIF. Needs Pillow.")

    @property
    def files(self) -> tuple[str | None, str | None]:
        """Where they go."""
        return self.plot, self.gif

    def check(self, *used: str | None) -> None:
        """Raise InvalidInput, before long work, where a picture cannot be made or written, or is a file that is `used`
        otherwise.
        """
        from clothfit.pictures import picture_file as picture

        if self.plot is not None and self.gif is not None:
            check_unused(self.gif, [self.plot])
        for path, kinds in ((self.plot, picture.PLOTS), (self.gif, picture.GIF)):
            if path is not None:
                check_unused(path, used)
                picture.check_picture(path, kinds)

    def simulated(self, scene: Scene, motion: Motion, energy: Energy | None, console: Console) -> None:
        """Draw a motion, which may have diverged after its frames."""
        self.drawn("simulation", (scene, motion.times, motion.positions, energy), console)
        self.animated(scene, motion.times, motion.positions, None, console)

    def controlled(self, motion: ControlledMotion, title: str, console: Console) -> None:
        """Draw a motion that goes through keys; `title` says how it was found."""
        self.drawn("controlled", (motion, title), console)
        if self.gif is not None:
            from clothfit.pictures.stage import marks

            own = marks(motion)
            self.animated(motion.scene, motion.times, motion.own, own.keys, console, own)

    def estimated(
        self, fit: Fit, scene: Scene, targets: Sequence[Goal], history: Sequence[Progress], console: Console
    ) -> None:
        """Draw a fit of a scene, over the first of its targets or over its own motion; nobody waits for it who has
        asked for the end.
        """
        if not any(self.files):
            return
        if fit.status == Status.INTERRUPTED:
            console.say("nothing is drawn, as the fit was interrupted")
            return
        over = over_target(fit, scene, targets[0] if targets else None)
        fitted = over.times[min(fit.frames, len(over.times)) - 1]
        title = (
            f"{fit.status}: RMSE {metres(fit.rmse)} over {fit.frames} frames, "
            f"{counted(fit.evaluations, 'evaluation', 'evaluations')} in {fit.seconds:.1f} s"
        )
        self._compared("estimation", over, (title, history, float(fitted)), console)

    def evaluated(
        self, truth: Scene, fitted: Scene, target: Motion | None, horizon: int, report: Evaluation, console: Console
    ) -> None:
        """Draw a fitted scene beside the true one."""
        if not any(self.files):
            return
        from clothfit.evaluation.evaluate import overlaid

        over = overlaid(truth, fitted, target, max(truth.frames, horizon))
        title = (
            f"RMSE {metres(report.fitted.rmse)} over the {report.fitted.frames} fitted frames, "
            f"{metres(report.horizon.rmse)} over {report.horizon.frames}"
        )
        ends = (truth.delta * (truth.frames - 1), float(over.times[-1]))
        self._compared("evaluation", over, (truth, title, min(ends), ends[1]), console)

    def fitted(
        self, truth: Scene, fitted: Scene, target: Motion | None, frames: int, log: Log, console: Console
    ) -> None:
        """Draw a fitted scene over its target, or over that of the true scene, with the course that a log knows."""
        import numpy as np

        from clothfit.evaluation.evaluate import overlaid
        from clothfit.optimise.progress import Progress

        over = overlaid(truth, fitted, target, frames)
        seen = over.rmse[np.isfinite(over.rmse)]
        title = f"RMSE {metres(float(np.sqrt((seen**2).mean())))} over {counted(len(seen), 'frame', 'frames')}"
        history = [Progress(at.evaluations, 0, at.cost, at.rmse, at.seconds) for at in log.points]
        self._compared("estimation", over, (title, history, truth.delta * (truth.frames - 1)), console)

    def _compared(self, name: str, over: Overlay, rest: tuple[Any, ...], console: Console) -> None:
        self.drawn(name, (over, *rest), console)
        self.animated(over.scene, over.times, over.own, over.goal, console)

    def drawn(self, name: str, what: tuple[Any, ...], console: Console) -> None:
        """Draw the picture, where it is asked for, by that function of `plots`."""
        if self.plot is not None:
            from clothfit.pictures import picture_file, plots

            picture_file.save(self.plot, partial(getattr(plots, name), *what))
            console.say(f"picture → {self.plot}")

    def animated(
        self, scene: Scene, times: Array, x: Array, over: Array | None, console: Console, marks: Marks | None = None
    ) -> None:
        """Draw the GIF where it is asked for."""
        if self.gif is None:
            return
        from clothfit.base.writing import write_atomically
        from clothfit.pictures import gif

        write_atomically(self.gif, gif.animation(scene, times, x, over, marks=marks))
        console.say(f"animation → {self.gif}")


def over_target(fit: Fit, scene: Scene, target: Goal | None) -> Overlay:
    """The motion of a fit over its target, which may have a scene of its own."""
    import numpy as np

    from clothfit.evaluation.evaluate import overlaid
    from clothfit.fit.continuation import with_interval
    from clothfit.objective.experiment import flagged_as
    from clothfit.scene.fit_vector import parameters, with_parameters

    if target is None:
        return overlaid(scene, fit.scene, None, scene.frames)
    motion, other = target if isinstance(target, tuple) else (target, scene)
    own = fit.scene
    if other is not scene:
        own = with_parameters(flagged_as(other, own), parameters(own))
        if (own.delta, own.method) != (fit.scene.delta, fit.scene.method):
            own = with_interval(own, fit.scene.delta, fit.scene.method)  # the step that was chosen for this target
    frames = min(int(np.ceil(motion.times[-1] / own.delta)) + 1, MOST_FITTED_LENGTHS * own.frames)
    return overlaid(own, own, motion, frames)


def named(path: str | None) -> Pictures | None:
    """The picture that a file is to be, by its suffix; None where it is to be something else."""
    from clothfit.pictures.picture_file import GIF, PLOTS

    kind = suffix_of(path or "").removeprefix(".")
    return Pictures(None, path) if kind in GIF else Pictures(path, None) if kind in PLOTS else None


options = gathered("pictures", Pictures)
"""Adds --plot and --gif; the function is given both as `pictures`."""
