"""TODO: what is in scene, in which order, how to add one."""
