"""The buttons."""

import bpy

from . import command, making, results

running = {}
"""The job that runs, by the name `job`: one at a time."""


def start(context, calls, result, then):
    """Run calls beside Blender. Raises Failed."""
    if "job" in running:
        raise command.Failed("clothfit runs already; wait, or cancel it")
    words = command.program(context.preferences.addons[__package__].preferences.program)
    running["job"] = command.Job(words, calls, result, then)
    bpy.app.timers.register(look, first_interval=command.PATIENCE)


def look():
    """Called by Blender's timer: seconds to the next look, None at the end."""
    job = running.get("job")
    if job is None:
        return None
    try:
        goes_on = job.poll()
    except command.Failed as error:
        job.message, job.failed, goes_on = str(error), True, False
    window = bpy.context.window_manager
    window["clothfit"] = job.progress if goes_on else ("error: " if job.failed else "") + job.message
    for each in window.windows:
        for area in each.screen.areas:
            area.tag_redraw()
    if goes_on:
        return command.PATIENCE
    del running["job"]
    return None


class Button(bpy.types.Operator):
    """What all buttons share: they act on the active mesh, and report what goes wrong."""

    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.type == "MESH" and context.mode == "OBJECT"

    def execute(self, context):
        try:
            self.act(context, context.object, making.Paths(context.object))
        except (command.Failed, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class CLOTHFIT_OT_scene(Button):
    bl_idname, bl_label = "clothfit.scene", "Write the scene"
    bl_description = "Write this cloth as a scene of clothfit"

    def act(self, context, thing, paths):
        making.write_mesh(thing, paths.mesh)
        start(context, [making.new_call(context, thing, paths)], paths.scene, lambda path: None)


class CLOTHFIT_OT_fit(Button):
    bl_idname, bl_label = "clothfit.fit", "Fit"
    bl_description = "Record the target and fit the cloth to it; Blender goes on meanwhile"

    def act(self, context, thing, paths):
        calls = making.fit_calls(context, thing, paths)
        start(context, calls, paths.fitted, lambda path: results.play(bpy.context, thing, paths))


class CLOTHFIT_OT_cancel(bpy.types.Operator):
    bl_idname, bl_label = "clothfit.cancel", "Cancel"
    bl_description = "End the fit and keep the best so far"

    @classmethod
    def poll(cls, context):
        return "job" in running

    def execute(self, context):
        running["job"].cancel()
        return {"FINISHED"}


class CLOTHFIT_OT_apply(Button):
    bl_idname, bl_label = "clothfit.apply", "Apply values"
    bl_description = "Set the cloth modifier to the fitted values, as far as Blender's model has them"

    def act(self, context, thing, paths):
        export = ["export", str(results.needed(paths.fitted)), "--to", "blender", "-o", str(paths.values)]
        start(context, [export], paths.values, lambda path: results.apply(bpy.context, thing, paths))


class CLOTHFIT_OT_colour(Button):
    bl_idname, bl_label = "clothfit.colour", "Colour by stiffness"
    bl_description = "Colour the mesh by the fitted stiffness: blue soft, red stiff"

    def act(self, context, thing, paths):
        results.colour(thing, paths)


CLASSES = [CLOTHFIT_OT_scene, CLOTHFIT_OT_fit, CLOTHFIT_OT_cancel, CLOTHFIT_OT_apply, CLOTHFIT_OT_colour]


def register():
    for each in CLASSES:
        bpy.utils.register_class(each)


def unregister():
    if "job" in running:
        running.pop("job").cancel()
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
