"""A report: two scenes and perhaps a target motion → one HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clothfit.motion.motion import Motion
from clothfit.report.assembly import page
from clothfit.report.contents import content
from clothfit.report.log import Log
from clothfit.report.showing import Shown, shown
from clothfit.scene.scene import Scene


def report_page(
    truth: Scene,
    fitted: Scene,
    target: Motion | None = None,
    *,
    frames: int | None = None,
    log: Log | None = None,
    commands: Sequence[str] = (),
    inputs: Sequence[tuple[str, str]] = (),
) -> bytes:
    """The page, HTML in UTF-8, that plays a fitted scene over the true one, or over a target where one is given.

    `frames` counts the initial state (default: those of `evaluate`, fewer for large scenes). `log` is the course of the
    fit. The page shows `commands`, which repeat the fit, and `inputs`, name and SHA-256 of each file. Raises
    InvalidInput when scenes or target do not fit, Diverged when a motion has no second frame.
    """
    show = shown(truth, fitted, target, frames)
    return made(truth, fitted, target, show, log, commands, inputs)


def made(
    truth: Scene,
    fitted: Scene,
    target: Motion | None,
    show: Shown,
    log: Log | None = None,
    commands: Sequence[str] = (),
    inputs: Sequence[tuple[str, str]] = (),
) -> bytes:
    """The page of motions that are already simulated."""
    parts: dict[str, Any] = content(truth, fitted, show, log or Log(), None if target is None else target.name)
    return page({**parts, "commands": list(commands), "inputs": [list(pair) for pair in inputs]})
