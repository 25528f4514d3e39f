"""`clothfit estimate --cache FILE`: the fitted motion at the times of the target's frames, for the program it is from.

Where the target and FILE are USD, FILE is a copy of the target's file in which the points of the cloth's meshes are the
fitted ones: the same names, time codes, unit and axes, and all else that is there. Else FILE holds the cloth alone, in
the target's axes and unit where its format can have them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted
from clothfit.cli.common import motions
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import Output, beside
from clothfit.formats.axes import Axes, Convention
from clothfit.formats.registry import foreign, format_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from clothfit.cli.parts.estimate_files import Files
    from clothfit.registration.record import Registration
    from clothfit.scene.scene import Scene


def place_of(files: Files, used: Iterable[str | None]) -> Output | None:
    """Where the cache goes, where one is asked for. Raises InvalidInput."""
    if files.cache is None:
        return None
    if len(files.pairs) != 1 or files.pairs[0][1] is not None:
        raise InvalidInput("--cache needs one --target, which must be of SCENE itself")
    out = beside("--cache", files.cache, used)
    assert out is not None
    format_of(out.path, writing=True)
    motions.check(out, Convention(), [files.pairs[0][0]])
    return out


def write(fitted: Scene, files: Files, known: Registration, out: Output, console: Console) -> None:
    """Write the motion of a fitted scene in the time and the place of its target, which are `known`; before the scene
    begins it stands still. Raises InvalidInput.
    """
    import numpy as np

    from clothfit.motion.foreign import load
    from clothfit.motion.motion import Motion
    from clothfit.motion.simulate import simulate
    from clothfit.motion.times import frame_places, interpolated

    path, written = files.pairs[0][0], foreign(out.path)
    target = load(path, fitted, replace(files.reading, frames=None))
    own = replace(target.motion, times=np.maximum(known.times(target.motion.times), 0.0))
    step, fraction = frame_places(own, fitted.delta)
    every = simulate(fitted, int(step.max()) + 2)
    x = known.taken_back(interpolated(every.positions, step, fraction))
    motion = Motion(x, target.motion.times, fitted.vertex_counts)
    axes = target.interpretation.axes
    if written is not None and written.name == "USD" == target.interpretation.format:
        from clothfit.formats import usd
        from clothfit.motion.files import animation, for_tools

        whole, _ = for_tools(motion, fitted, written)
        points = animation(whole, written, axes).positions
        out.write(usd.with_points(path, out.path, points, str(target.motion.said.get("mesh", ""))))
        console.say(f"{out.path}: {path} with the fitted cloth, {counted(len(x), 'frame', 'frames')}, {axes}")
        return
    alike = written is not None and foreign(path) is not None and written.name != "glTF"
    motions.write(motion, out, fitted, Convention(*_said(axes)) if alike else Convention(), console)


def _said(axes: Axes) -> tuple[float, str, str]:
    return axes.scale, axes.up, axes.handedness
