"""Fits the values of a tool, cloth by cloth, so that its cloths move like a target."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.fit.estimate import record_target
from clothfit.motion.motion import Motion
from clothfit.objective.experiment import experiments
from clothfit.objective.target import Target, target
from clothfit.scene.scene import Scene
from clothfit.simulators import xpbd
from clothfit.simulators.many_values import ManyFit
from clothfit.simulators.values import Fit, Fitted, Tool

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
    with opened(options) as more:
        return [fitted(scene, index, motion, options, more) for index in range(len(scene.cloths))]


@contextmanager
def opened(options: Options) -> Iterator[Any]:
    """What a tool needs beside the scene: a running Blender."""
    if options.simulator != "blender":
        yield None
        return
    from clothfit.simulators import blender_process

    with blender_process.Blender(blender_process.program(options.blender)) as running:
        yield running


def fitted(scene: Scene, index: int, motion: Motion, options: Options, more: Any) -> Fitted:
    """Fit one cloth."""
    if options.simulator == "xpbd":
        from clothfit.simulators import xpbd_values

        frames = scene.frames
        tool, every = xpbd_values.tool_of(scene, index, options.settings, frames), 1
    else:
        from clothfit.simulators import blender

        every = blender.stride(scene)
        frames = (scene.frames - 1) // every + 1
        tool = blender.tool_of(scene, index, frames, more)
    goal = at_frames(target(motion, index, every * scene.delta, frames - 1), every)
    if not (goal.observed & (goal.places > 0)[:, None]).any():
        raise InvalidInput(f"{scene.name}: objects[{index}]: the target shows nothing after the start")

    def told(error: float, simulations: int) -> None:
        if options.report:
            options.report(f"{tool.name}: RMSE {1e3 * error:.4g} mm after {simulations} simulations")

    found = Fit(tool, goal, told).run(options.most)
    return each(scene, index, goal, options, found, told, more) if options.model == EACH else found


def each(
    scene: Scene, index: int, goal: Target, options: Options, few: Fitted, told: Callable[[float, int], None], more: Any
) -> Fitted:
    """Fit the values of each constraint and vertex, from the few on; in Blender, whose derivatives are those of a model
    nearby, from the mapped ones too, and what ends nearer counts.
    """
    from clothfit.simulators import blender, xpbd_values

    def descent(tool: Tool, begin: Array | None, few: Fitted) -> Fitted:
        fit = ManyFit(tool, goal, told)
        fit.begin = begin
        return replace(fit.run(options.most), few=few)

    if options.simulator != "blender":
        tool, begin = xpbd_values.each_of(scene, index, options.settings, scene.frames, few.found)
        found = [descent(tool, begin, few)]
    else:
        mapped = np.array([value.mapped for value in few.tool.values])
        starts = [few] if (mapped == few.found).all() else [few, replace(few, found=mapped)]
        tools = [blender.tool_of(scene, index, goal.last_step + 1, more, start.found) for start in starts]
        found = [descent(tool, None, start) for tool, start in zip(tools, starts, strict=True)]
    best = min(found, key=lambda each: each.rmse)
    return replace(best, simulations=few.simulations + sum(each.simulations for each in found))


def at_frames(goal: Target, every: int) -> Target:
    """The frames of a target that are frames of the tool, where that has fewer; those between would be guessed."""
    exact = goal.fraction < 1e-6
    if every == 1 or not (exact & (goal.step > 0)).any():
        return goal
    return Target(goal.step[exact], np.zeros(int(exact.sum())), goal.positions[exact], goal.observed[exact],
                  goal.weights[exact] if len(goal.weights) else goal.weights)
