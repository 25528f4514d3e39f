"""Fit the values of a cloth to a recorded motion with the installed program `clothfit`.

files writes meshes and motions and reads results · command runs the program beside Blender · making turns an object
into a scene and a target · results shows what a fit has found · operators, settings and panel are what the user sees.
"""

from . import operators, panel, settings


def register():
    settings.register()
    operators.register()
    panel.register()


def unregister():
    panel.unregister()
    operators.unregister()
    settings.unregister()
