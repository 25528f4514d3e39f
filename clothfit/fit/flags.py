"""What a fit is asked to find, in place of the flags of its scene: kinds by name, or `auto`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import meant
from clothfit.fit.options import Request
from clothfit.scene.kinds import CLOTH_KINDS, KIND, LETTERED, SCENE_KINDS
from clothfit.scene.scene import Scene

AUTO_MODES = {"stiffness": "M", "damping": "G", "drag": "G", "wind": "G", "gravity": "G"}
"""What `auto` fits where nothing chooses among them."""

SETTINGS = "nFRMGL"


def reflagged(scene: Scene, options: Request) -> Scene:
    """The scene with the flags that the options ask for, or the scene by its `auto`, in place of its own. Raises
    InvalidInput.
    """
    if options.auto or (scene.auto and not options.fit):
        return auto_flags(scene)
    return with_flags(scene, modes_of(options.fit)) if options.fit else scene


def auto_flags(scene: Scene) -> Scene:
    """The scene with the flags of `auto` in place of its own; friction where something has it."""
    return with_flags(scene, AUTO_MODES | ({"friction": "G"} if scene.laws else {}))


def modes_of(texts: Sequence[str]) -> dict[str, str]:
    """Modes by names of kinds, from texts such as "wind", "stiffness=R" or two letters as "nR". Raises InvalidInput."""
    found: dict[str, str] = {}
    for text in texts:
        name, equals, letter = text.partition("=")
        if len(text) == len(LETTERED) and all(each.upper() in SETTINGS.upper() for each in text):
            found |= {kind: "n" if each in "nN" else each.upper() for kind, each in zip(LETTERED, text, strict=True)}
            continue
        if name not in KIND:
            raise InvalidInput(f"fit: there is no {name!r}; use auto, two letters, or {', '.join(KIND)}"
                               f"{meant(name, KIND)}")  # fmt: skip
        modes = KIND[name].modes
        mode = letter.upper() if equals else "F" if name in LETTERED else "G" if "G" in modes else modes[0]
        if len(mode) != 1 or mode not in modes:
            raise InvalidInput(f"fit: {name} cannot be fitted as {letter!r}; use {' or '.join(modes)}")
        found[name] = mode
    return found


def with_flags(scene: Scene, modes: Mapping[str, str]) -> Scene:
    """The scene with these modes, by names of kinds, in place of its flags. Raises InvalidInput where it has nothing of
    a kind.
    """
    settings = "".join(modes.get(name, "n") for name in LETTERED)
    own, whole = (
        {kind.name: modes[kind.name] for kind in kinds if kind.name in modes and kind.name not in LETTERED}
        for kinds in (CLOTH_KINDS, SCENE_KINDS)
    )
    cloths = tuple(replace(cloth, settings=settings, fits=own) for cloth in scene.cloths)
    found = replace(scene, cloths=cloths, fits=whole)
    there = {block.name for block in found.blocks if block.count}
    for name, mode in modes.items():
        if mode != "n" and name not in there:
            raise InvalidInput(f"fit: {scene.name} has no {KIND[name].title} to fit")
    return found
