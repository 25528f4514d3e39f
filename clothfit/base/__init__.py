"""TODO: what is in base, in which order, how to add one."""
