"""The scenes that a command reads, how many of their frames, and warnings of simulations that cannot be trusted."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from clothfit.base.errors import InvalidInput, InvalidScene
from clothfit.base.limits import doubts, doubts_of_time
from clothfit.base.messages import unreadable
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import check_numbers, option
from clothfit.cli.common.output import STREAM
from clothfit.scene.text import name_of

if TYPE_CHECKING:
    from clothfit.motion.energy import Energy
    from clothfit.motion.motion import Motion
    from clothfit.scene.scene import Scene

PLACE = re.compile(r"(top level|line \d+, column \d+|(?:[\w.\[\]]|\"[^\"]*\")+): (.*)", re.DOTALL)
"""Where something is wrong, before what is."""

MOST_GAIN = 0.25
"""Energy that contacts may add without a warning, relative to the largest that is kinetic, elastic or of the weight."""

OF_SCENES = "make it again with new --scale {}"
"""What to do with a scene that has another unit."""

STRETCH_ADVICE = "the motion is not to be believed unless they are that soft; try a smaller delta"


forces = option("--forces FILE", "Let the forces of this file act on the cloths, as clothfit control writes them.",
                name="forces_path")  # fmt: skip
"""The option of commands that simulate."""


def read_scene(path: str, console: Console) -> Scene:
    """Load a scene from a path or standard input, and pass its warnings on."""
    check_there(path)
    import clothfit
    from clothfit.base.deferred import defer

    defer()
    try:
        scene = clothfit.load(sys.stdin.buffer if path == STREAM else path)
    except InvalidScene as error:
        raise better(error, path) from None
    console.warn(*scene.warnings, *doubts_of_time(scene.delta, scene.gravity.tolist()), *unlikely(scene), of=scene.name)
    console.detail(f"{scene.name}: {len(scene.cloths)} objects, {sum(scene.vertex_counts)} vertices")
    return scene


def unlikely(scene: Scene) -> list[str]:
    """Doubts about the units of its objects."""
    found = []
    for index, cloth in enumerate(scene.cloths):
        size = (cloth.positions.max(axis=0) - cloth.positions.min(axis=0)).tolist()
        found += [f"objects[{index}]: {each}" for each in doubts(size, float(cloth.mass.sum()), OF_SCENES)]
    return found


def under_forces(scene: Scene, path: str | None, feedback: bool = False) -> Scene:
    """The scene with the forces of a file, where there is one, and their feedback. Raises InvalidInput."""
    if path is None:
        return scene
    from clothfit.scene.forces import load_forces

    return scene.with_forces(load_forces(path, sum(scene.vertex_counts), feedback))


def better(error: InvalidScene, path: str) -> InvalidScene:
    """The error of a file that was read as a scene, or what the file is where it cannot be meant as one."""
    from clothfit.formats.registry import no_scene, suffix_of

    found = None if path == STREAM else no_scene(path, suffix_of(path))
    return error if found is None else InvalidScene(found, error.name)


def split(sentence: str) -> dict[str, str | None]:
    """Place and message of a problem; no place where it is the file as a whole."""
    match = PLACE.fullmatch(sentence)
    return {"place": match[1], "message": match[2]} if match else {"place": None, "message": sentence}


def check_there(*paths: str) -> None:
    """Check that the files exist, before the libraries load. Raises InvalidScene."""
    for path in paths:
        if not path:
            raise InvalidInput("the name of a file is empty; name one")
        try:
            with suppress(ValueError):  # an impossible name; reading it gives the message
                if path != STREAM:
                    os.stat(path)
        except OSError as error:
            raise InvalidScene(unreadable(error), name_of(path)) from None


def frames_of(steps: int | None, scene: Scene) -> int:
    """Number of frames for --steps. Raises InvalidInput when it is not positive."""
    check_numbers(steps)
    return scene.frames if steps is None else steps + 1


def one_stream(*paths: str | None) -> None:
    """Raise InvalidInput when standard input would be read twice."""
    if sum(path == STREAM for path in paths) > 1:
        raise InvalidInput("standard input (-) can be only one of the inputs")


def warn_of_steps(scene: Scene, frames: int, console: Console) -> None:
    """Warn, before the simulation, when explicit or symplectic steps will not stay stable, and of what starts inside
    of something.
    """
    from clothfit.engine.stability import warning
    from clothfit.engine.starts import sentences

    sentence = warning(scene, frames - 1)
    if sentence:
        console.warn(sentence)
    console.warn(*sentences(scene), of=scene.name)


def warn_of_contacts(scene: Scene, motion: Motion, console: Console, energy: Energy | None = None) -> None:
    """Warn when contacts that begin within a step have given the cloths energy: in wind, or in explicit steps."""
    from clothfit.engine.starts import sentences

    if not scene.obstacles or scene.moves or len(motion.times) < 2:  # what moves gives energy as well
        return
    if sentences(scene):  # as does what is let go
        return
    import numpy as np

    from clothfit.motion.energy import energies

    found = energies(scene, motion) if energy is None else energy
    gain, frame = found.gain
    largest = max(np.abs(part).max(where=np.isfinite(part), initial=0.0) for part in found.own)
    if gain <= MOST_GAIN * largest or not found.contact[: frame + 1].any():
        return
    obstacle = "sphere" if scene.spheres else "collider"
    console.warn(
        f"{scene.name}: contacts have added energy: at frame {frame} the cloths have {gain:.3g} J more than at the "
        f"start, and never more than {largest:.3g} J in one place; a cloth meets a {obstacle} too fast for the time "
        "step, so try a smaller delta"
    )


def warn_of_stretch(scene: Scene, motion: Motion, console: Console) -> None:
    """Warn when a simulated motion is finite but ends in a state that cannot be right."""
    from clothfit.motion.divergence import overstretched, overstretched_from

    for index in range(len(scene.cloths)):
        begins = overstretched_from(scene, index, motion.of(index))
        if begins is not None:
            console.warn(f"{scene.name}: objects[{index}]: {overstretched(begins)}; {STRETCH_ADVICE}")


# ---- Inputs over time from a file, in place of those of a scene.

def with_inputs(scene: Scene, path: str | None) -> Scene:
    """The scene with the inputs of a file. Raises InvalidInput."""
    if path is None:
        return scene
    from clothfit.subspace.inputs import applied, load

    check_there(path)
    return applied(scene, load(path), str(Path(path).parent), path)


def vector(values: Sequence[float]) -> str:
    """Three components, for people; -0 is 0."""
    return f"({', '.join(f'{value + 0.0:.4g}' for value in values)})"
