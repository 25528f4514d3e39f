"""What a shell may complete: the values that options know, and files by the suffixes of what they take.

The values are written down here, as asking the modules that own them would load NumPy at every key; a test compares
them. Where no file has a likely suffix, all files are named.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from clothfit.formats.registry import FORMATS, NATIVE

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

KINDS = (
    "mass", "stiffness", "damping", "drag", "velocity", "rest", "path", "shift", "wind", "gravity", "gusts", "friction",
    "contact", "offset",
)  # fmt: skip
NOT_OF_NEW = ("path", "shift", "gusts", "friction", "contact", "offset")  # of what a new scene does not have
SIDES = ("left", "right", "bottom", "top", "back", "front")
LETTERS = ("n", "F", "R", "M", "G", "L")

VALUES = {
    "--method": (
        "auto", "momentum", "gauss-newton", "l-bfgs-b", "tnc", "slsqp", "trust-constr", "bfgs", "cg", "nelder-mead",
        "powell", "cobyla",
    ),
    "--objective": ("position", "velocity", "edge-length", "spectrum"),
    "--loss": ("linear", "soft_l1", "huber"),
    "--model": ("auto", "F", "G", "R", "M", "L"),
    "--holdout-of": ("frames", "vertices"),
    "--prior": ("auto", "none"),
    "--substeps": ("auto",),
    "--bounds": tuple(f"{kind}=" for kind in KINDS),
    "--fix-side": SIDES,
    "--integrator": ("explicit", "symplectic", "implicit", "bdf2"),
    "--drag": ("air",),
    "--fit": (
        *(f"n{letter}" for letter in LETTERS), *(f"{letter}n" for letter in LETTERS[1:]), "GG", "LL",
        *(kind for kind in KINDS[2:] if kind not in NOT_OF_NEW),
    ),
}
"""Options to the values that they know; others may take more."""

MOTIONS = (*NATIVE, *(suffix for each in FORMATS for suffix in each.suffixes))
MESHES = (".obj", ".glb", ".gltf", ".ply", ".stl", ".abc", ".usd", ".usda", ".usdc")
SCENES = (".json", ".txt")
SUFFIXES = {
    "SCENE": SCENES, "FITTED": SCENES, "MOTION": MOTIONS, "MESH": MESHES, "IN": MOTIONS, "OUT": MOTIONS,
    "--map": (".csv",), "--log": (".jsonl",), "--mesh": MESHES, "--plot": (".png", ".svg", ".pdf"), "--gif": (".gif",),
    "--dump": (".npz",), "--report": (".html",), "--checkpoint": (".checkpoint",),
}  # fmt: skip
"""Words in the name of a value, and options, to the suffixes of their files; others take any."""

MOST = 1000  # names that are given to a shell


class Known(click.types.StringParamType):
    """A text for which a shell may offer some values and files."""

    def __init__(self, values: Sequence[str] = (), suffixes: Sequence[str] | None = None) -> None:
        self.values, self.suffixes = values, suffixes  # None: no files; empty: all

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Whatever begins as the word that is not complete yet."""
        from click.shell_completion import CompletionItem

        found = [CompletionItem(value) for value in self.values if value.startswith(incomplete)]
        if self.suffixes is not None:
            found += [CompletionItem(path, type="path") for path in paths(incomplete, self.suffixes)]
        return found


def paths(incomplete: str, suffixes: Sequence[str]) -> list[str]:
    """The folders, with a slash, and the files with one of the suffixes (all, where there are none) that begin so."""
    folder, begin = os.path.split(incomplete)
    try:
        with os.scandir(os.path.expanduser(folder) or ".") as entries:
            found = sorted(
                (each.name, each.is_dir()) for each in entries
                if each.name.startswith(begin) and (begin or not each.name.startswith("."))
            )  # fmt: skip
    except OSError:
        return []
    likely = [(name, is_folder) for name, is_folder in found if is_folder or name.lower().endswith(tuple(suffixes))]
    shown = likely if any(not is_folder for _, is_folder in likely) else found
    return [os.path.join(folder, name) + "/" * is_folder for name, is_folder in shown][:MOST]
