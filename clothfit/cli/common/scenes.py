"""The scenes that a command reads, how many of their frames, and warnings of simulations that cannot be trusted."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import TYPE_CHECKING

from clothfit.base.errors import InvalidInput, InvalidScene
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import check_numbers
from clothfit.cli.common.output import STREAM
from clothfit.scene.text import name_of

if TYPE_CHECKING:
    from clothfit.motion.motion import Motion
    from clothfit.scene.scene import Scene

STRETCH_ADVICE = "the motion is not to be believed unless they are that soft; try a smaller delta"


def read_scene(path: str, console: Console) -> Scene:
    """Load a scene from a path or standard input, and pass its warnings on."""
    check_there(path)
    import clothfit
    from clothfit.base.deferred import defer

    defer()
    scene = clothfit.load(sys.stdin.buffer if path == STREAM else path)
    for warning in scene.warnings:
        console.warn(f"{scene.name}: {warning}")
    console.detail(f"{scene.name}: {len(scene.cloths)} objects, {sum(scene.vertex_counts)} vertices")
    return scene


def check_there(*paths: str) -> None:
    """Check that the files exist, before the libraries load. Raises InvalidScene."""
    for path in paths:
        try:
            with suppress(ValueError):  # an impossible name; reading it gives the message
                if path != STREAM:
                    os.stat(path)
        except OSError as error:
            raise InvalidScene(f"cannot be read: {error.strerror or error}", name_of(path)) from None


def frames_of(steps: int | None, scene: Scene) -> int:
    """Number of frames for --steps. Raises InvalidInput when it is not positive."""
    check_numbers(steps)
    return scene.frames if steps is None else steps + 1


def one_stream(*paths: str | None) -> None:
    """Raise InvalidInput when standard input would be read twice."""
    if sum(path == STREAM for path in paths) > 1:
        raise InvalidInput("standard input (-) can be only one of the inputs")


def warn_of_steps(scene: Scene, frames: int, console: Console) -> None:
    """Warn, before the simulation, when explicit or symplectic steps will not stay stable."""
    from clothfit.engine.stability import warning

    sentence = warning(scene, frames - 1)
    if sentence:
        console.warn(sentence)


def warn_of_stretch(scene: Scene, motion: Motion, console: Console) -> None:
    """Warn when a simulated motion is finite but ends in a state that cannot be right."""
    from clothfit.motion.divergence import overstretched, overstretched_from

    for index in range(len(scene.cloths)):
        begins = overstretched_from(scene, index, motion.of(index))
        if begins is not None:
            console.warn(f"{scene.name}: objects[{index}]: {overstretched(begins)}; {STRETCH_ADVICE}")
