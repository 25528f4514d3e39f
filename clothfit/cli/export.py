"""`clothfit export`: fitted values for other cloth tools."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted
from clothfit.cli.common.console import Console
from clothfit.cli.common.motions import read_scene
from clothfit.cli.common.options import option, section, standard_command
from clothfit.cli.common.output import STREAM, print_json, write_into
from clothfit.export.dropped import SOLVERS, dropped
from clothfit.export.tools import TOOLS, exported, own_step

if TYPE_CHECKING:
    from clothfit.scene.cloth import Cloth

ONNX = "onnx"
"""What a subspace can be exported to."""

MOST_NAMES = 5
"""Of files in the line that says where they are."""


@standard_command("export")
@click.argument("fitted_path", metavar="FITTED")
@section("What is written")
@option("--to TOOL", "Tool: csv, obi, blender, vellum, gltf or usd; of a subspace onnx.",
        click.Choice([*TOOLS, ONNX], case_sensitive=False), name="tool", required=True)
@option("-o --output FOLDER", "Folder of the files.  [default: <stem>-<tool>]", name="path")
def command(fitted_path: str, tool: str, path: str | None, console: Console) -> None:
    """Write the masses and stiffnesses of FITTED, or the paths of its pins, in the form that other tools read.

    csv: tables of objects, vertices and springs. obi: masses and compliances, 1/k, of Obi Cloth for Unity, as JSON.
    blender: vertex groups and ranges for Blender's cloth modifier, as JSON and as a script that sets them. vellum:
    geometry and constraints for Houdini, and mantissa and exponent of the mean stiffness. gltf, usd: the paths of pins
    as animated nodes. onnx: of a MODEL of clothfit subspace the decoder and, of a network, the step, each as a graph.

    docs/export.md explains what the numbers mean there and what is lost.

    \b
    clothfit export scene.fitted.json --to csv
    clothfit export scene.fitted.json --to blender -o for-blender
    clothfit export scene.json --to gltf
    clothfit export scene.model.npz --to onnx
    """
    if tool == ONNX:
        of_model(fitted_path, path, console)
        return
    scene = read_scene(fitted_path, console)
    folder = folder_of(path, fitted_path, tool)
    lost = dropped(scene, tool)
    if tool in SOLVERS[1:]:
        console.say(f"the same motion in any program is a cache: clothfit simulate {fitted_path} -o cloth.pc2")
    if lost:
        console.warn(f"{scene.name}: {tool} does not get {', '.join(lost)}")
    if warning := own_step(scene, tool):
        console.warn(f"{scene.name}: {warning}")
    made = exported(scene, tool)
    write_into(folder, made, fitted_path)
    springs = sum(len(cloth.springs) for cloth in scene.cloths)
    parts = (
        counted(len(scene.cloths), "object", "objects"),
        counted(sum(scene.vertex_counts), "vertex", "vertices"),
        counted(springs, "spring", "springs"),
    )
    names = ", ".join(made) if len(made) <= MOST_NAMES else f"{len(made)} files"
    console.say(f"{scene.name}: {', '.join(parts)} → {folder}: {names}")
    objects = [{"object": number, **described(cloth)} for number, cloth in enumerate(scene.cloths)]
    more = {"files": list(made), "objects": objects, "dropped": lost}
    print_json({"scene": scene.name, "to": tool, "output": folder, **more})


def of_model(model_path: str, path: str | None, console: Console) -> None:
    """Export a subspace."""
    from clothfit.subspace import onnx
    from clothfit.subspace.model import NETWORK, load_model

    if model_path == STREAM:
        raise InvalidInput("MODEL must be a file; - was given")
    model = load_model(model_path)
    folder = folder_of(path, model_path, ONNX)
    made = onnx.files(model)
    write_into(folder, made, model_path)
    name = os.path.basename(model_path)
    if model.method != NETWORK:
        console.warn(f"{name}: its steps are physics, which is no graph; the decoder alone is written")
    sizes = ", ".join(f"{each} ({len(data) / 1e6:.2g} MB)" for each, data in made.items())
    console.say(f"{name}: {model.method} → {folder}: {sizes}")
    print_json({"model": name, "method": model.method, "to": ONNX, "output": folder, "files": list(made)})


def folder_of(path: str | None, fitted_path: str, tool: str) -> str:
    """Where the files go. Raises InvalidInput where nothing says so."""
    if path == STREAM or (path is None and fitted_path == STREAM):
        raise InvalidInput("an export is several files, which need a folder; name one with -o")
    return path or f"{Path(fitted_path).stem}-{tool}"


def described(cloth: Cloth) -> dict[str, Any]:
    """Counts and means of an object."""
    from clothfit.export.topology import roles

    role = roles(cloth)
    kinds = {"traction": role.traction, "bending": role.bending, "other": ~(role.traction | role.bending)}
    return {
        "vertices": len(cloth.mass),
        "mass": float(cloth.mass.mean()),
        "springs": {name: int(chosen.sum()) for name, chosen in kinds.items()},
        "stiffness": {
            name: float(cloth.stiffness[chosen].mean()) if chosen.any() else None for name, chosen in kinds.items()
        },
    }
