"""What `clothfit estimate` writes and prints of a fit; with --report FILE also a page, beside the fitted scene."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted, listed, metres, owned, percent
from clothfit.base.writing import check_writable, is_output
from clothfit.cli import report
from clothfit.cli.common import output
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import STREAM, Output, attributes, is_among, plain, print_json
from clothfit.cli.common.pictures import Pictures
from clothfit.cli.parts.estimate_files import SHADOWS, Files, filled
from clothfit.many.job import EXIT_CODES, NEVER_FINITE
from clothfit.optimise.status import Status
from clothfit.scene.kinds import INTEGRATORS, KIND, MODEL_NAMES, Kind

if TYPE_CHECKING:
    from clothfit.fit.confidence import Samples
    from clothfit.fit.result import Fit, FittedBlock
    from clothfit.optimise.progress import Progress
    from clothfit.report.log import Point
    from clothfit.scene.scene import Scene

FAILED = "fails"
"""The code of the hint that says that a fit fails, which comes before all else."""

OF_UNITS = ("scale", "placement", "rest_lengths", "bounds")
"""The codes of hints that follow from another unit, or other axes."""

LISTED = 12
"""Lower bounds that are listed one by one."""

NEGLIGIBLE = 1e-5
"""Error relative to the distance travelled below which its percentage says nothing."""

AS_IN_FIT = (
    "status", "method", "cost", "rmse", "frames", "evaluations", "seconds", "rank", "sigma", "travel", "relative_rmse",
    "objective", "prior", "holdout", "verdict", "single_steps", "baselines", "ladder", "parameters", "correlations",
    "samples", "warnings",
)  # fmt: skip
"""Keys of the summary for --json that are attributes of `Fit`."""


def finish(
    scene: Scene, fit: Fit, out: Output, console: Console, more: dict[str, Any] | None = None,
    log: FitLog | None = None,
) -> int:
    """Write the result and print it, with `more` in the summary for --json and the log; returns the exit code."""
    result = summary(scene, fit, out) | (more or {})
    failed = [hint.text for hint in fit.hints if hint.code == FAILED]
    remedies = [each["advice"] for each in result.get("reading", []) if "--" in (each["advice"] or "")]
    if failed and remedies:
        failed = [f"the target is read in other units or axes than its own; {remedies[0]}"]
    console.warn(*(f"the fit fails: {text}" for text in failed), of=scene.name)
    console.warn(*fit.warnings, of=scene.name)
    diverged = fit.status == Status.DIVERGED
    if diverged:
        result["output"] = None
    else:
        output.write_scene(fit.scene, out)
        describe(fit, out, console, bool(remedies))
    if log is not None:
        log.end(output.document("estimate", result))
    print_json(result)
    if diverged:
        from clothfit.motion.divergence import Diverged

        raise Diverged(f"{scene.name}: {NEVER_FINITE}", 0)
    return EXIT_CODES[fit.status]


def describe(fit: Fit, out: Output, console: Console, named: bool = False) -> None:
    """Print the result in a few lines. `named`: the unit or the axes with which the target would fit are known."""
    over = counted(fit.frames, "frame", "frames")
    used = f"{counted(fit.evaluations, 'evaluation', 'evaluations')} in {fit.seconds:.1f} s"
    if fit.cost < math.inf:
        console.say(f"{ending(fit)}: RMSE {error(fit)} over {over}, {used} → {out.name}")
    else:
        console.say(f"{fit.status}: nothing fitted, no evaluation ended in time; the start, as it was → {out.name}")
    if fit.windows is not None and fit.whole is not None:
        far = f"RMSE {metres(fit.whole)}" if math.isfinite(fit.whole) else "diverges"
        console.say(f"that is over windows of {counted(fit.windows, 'frame', 'frames')}; the whole motion: {far}")
    for i, each in enumerate(fit.registration or []):
        console.say(f"target{f' {i + 1}' if i or len(fit.registration or []) > 1 else ''}: {each}")
    if fit.followed:
        what = counted(fit.followed, "held vertex follows", "held vertices follow")
        console.say(f"{what} the target, as pins of the scene; --hold keeps them still")
    describe_choices(fit, console)
    said = {FAILED, *OF_UNITS} if named else {FAILED}
    late = [hint.text for hint in fit.hints if not hint.before_fit and hint.code not in said]
    console.say(*late, of="hint")
    if fit.holdout:
        kept = counted(fit.holdout.observations, "position", "positions")
        still = fit.holdout.still
        beside = "" if still is None else f", {metres(still)} by the best still picture of the fitted frames"
        console.say(f"holdout: RMSE {metres(fit.holdout.rmse)} over {kept} kept out of the fit{beside}")
    if fit.verdict is None or fit.verdict.model != FAILED:
        describe_fabrics(fit, console)
    for block in fit.parameters:
        place = owned(block.object, block.name)
        kind = KIND[block.name] if block.object is None else fit.scene.cloths[block.object].kind(block.name)
        if block.at_bound:
            console.warn(f"{place}: {at_bound(block, kind)}")
        if times := factors(block):
            console.say(f"{place}: {times}")
        if bounded := lower_bounds(block):
            console.say(f"{place}: {bounded}; where edges hardly stretch, nobody sees how much stiffer they are")
        if known := certainty(block, kind, fit.samples, fit.verdict is not None and fit.verdict.differs):
            console.say(f"{place}: {known}")


def describe_fabrics(fit: Fit, console: Console) -> None:
    """Say where fitted cloths stand among real fabrics, as far as the motion shows it."""
    from numpy import median

    from clothfit.fabric.fabric import fabric_of
    from clothfit.fabric.presets import sentence
    from clothfit.fit.hints import edges_of

    for block in fit.parameters:
        if block.object is None or block.name != "stiffness" or len(block.unidentifiable) == block.count:
            continue
        own = fabric_of(fit.scene.cloths[block.object])
        hidden = [(block.groups or [])[i] for i in block.unidentifiable] if block.groups and not block.modes else []
        shown = [all(not name.startswith(part) for name in hidden) for part in ("bending", "edges")]
        sure = None
        if known := [each for each in block.least if each is not None]:
            cloth = fit.scene.cloths[block.object]
            sure = min(min(known) / float(median(cloth.stiffness[edges_of(cloth)])), 1.0)
        if own is not None and (text := sentence(own, shown[0], shown[1], sure)):
            console.say(f"{owned(block.object, 'stiffness')}: {text}")


def as_compared(targets: list[Any], fit: Fit, scene: Scene) -> list[Any]:
    """The targets with the markers, the clock and the place that the fit found, scans as they were tracked."""
    pairs = [target if isinstance(target, tuple) else (target, scene) for target in targets]
    pairs = [(track, own) for track, (_, own) in zip(fit.tracks or [m for m, _ in pairs], pairs, strict=True)]
    marked, timed = fit.markers or [], fit.registration or []
    if len(marked) == len(pairs):
        pairs = [(each.applied(motion), own) for each, (motion, own) in zip(marked, pairs, strict=True)]
    if len(timed) == len(pairs):
        pairs = [(each.applied(motion, own.delta), own) for each, (motion, own) in zip(timed, pairs, strict=True)]
    return [pair if isinstance(target, tuple) else pair[0] for pair, target in zip(pairs, targets, strict=True)]


def describe_choices(fit: Fit, console: Console) -> None:
    """Print the models that were fitted from coarse to fine, and the time step, where there was a choice."""
    if len(fit.ladder) > 1:
        kept = any(each.holdout_rmse is not None for each in fit.ladder)
        console.table([("model", "values", "RMSE", *["kept out"] * kept, "seconds")] + [
            (f"{each.model} {MODEL_NAMES[each.model]}", str(each.values), metres(each.rmse),
             *["-" if each.holdout_rmse is None else metres(each.holdout_rmse)] * kept, f"{each.seconds:.1f}")
            for each in fit.ladder
        ])  # fmt: skip
    if fit.substeps:
        method, milliseconds = INTEGRATORS[fit.scene.method], 1000 * fit.scene.delta
        console.say(
            f"time step: {milliseconds:.4g} ms by {method}, {counted(fit.substeps, 'step', 'steps')} to a frame of "
            "the target; the scene is to be played with it"
        )


def ending(fit: Fit) -> str:
    """How the fit ended, and whether its model can reproduce the target."""
    if fit.verdict is None or not fit.verdict.differs:
        return str(fit.status)
    left = f"{percent(fit.verdict.unexplained)} of the motion unexplained"
    if fit.verdict.fails:
        return f"{fit.status}, the fit fails: {left}"
    return f"{fit.status}, {left}" if fit.status == Status.LIMIT else f"{fit.status}, the model differs: {left}"


def error(fit: Fit) -> str:
    """The error in metres, and in percent of the distance travelled."""
    if fit.relative_rmse is None or fit.relative_rmse < NEGLIGIBLE:
        return metres(fit.rmse)
    return f"{metres(fit.rmse)}, {percent(fit.relative_rmse)} of the distance travelled,"


def factors(block: FittedBlock) -> str:
    """The factors of groups by their names; empty where no such are fitted."""
    if block.values is None or block.groups is None or block.modes is not None:
        return ""
    parts = (f"{name} × {value:.4g}" for name, value in zip(block.groups, block.values, strict=True))
    return ", ".join(parts)


def at_bound(block: FittedBlock, kind: Kind) -> str:
    """Which values are at a bound, and which bound that is."""
    factor = block.values is not None or (block.name == "rest" and block.mode == "G")
    ends = " and ".join(f"{end:g}" for end in sorted(set(block.bounds)))
    which = "" if block.count == 1 else f": {indices(block.at_bound)}"
    unit = " times the start" if factor else kind.suffix
    return f"{len(block.at_bound)} of {block.count} at a bound, {ends}{unit} (--bounds){which}"


def certainty(block: FittedBlock, kind: Kind, samples: Samples | None = None, differs: bool = False) -> str:
    """What is known of the values of a block, and what is not; empty where neither was looked for. `samples`: those
    that the intervals are by; `differs`: whether the model does.
    """
    parts = [f"{counted(block.count, 'value', 'values')}"]
    if any(block.interval):
        by = f", by {samples.count} samples, to {percent(samples.accuracy)}" if samples else ""
        scope = "not certain, as the model differs" if differs else "for this model only"
        parts.append(f"{accuracy(block, kind)} ({'median ' if block.count > 1 else ''}95 % interval{by}, {scope})")
    if block.hardly_shown and block.groups:
        from clothfit.fit.result import HARDLY

        wide = [names_of(block)[i] for i in block.hardly_shown]
        parts.append(f"{listed(wide)} hardly shown, to a factor of {HARDLY:g} or worse")
    if block.unidentifiable:
        parts.append(f"{len(block.unidentifiable)} not shown by the motion: {indices(block.unidentifiable)}")
    if block.unmoved:
        parts.append(f"{len(block.unmoved)} did not move: {indices(block.unmoved)}")
    return ", ".join(parts) if len(parts) > 1 else ""


def lower_bounds(block: FittedBlock) -> str:
    """The stiffnesses of which a motion shows how large they are at least; of many the lowest and the highest."""
    known = [(name, least) for name, least in zip(names_of(block), block.least, strict=False) if least is not None]
    if len(known) > LISTED:
        values = sorted(least for _, least in known)
        return f"{len(known)} values at least {values[0]:.3g} to {values[-1]:.3g} N/m each"
    return ", ".join(f"{name} at least {least:.3g} N/m".strip() for name, least in known)


def names_of(block: FittedBlock) -> list[str]:
    """A name for each value of a block: of a map, for its levels."""
    if block.groups is None:
        return [""] * block.count if block.count == 1 else [f"[{i}]" for i in range(block.count)]
    return [name for name, count in zip(block.groups, block.modes or [1] * len(block.groups), strict=True)
            for name in [name] * count]  # fmt: skip


def accuracy(block: FittedBlock, kind: Kind) -> str:
    """Half of the middle one of the intervals: in percent where a fit moves the logarithm."""
    from numpy import median  # not that of the standard library, which is slower to import

    ends = [interval for interval in block.interval if interval]
    if kind.log:
        return f"±{100 * (math.sqrt(median([high / low for low, high in ends])) - 1):.2g} %"
    return f"±{median([high - low for low, high in ends]) / 2:.2g}{kind.suffix}"


def indices(numbers: list[int]) -> str:
    """The first few of a list of indices."""
    return ", ".join(map(str, numbers[:8])) + (", …" if len(numbers) > 8 else "")


def summary(scene: Scene, fit: Fit, out: Output) -> dict[str, Any]:
    """What --json prints."""
    from clothfit.fabric.fabric import fabric_of

    record: dict[str, Any] = plain({
        "scene": scene.name,
        **attributes(fit, *AS_IN_FIT),
        "memory": fit.memory and fit.memory.summary(),
        "step": {
            "delta": fit.scene.delta, "integrator": INTEGRATORS[fit.scene.method], "substeps": fit.substeps,
            "tried": fit.steps,
        },
        "windows": fit.windows and {"frames": fit.windows, "whole_rmse": fit.whole},
        "hints": [attributes(hint, "code", "text") for hint in fit.hints],
        "registration": fit.registration and [each.summary() for each in fit.registration],
        "markers": fit.markers and [each.summary(scene.vertex_counts) for each in fit.markers],
        "fabric": [fabric_of(cloth) for cloth in fit.scene.cloths],
        "pins": {"followed": fit.followed},
        "correspondence": fit.correspondence and fit.correspondence.summary(),
        "output": out.path,
    })  # fmt: skip
    return record


@dataclass(frozen=True)
class Page:
    """A page that is to be made of a fit."""

    out: Output
    command: str  # that makes it
    points: list[Point] = field(default_factory=list)  # of the fit's way

    def note(self, progress: Progress) -> None:
        """Take note of a point of the fit's way."""
        from clothfit.report.log import Point

        self.points.append(Point(progress.evaluations, progress.cost, progress.rmse, progress.seconds))

    def write(
        self, scene_path: str, scene: Scene, fit: Fit, files: Files, fitted: Output, targets: list[Any],
        console: Console,
    ) -> None:  # fmt: skip
        """Make and write it, after the fitted scene is written."""
        if fit.status == Status.INTERRUPTED:
            console.say("no report, as the fit was interrupted; clothfit report makes one")
            return
        from clothfit.report.log import Log, thinned

        log = Log(thinned(self.points), summary(scene, fit, fitted), start=fit.start)
        motion = files.pairs[0][0] if files.pairs else None
        commands = [self.command]
        if not fitted.is_stream:
            commands.append(report.evaluation(scene_path, fitted.path, motion, files.reading, files.forces_path))
        target = targets[0] if targets else None
        result = replace(fit.scene, name=os.path.basename(fitted.name))
        origin = commands, report.digests([scene, result], {motion: target, files.forces_path: None})
        show, size = report.write_page(scene, [result], target, None, [log], origin, self.out)
        report.show_result(show, size, self.out, console)


