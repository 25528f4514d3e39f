"""TODO: what is in solve, in which order, how to add one."""
