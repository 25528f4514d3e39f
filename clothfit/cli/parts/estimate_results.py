"""What `clothfit estimate` writes and prints of a fit; with --report FILE also a page, beside the fitted scene."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted, metres, owned
from clothfit.cli import report
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import STREAM, Output, document, output_for, print_json, write_scene
from clothfit.cli.parts.estimate_files import Files, filled
from clothfit.many.job import EXIT_CODES, NEVER_FINITE
from clothfit.optimise.status import Status
from clothfit.scene.kinds import INTEGRATORS, MODEL_NAMES

if TYPE_CHECKING:
    from clothfit.cli.parts.estimate_records import FitLog
    from clothfit.fit.confidence import Samples
    from clothfit.fit.holdout import Judged
    from clothfit.fit.result import Fit, FittedBlock
    from clothfit.optimise.progress import Progress
    from clothfit.report.log import Point
    from clothfit.scene.scene import Scene

WORTH_A_WORD = 1e-5
"""Error relative to the distance travelled below which its percentage says nothing."""

AS_IN_FIT = (
    "status", "method", "cost", "rmse", "frames", "evaluations", "seconds", "rank", "sigma", "travel", "relative_rmse",
    "objective",
)
"""Keys of the summary for --json that are attributes of `Fit`."""


def finish(
    scene: Scene, found: Fit, out: Output, console: Console, more: dict[str, Any] | None = None,
    log: FitLog | None = None,
) -> int:
    """Write the result and print it, with `more` in the summary for --json and the log; returns the exit code."""
    result = summary(scene, found, out) | (more or {})
    for warning in found.warnings:
        console.warn(f"{scene.name}: {warning}")
    if found.status == Status.DIVERGED:
        conclude(result | {"output": None}, log)
        from clothfit.motion.divergence import Diverged

        raise Diverged(f"{scene.name}: {NEVER_FINITE}", 0)
    write_scene(found.scene, out)
    describe(found, out, console)
    conclude(result, log)
    return EXIT_CODES[found.status]


def conclude(result: dict[str, Any], log: FitLog | None) -> None:
    """Write the summary to the log and print it as JSON, where asked for."""
    if log is not None:
        log.end(document("estimate", result))
    print_json(result)


def describe(found: Fit, out: Output, console: Console) -> None:
    """Print the result in a few lines."""
    over = counted(found.frames, "frame", "frames")
    used = f"{counted(found.evaluations, 'evaluation', 'evaluations')} in {found.seconds:.1f} s"
    if found.cost < math.inf:
        console.say(f"{ending(found)}: RMSE {error(found)} over {over}, {used} → {out.name}")
    else:
        console.say(f"{found.status}: nothing fitted, no evaluation ended in time; the start, as it was → {out.name}")
    if found.windows is not None and found.whole is not None:
        far = f"RMSE {metres(found.whole)}" if math.isfinite(found.whole) else "diverges"
        console.say(f"that is over windows of {counted(found.windows, 'frame', 'frames')}; the whole motion: {far}")
    for i, each in enumerate(found.registration or []):
        console.say(f"target{f' {i + 1}' if i or len(found.registration or []) > 1 else ''}: {each}")
    describe_choices(found, console)
    for hint in found.hints:
        if not hint.early:  # the others were said before
            console.say(f"hint: {hint.text}")
    if found.holdout:
        kept = counted(found.holdout.observations, "position", "positions")
        console.say(f"holdout: RMSE {metres(found.holdout.rmse)} over {kept} kept out of the fit")
    for block in found.parameters:
        place = owned(block.object, block.name)
        if block.at_bound:
            console.warn(f"{place}: {at_bound(block)}")
        if times := factors(block):
            console.say(f"{place}: {times}")
        if known := certainty(block, found.samples):
            console.say(f"{place}: {known}")


def as_compared(targets: list[Any], found: Fit, scene: Scene) -> list[Any]:
    """The targets with the markers, the clock and the place that the fit found."""
    pairs = [target if isinstance(target, tuple) else (target, scene) for target in targets]
    marked, timed = found.markers or [], found.registration or []
    if len(marked) == len(pairs):
        pairs = [(each.applied(motion), own) for each, (motion, own) in zip(marked, pairs, strict=True)]
    if len(timed) == len(pairs):
        pairs = [(each.applied(motion, own.delta), own) for each, (motion, own) in zip(timed, pairs, strict=True)]
    return [pair if isinstance(target, tuple) else pair[0] for pair, target in zip(pairs, targets, strict=True)]


def describe_choices(found: Fit, console: Console) -> None:
    """Print the models that were fitted from coarse to fine, and the time step, where there was a choice."""
    if len(found.ladder) > 1:
        console.result("\n".join(ladder_table(found.ladder)))
    if found.substeps:
        method, milliseconds = INTEGRATORS[found.scene.method], 1000 * found.scene.delta
        console.say(
            f"time step: {milliseconds:.4g} ms by {method}, {counted(found.substeps, 'step', 'steps')} to a frame of "
            "the target; the scene is to be played with it"
        )


def ladder_table(ladder: Sequence[Judged]) -> list[str]:
    """The models that were fitted, a line each."""
    kept = any(each.holdout_rmse is not None for each in ladder)
    head = f"{'model':<18}{'values':>8}{'RMSE':>12}{'kept out' if kept else '':>12}{'seconds':>10}"
    lines = [head.rstrip() if not kept else head]
    for each in ladder:
        held = "" if not kept else "-" if each.holdout_rmse is None else metres(each.holdout_rmse)
        name = f"{each.model} {MODEL_NAMES[each.model]}"
        lines.append(f"{name:<18}{each.values:>8}{metres(each.rmse):>12}{held:>12}{each.seconds:>10.1f}")
    return lines


def ending(found: Fit) -> str:
    """How the fit ended, and whether its model can reproduce the target."""
    if found.verdict is None or not found.verdict.differs:
        return str(found.status)
    left = f"{percent(found.verdict.unexplained)} of the motion unexplained"
    return f"{found.status}, {left}" if found.status == Status.LIMIT else f"{found.status}, the model differs: {left}"


def error(found: Fit) -> str:
    """The error in metres, and in percent of the distance travelled."""
    if found.relative_rmse is None or found.relative_rmse < WORTH_A_WORD:
        return metres(found.rmse)
    return f"{metres(found.rmse)}, {percent(found.relative_rmse)} of the distance travelled,"


def percent(fraction: float) -> str:
    """A fraction in percent with two digits."""
    return f"{100 * fraction:.2g} %" if fraction < 1 else f"{100 * fraction:.0f} %"


def factors(block: FittedBlock) -> str:
    """The factors of groups by their names; empty where no such are fitted."""
    if block.values is None or block.groups is None or block.modes is not None:
        return ""
    parts = (f"{name} × {value:.4g}" for name, value in zip(block.groups, block.values, strict=True))
    return ", ".join(parts)


def at_bound(block: FittedBlock) -> str:
    """Which values are at a bound, and which bound that is."""
    from clothfit.scene.kinds import KIND

    factor = block.values is not None or (block.name == "rest" and block.mode == "G")
    ends = " and ".join(f"{end:g}" for end in sorted(set(block.bounds)))
    which = "" if block.count == 1 else f": {indices(block.at_bound)}"
    unit = " times the start" if factor else KIND[block.name].suffix
    return f"{len(block.at_bound)} of {block.count} at a bound, {ends}{unit} (--bounds){which}"


def certainty(block: FittedBlock, samples: Samples | None = None) -> str:
    """What is known of the values of a block, and what is not; empty where neither was looked for. `samples`: those
    that the intervals are by.
    """
    parts = [f"{counted(block.count, 'value', 'values')}"]
    if any(block.interval):
        parts.append(f"{accuracy(block)} ({'median ' if block.count > 1 else ''}95 % interval{by_samples(samples)})")
    if block.unidentifiable:
        parts.append(f"{len(block.unidentifiable)} not shown by the motion: {indices(block.unidentifiable)}")
    if block.unmoved:
        parts.append(f"{len(block.unmoved)} did not move: {indices(block.unmoved)}")
    return ", ".join(parts) if len(parts) > 1 else ""


def by_samples(samples: Samples | None) -> str:
    """That intervals are by samples, and how accurate they are, as the end of a sentence."""
    return f", by {samples.count} samples, to {percent(samples.accuracy)}" if samples else ""


def accuracy(block: FittedBlock) -> str:
    """Half of the middle one of the intervals: in percent where a fit moves the logarithm."""
    from numpy import median  # not that of the standard library, which is slower to import

    from clothfit.scene.kinds import KIND

    kind, ends = KIND[block.name], [interval for interval in block.interval if interval]
    if kind.log:
        return f"±{100 * (math.sqrt(median([high / low for low, high in ends])) - 1):.2g} %"
    return f"±{median([high - low for low, high in ends]) / 2:.2g}{kind.suffix}"


def indices(numbers: list[int]) -> str:
    """The first few of a list of indices."""
    return ", ".join(map(str, numbers[:8])) + (", …" if len(numbers) > 8 else "")


def summary(scene: Scene, found: Fit, out: Output) -> dict[str, Any]:
    """What --json prints."""
    return {
        "scene": scene.name,
        **{name: getattr(found, name) for name in AS_IN_FIT},
        "prior": found.prior and [asdict(scatter) for scatter in found.prior],
        "memory": found.memory and found.memory.summary(),
        "holdout": found.holdout and asdict(found.holdout),
        "verdict": found.verdict and asdict(found.verdict),
        "ladder": [asdict(each) for each in found.ladder],
        "step": {
            "delta": found.scene.delta, "integrator": INTEGRATORS[found.scene.method], "substeps": found.substeps,
            "tried": [asdict(each) for each in found.steps],
        },
        "windows": found.windows and {"frames": found.windows, "whole_rmse": found.whole},
        "hints": [{"code": hint.code, "text": hint.text} for hint in found.hints],
        "registration": found.registration and [each.summary() for each in found.registration],
        "markers": found.markers and [each.summary(scene.vertex_counts) for each in found.markers],
        "parameters": [asdict(block) for block in found.parameters],
        "correlations": [asdict(each) for each in found.correlations],
        "samples": found.samples and asdict(found.samples),
        "warnings": found.warnings,
        "output": out.path,
    }


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
        log = Log(thinned(self.points), summary(scene, found, fitted), start=found.start)
        motion = files.pairs[0][0] if files.pairs else None
        commands = [self.command]
        if not fitted.is_stream:
            commands.append(report.evaluation(scene_path, fitted.path, motion, files.reading, files.forces))
        target = targets[0] if targets else None
        result = replace(found.scene, name=os.path.basename(fitted.name))
        origin = commands, report.digests([scene, result], {motion: target, files.forces: None})
        show, size = report.write(scene, [result], target, None, [log], origin, out)
        report.show_result(show, size, out, console)


def page_of(path: str | None, scenes: tuple[str, ...], single: bool, files: Files) -> Page | None:
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
