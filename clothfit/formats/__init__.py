"""Files that other tools write and read, by their suffix: one module for each format.

registry is the table of what a file is. All share animation (what a file holds), axes (the meaning of coordinates) and
files (bytes and errors). obj, ply, stl, alembic and point_cache stand alone; glb reads through gltf; c3d shares
markers with the tables in text (CSV, TRC); usd reads in a process of its own, usd_reader.
To add a format: a module with `read(path) -> Animation` and `encoded(path, animation) -> {path: data}` (see registry),
and a line in `registry.FORMATS`.
"""
