"""`clothfit subspace record --motion`: motions of other programs as what a subspace is built of."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.errors import InvalidInput
from clothfit.cli.common.console import Console
from clothfit.cli.common.scenes import check_there

if TYPE_CHECKING:
    from clothfit.scene.scene import Scene

RANDOM = ("episodes", "frames", "wind", "pins", "pace", "seed")
"""What says how motions are made at random."""


def collected(scene: Scene, path: str, given: dict[str, Any], console: Console) -> dict[str, Any]:
    """Write the motions that are named to a file, and say what they are; the summary. Raises InvalidInput, UsageError.
    """
    from clothfit.cli.common.motions import read
    from clothfit.cli.fitting.files import motion_and_scene
    from clothfit.formats.axes import Reading
    from clothfit.subspace.recorded.foreign import collect, episode

    asked = [f"--{name}" for name in RANDOM if given[name] is not None]
    if asked:
        raise click.UsageError(f"{asked[0]} makes motions at random; it does not go with --motion")
    if len(given["motions"]) < 2:
        raise InvalidInput("--motion: name two motions at least; the last one is not learned from, but judges")
    reading, motions = Reading(fps=given["fps"]), []
    for name, inputs in map(motion_and_scene, given["motions"]):
        for each in (name, inputs):
            if each is not None:
                check_there(each)
        own = episode(scene, inputs)
        motions.append((read(name, scene, reading, console), own))
    found = collect(scene, motions, path)
    console.say(f"{len(motions)} motions: {found.frames} frames are kept")
    if found.left_out:
        console.warn(f"{found.left_out} frames are left out, which do not show all vertices")
    return asdict(found) | {"episodes": len(motions)}
