"""TODO: what is in objective, in which order, how to add one."""
