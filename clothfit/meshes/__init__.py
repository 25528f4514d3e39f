"""Scenes without the editor: a triangle mesh becomes a cloth as the front end would build it.

mesh_file (read) → problems and weld (clean) → topology (edges, bending) → mesh (masses, stiffnesses) → fixing (what is
held) → new_scene (the document).
To add a shape: a function in mesh that returns a Mesh, and a word in the command `new`.
"""
