"""Uses the add-on as somebody in Blender does, and prints what came of it, in a Python with Blender as a module.

Arguments: the add-on as a zip file, a folder, the line that starts clothfit. Timers do not run without a window, so
their function is called here.
"""

import importlib
import json
import re
import shutil
import sys
import time

import bpy
import numpy as np

ARCHIVE, FOLDER, PROGRAM = sys.argv[1:]
LONG = "--start 1 --rmse 0 --max-evaluations 1000000 --method l-bfgs-b --prior none --substeps 50"
LIMIT = 300  # s


def cloth():
    """A square of 1 m of 8 x 8 vertices that a pin group holds at one side."""
    n = 8
    points = [(i / (n - 1), j / (n - 1), 1.0) for j in range(n) for i in range(n)]
    faces = [(a, a + 1, a + n + 1, a + n) for j in range(n - 1) for a in range(n * j, n * j + n - 1)]
    mesh = bpy.data.meshes.new("cloth")
    mesh.from_pydata(points, [], faces)
    made = bpy.data.objects.new("cloth", mesh)
    bpy.context.scene.collection.objects.link(made)
    made.rotation_euler = (0.1, 0.2, 0.3)
    group = made.vertex_groups.new(name="pins")
    group.add(list(range(n)), 1.0, "REPLACE")
    settings = made.modifiers.new("Cloth", "CLOTH").settings
    settings.vertex_group_mass = "pins"
    bpy.context.view_layer.objects.active = made
    bpy.context.view_layer.update()
    return made


def places(thing, frame):
    bpy.context.scene.frame_set(frame)
    seen = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    flat = np.empty(3 * len(seen.data.vertices), np.float32)
    seen.data.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3)


def wait(operators, until=lambda said: False, then=lambda: None):
    """Look until the job ends; once `until` is so, do something."""
    seen, end, asked = [], time.monotonic() + LIMIT, False
    while operators.look() is not None:
        said = bpy.context.window_manager["clothfit"]
        seen += [said] if said not in seen else []
        if until(said) and not asked:
            asked = True
            then()
        if time.monotonic() > end:
            raise TimeoutError(seen)
        time.sleep(0.05)
    return [*seen, bpy.context.window_manager["clothfit"]]


def refused(button):
    """The message of a button that refuses."""
    try:
        button()
    except RuntimeError as error:
        return str(error).strip()
    return None


def main():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(filepath=ARCHIVE, repo="user_default", enable_on_install=True)
    addons = bpy.context.preferences.addons
    name = next(each.module for each in addons if each.module.endswith(".clothfit"))
    operators = importlib.import_module(f"{name}.operators")
    preferences = bpy.context.preferences.addons[name].preferences
    found = {"name": name}

    scene, thing = bpy.context.scene, cloth()
    scene.render.fps, scene.frame_start, scene.frame_end = 50, 3, 22
    thing.modifiers["Cloth"].point_cache.frame_start, thing.modifiers["Cloth"].point_cache.frame_end = 3, 22
    own = thing.clothfit
    found["unsaved"] = refused(bpy.ops.clothfit.fit)
    own.folder, own.letters, preferences.program = FOLDER, "F", "no-such-program"
    found["lost"] = refused(bpy.ops.clothfit.fit)
    preferences.program = PROGRAM
    found["early"] = refused(bpy.ops.clothfit.apply)

    bpy.ops.clothfit.fit()
    found["twice"] = refused(bpy.ops.clothfit.scene)
    found["fit"] = wait(operators)
    for kind in ("fitted", "target"):  # a later fit writes others
        shutil.copy(f"{FOLDER}/cloth.{kind}.pc2", f"{FOLDER}/first.{kind}.pc2")
    found["played"] = places(bpy.data.objects["cloth fitted"], 12).tolist()
    found["moved"] = list(bpy.data.objects["cloth fitted"].location)
    bpy.context.view_layer.objects.active = thing

    before = thing.modifiers["Cloth"].settings.mass
    bpy.ops.clothfit.apply()
    found["apply"] = wait(operators)
    settings = thing.modifiers["Cloth"].settings
    found["values"] = [before, settings.mass, settings.tension_stiffness, settings.quality]
    found["speed"] = settings.time_scale
    found["pin"] = settings.vertex_group_mass
    bpy.ops.clothfit.colour()
    attribute = thing.data.color_attributes["clothfit stiffness"]
    found["colours"] = len({tuple(round(x, 3) for x in each.color) for each in attribute.data})

    own.target, own.other = "OBJECT", bpy.data.objects["cloth fitted"]
    own.letters, own.options = "L", LONG
    bpy.ops.clothfit.fit()
    errors = set()

    def better(said):
        """Whether the fit is better than its start."""
        errors.update(re.findall("RMSE [^,]+", said))
        return len(errors) > 1

    found["cancel"] = wait(operators, better, bpy.ops.clothfit.cancel)
    own.target, own.path, own.options = "FILE", "no such file.pc2", ""
    bpy.ops.clothfit.fit()
    found["missing"] = wait(operators)
    print("found: " + json.dumps(found))


main()
