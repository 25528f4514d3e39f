"""`clothfit evaluate`: how good is a fitted scene?"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from clothfit.cli import shared
from clothfit.cli.console import Console, metres
from clothfit.errors import Diverged
from clothfit.words import owned

if TYPE_CHECKING:
    from clothfit.evaluation import Evaluation


@shared.command("evaluate")
@click.argument("scene_path", metavar="SCENE")
@click.argument("fitted_path", metavar="FITTED")
@click.option("--target", "target_path", metavar="MOTION", help="Compare with this motion instead of SCENE's own.")
@click.option("--steps", type=int, metavar="N", help="Steps of the longer run.  [default: 499, that is 500 frames]")
def command(
    scene_path: str,
    fitted_path: str,
    target_path: str | None,
    steps: int | None,
    as_json: bool,
    console: Console,
) -> int:
    """Measure how far the motion and the parameters of FITTED are from those of SCENE.

    \b
    clothfit evaluate scene.json scene.fitted.json
    clothfit evaluate scene.json scene.fitted.json --target capture.npz --json
    """
    shared.one_stream(scene_path, fitted_path, target_path)
    shared.check_numbers(steps)
    shared.check_there(scene_path, fitted_path)
    truth = shared.read_scene(scene_path, console)
    fitted = shared.read_scene(fitted_path, console)
    from clothfit.evaluation import HORIZON, evaluate

    horizon = HORIZON if steps is None else shared.frames_of(steps, truth)
    target = shared.read_motion(target_path, truth) if target_path is not None else None
    console.announce_compilation()
    report = evaluate(truth, fitted, horizon=horizon, target=target)
    if as_json:
        shared.print_json("evaluate", summary(report))
    else:
        show(report, console)
    if report.diverged:
        raise Diverged(f"{report.diverged}; the horizon ends before that", report.horizon.frames)
    return 0


def summary(report: Evaluation) -> dict[str, Any]:
    """What --json prints."""
    return {
        "frames": report.fitted.frames,
        "rmse": report.fitted.rmse,
        "max_error": report.fitted.max_error,
        "horizon": asdict(report.horizon),
        "diverged": report.diverged,
        "parameters": [asdict(deviation) for deviation in report.parameters],
    }


def show(report: Evaluation, console: Console) -> None:
    """Print the report as two tables."""
    rows: list[tuple[str, ...]] = [("motion", "frames", "RMSE", "largest error")]
    for name, part in (("fitted", report.fitted), ("horizon", report.horizon)):
        rows.append((name, str(part.frames), metres(part.rmse), metres(part.max_error)))
    console.table(rows)
    if report.parameters:
        console.say("")
        rows = [("parameters", "count", "median deviation", "largest deviation")]
        for d in report.parameters:
            values = [
                "not identifiable" if v is None else f"{v:.2g}"
                for v in (d.median_relative_deviation, d.max_relative_deviation)
            ]
            rows.append((f"{owned(d.object, d.name)} ({d.mode})", str(d.count), *values))
        console.table(rows)
