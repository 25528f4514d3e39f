"""Fits the values of a tool, cloth by cloth, so that its cloths move like a target."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from clothfit.base.errors import InvalidInput
from clothfit.fit.estimate import record_target
from clothfit.motion.motion import Motion
from clothfit.objective.experiment import experiments
from clothfit.objective.target import Target, target
from clothfit.scene.scene import Scene
from clothfit.simulators import blender, xpbd
from clothfit.simulators.values import MOST_ELEMENTS, ElementFit, Fit, Fitted

SIMULATORS = ("xpbd", "blender")
FEW, EACH = "G", "L"
"""Models: the few values of a tool, or those of each constraint and vertex."""


@dataclass(frozen=True)
class Options:
    """What to fit in, and how far."""

    simulator: str
    settings: xpbd.Settings = field(default_factory=xpbd.Settings)
    blender: str | None = None  # the program
    most: int = 40  # steps of Gauss–Newton
    model: str = FEW
    report: Callable[[str], None] | None = None  # is told how it goes


def estimate(scene: Scene, motion: Motion | None, options: Options) -> list[Fitted]:
    """Fit every cloth of a scene to a motion, or to the scene's own. Raises InvalidInput, Diverged."""
    if motion is None:
        motion = record_target(scene)
    motion = experiments(scene, motion)[0].motion
    asked = options.simulator == "blender"
    with blender.Blender(blender.program(options.blender)) if asked else nullcontext() as more:
        return [fitted(scene, index, motion, options, more) for index in range(len(scene.cloths))]


def fitted(scene: Scene, index: int, motion: Motion, options: Options, more: Any) -> Fitted:
    """Fit one cloth."""
    if options.simulator == "xpbd":
        if options.model == EACH:
            check_count(scene, index, options.settings)
        frames = scene.frames
        tool, every = xpbd.tool_of(scene, index, options.settings, frames), 1
    else:
        every = blender.stride(scene)
        frames = (scene.frames - 1) // every + 1
        tool = blender.tool_of(scene, index, frames, more)
    goal = at_frames(target(motion, index, every * scene.delta, frames - 1), every)
    if not (goal.observed & (goal.places > 0)[:, None]).any():
        raise InvalidInput(f"{scene.name}: objects[{index}]: the target shows nothing after the start")

    def say(error: float, simulations: int) -> None:
        if options.report:
            options.report(f"{tool.name}: RMSE {1e3 * error:.4g} mm after {simulations} simulations")

    few = Fit(tool, goal, say).run(options.most)
    if options.model != EACH:
        return few
    own = xpbd.each_of(scene, index, options.settings, scene.frames)  # from the few values on
    begin = xpbd.as_few(own, xpbd.groups_of(scene, index), few.found)
    found = ElementFit(own.tool(scene.frames), goal, say, begin).run(options.most)
    return replace(found, few=few, simulations=few.simulations + found.simulations)


def check_count(scene: Scene, index: int, settings: xpbd.Settings) -> None:
    """Raise InvalidInput where a cloth has more values of constraints and vertices than are fitted one by one."""
    count = len(xpbd.each_of(scene, index, settings, 2).values)
    if count > MOST_ELEMENTS:
        raise InvalidInput(
            f"{scene.name}: objects[{index}]: --model {EACH} fits at most {MOST_ELEMENTS} values in xpbd, and this "
            f"cloth has {count}; use --model {FEW}, or a mesh of about 50 vertices"
        )


def at_frames(goal: Target, every: int) -> Target:
    """The frames of a target that are frames of the tool, where that has fewer; those between would be guessed."""
    exact = goal.fraction < 1e-6
    if every == 1 or not (exact & (goal.step > 0)).any():
        return goal
    return Target(goal.step[exact], np.zeros(int(exact.sum())), goal.positions[exact], goal.observed[exact],
                  goal.weights[exact] if len(goal.weights) else goal.weights)
