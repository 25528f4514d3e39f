"""TODO: what is in meshes, in which order, how to add one."""
