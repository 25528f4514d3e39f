"""Files that other tools write and read, by their suffix: one module for each format.

registry lists the formats; axes, convention and animation are what they share.
To add a format: a module with `read(path) -> Animation` and `encoded(path, animation) -> {path: data}` (see registry),
and a line in `registry.FORMATS`.
"""
