"""TODO: what is in motion, in which order, how to add one."""
