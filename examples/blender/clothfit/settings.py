"""What the user chooses: on each object, and once for the add-on."""

import bpy

LETTERS = [
    ("F", "One factor", "The stiffnesses keep their proportions"),
    ("R", "By family", "One factor for each direction of the springs"),
    ("M", "A smooth map", "A map of factors over the cloth"),
    ("L", "Each spring", "Every stiffness by itself"),
    ("auto", "The simplest that fits", "The simplest of these, unless a freer one is clearly better"),
]

TARGETS = [
    ("OWN", "Its own cloth", "The motion of this object as it plays now"),
    ("OBJECT", "Another object", "The motion of an object with as many vertices in the same order"),
    ("FILE", "A file", "Any motion that clothfit reads, such as PC2, Alembic, USD or OBJ files"),
]


class ClothfitPreferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    program: bpy.props.StringProperty(
        name="Program", default="clothfit", description="Name or path of clothfit; or a Python and -m clothfit"
    )

    def draw(self, context):
        self.layout.prop(self, "program")


class ClothfitSettings(bpy.types.PropertyGroup):
    target: bpy.props.EnumProperty(name="Target", items=TARGETS, description="The motion that the cloth should have")
    other: bpy.props.PointerProperty(name="Object", type=bpy.types.Object, description="The object with the motion")
    path: bpy.props.StringProperty(name="File", subtype="FILE_PATH", description="The file with the motion")
    folder: bpy.props.StringProperty(
        name="Folder", subtype="DIR_PATH", default="//clothfit", description="Where scenes and motions are written"
    )
    density: bpy.props.FloatProperty(
        name="Density (kg/m²)", default=0.2, min=1e-4, precision=3, description="Mass of a square metre, not fitted"
    )
    stiffness: bpy.props.FloatProperty(
        name="Stiffness (N/m)", default=50.0, min=1e-3, description="Stiffness from which the fit starts"
    )
    letters: bpy.props.EnumProperty(name="Fit", items=LETTERS, description="How the stiffnesses are fitted")
    damping: bpy.props.BoolProperty(name="Fit damping", default=True, description="Fit the damping as well")
    drag: bpy.props.BoolProperty(name="Fit air drag", description="Fit the drag of the air as well")
    options: bpy.props.StringProperty(name="Options", description="More options of clothfit estimate")


CLASSES = [ClothfitPreferences, ClothfitSettings]


def register():
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Object.clothfit = bpy.props.PointerProperty(type=ClothfitSettings)


def unregister():
    del bpy.types.Object.clothfit
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