def check_page(path: str | None, scenes: tuple[str, ...], single: bool, files: Files) -> None:
    """Raise a usage error where the fit is none that the page of a --report shows."""
    if path is None:
        return
    context = click.get_current_context()
    if not single:
        why = "--report is for one fit of one scene; make the pages of several with clothfit report"
        raise click.UsageError(why, context)
    shown, scene = (files.of(scenes[0]).pairs or [("", None)])[0]
    if scene is not None:
        raise click.UsageError("--report shows the first --target, which must be of SCENE itself, without @", context)
    if shown.startswith(SHADOWS):
        raise click.UsageError("--report plays the motion of a target, and a shadow has none", context)


# ---- Records of one fit beside its result: the log, and the pictures drawn of it.
#
# `clothfit estimate --log FILE` writes the way of a fit as JSON lines, for other programs to follow: one object for
# each iteration, which is a change of the parameters that was accepted, and another where its point turns out to be the
# best over all frames, with the keys below, all as in `progress.Progress`; null where a number is not finite. At the
# end `{"summary": …}` with what --json prints. Every line is written at once.
#
# A log that cannot be written any more is given up with a warning: the fit is worth more.

KEYS = ("iteration", "evaluations", "seconds", "cost", "rmse", "step", "stage", "window", "frames", "window_rmse")


def earlier(path: str) -> list[dict[str, Any]]:
    """The iterations in the log of an earlier part of the same fit; lines that are none are left out."""
    from clothfit.report.log import parsed

    lines = Path(path).read_text("utf-8", errors="replace").splitlines() if os.path.isfile(path) else []
    items = [item for item in map(parsed, lines) if item]
    return [each for each in items if all(isinstance(each.get(key), int) for key in ("iteration", "evaluations"))]


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
        if self.log_path is None:
            return
        if self.log_path == STREAM or is_among(self.log_path, (*used, *self.pictures.files)):
            raise InvalidInput(f"--log: {self.log_path}: must be a file of its own, not an input or an output")
        check_writable(self.log_path)
        self.log = FitLog(self.log_path, earlier(self.log_path) if resume else [], console)

    def report(self, *others: Callable[[Progress], None] | None) -> Callable[[Progress], None] | None:
        """The function that receives the progress of the fit, and passes it on to others; None where nobody does."""
        kept = None if self.pictures.plot is None else self.history.append
        every = [each for each in (*others, self.log and self.log.record, kept) if each]

        def report_all(progress: Progress) -> None:
            for each in every:
                each(progress)

        return report_all if every else None
