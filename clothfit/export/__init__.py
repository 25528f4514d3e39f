"""Fitted masses and stiffnesses for other cloth tools: one module per tool.

tools lists them and has the plain tables (CSV); obi (Unity), blender and vellum (Houdini) write; topology is what
they share.
handles has the paths of pins, in glTF and USD.
To add a tool: a module with a function `(scene) -> {name: content}`, a line in `tools.TOOLS`, and what its numbers mean
in `docs/export.md`.
"""
