"""Warnings of simulations that cannot be trusted: before they begin, and where they end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clothfit.cli.common.console import Console

if TYPE_CHECKING:
    from clothfit.motion.motion import Motion
    from clothfit.scene.scene import Scene

STRETCH_ADVICE = "the motion is not to be believed unless they are that soft; try a smaller delta"


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
