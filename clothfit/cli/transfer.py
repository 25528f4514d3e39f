"""`clothfit transfer`: the fabric of one scene on the mesh of another."""

from __future__ import annotations

import json
from dataclasses import replace
from io import StringIO

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted, owned
from clothfit.cli.common.console import Console
from clothfit.cli.common.motions import one_stream, read_scene
from clothfit.cli.common.options import option, standard_command
from clothfit.cli.common.output import SCENE, output_for, print_json, uninterrupted, write_scene


@standard_command("transfer")
@click.argument("fitted_path", metavar="FITTED")
@click.argument("scene_path", metavar="NEW_SCENE")
@option("-o --output SCENE", "Scene file.  [default: <stem of NEW_SCENE>.transferred<suffix>]", name="path")
def command(fitted_path: str, scene_path: str, path: str | None, console: Console) -> None:
    """Give the cloths of NEW_SCENE the fabric of those of FITTED: weight, stretch and bending per area and width,
    damping and air drag, whatever their meshes.

    \b
    clothfit transfer scene.json finer.json
    clothfit transfer skirt.fitted.json coat.json -o coat.denim.json

    One cloth in FITTED is for all, else each is for that with its number.
    """
    one_stream(fitted_path, scene_path)
    suffix = f".transferred{'.json' if scene_path == '-' else scene_path[scene_path.rfind('.') :]}"
    out = output_for(path, scene_path, suffix, (fitted_path,), text=SCENE)
    fitted, scene = read_scene(fitted_path, console), read_scene(scene_path, console)
    sources = fitted.cloths * (len(scene.cloths) if len(fitted.cloths) == 1 else 1)
    if len(sources) != len(scene.cloths):
        raise InvalidInput(f"{fitted.name} has {counted(len(fitted.cloths), 'cloth', 'cloths')} and {scene.name} "
                           f"{len(scene.cloths)}; one is for all, else as many are needed")  # fmt: skip
    from clothfit.fabric.transfer import transferred
    from clothfit.meshes.new_scene import text
    from clothfit.scene.scene import load

    document = json.loads(scene.source.text)
    records = []
    for index, (source, target) in enumerate(zip(sources, scene.cloths, strict=True)):
        found = transferred(source, target)
        document["objects"][index] |= found.fields
        if found.pushes:
            document["forwardSubSteps"] = max(2, scene.newton_iterations)
        records.append({"pushes": found.pushes, "local": found.local})
        where = "with its local differences" if found.local else "the same everywhere"
        console.say(f"{owned(index, 'fabric')}: of {fitted.name}, {where} → {out.name}")
    with uninterrupted():
        write_scene(replace(load(StringIO(text(document)), folder=scene.folder), name=scene.name), out)
    print_json({"scene": scene.name, "fitted": fitted.name, "objects": records, "output": out.path})
