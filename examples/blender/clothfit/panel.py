"""The panel, among those of physics of a mesh."""

import bpy

from . import operators


class CLOTHFIT_PT_panel(bpy.types.Panel):
    bl_idname, bl_label = "CLOTHFIT_PT_panel", "Clothfit"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "physics"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.type == "MESH"

    def draw(self, context):
        layout, own = self.layout, context.object.clothfit
        layout.use_property_split = True
        layout.prop(own, "target")
        if own.target != "OWN":
            layout.prop(own, "other" if own.target == "OBJECT" else "path")
        for name in ("density", "stiffness", "letters", "damping", "drag", "options", "folder"):
            layout.prop(own, name)
        layout.operator("clothfit.cancel" if "job" in operators.running else "clothfit.fit")
        said = context.window_manager.get("clothfit")
        if said:
            layout.label(text=said, icon="ERROR" if said.startswith("error: ") else "INFO")
        row = layout.row()
        row.operator("clothfit.apply")
        row.operator("clothfit.colour")
        layout.operator("clothfit.scene")


def register():
    bpy.utils.register_class(CLOTHFIT_PT_panel)


def unregister():
    bpy.utils.unregister_class(CLOTHFIT_PT_panel)
