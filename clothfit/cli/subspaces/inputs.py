"""Inputs over time from a file, in place of those of a scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from clothfit.cli.common.scenes import check_there

if TYPE_CHECKING:
    from clothfit.scene.scene import Scene


def with_inputs(scene: Scene, path: str | None) -> Scene:
    """The scene with the inputs of a file. Raises InvalidInput."""
    if path is None:
        return scene
    from clothfit.subspace.recorded.inputs import applied, load

    check_there(path)
    return applied(scene, load(path), str(Path(path).parent), path)
