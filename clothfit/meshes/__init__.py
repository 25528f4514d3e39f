"""Scenes without the editor: a triangle mesh becomes the cloth that the editor would build.

mesh (read, make) → problems (clean, weld) → mesh (masses, stiffnesses) → new_scene (fixed vertices, families, regions,
the document).
To add a shape: a function in mesh that returns a Mesh, and an argument of the command `new`.
"""
