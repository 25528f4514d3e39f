"""TODO: what is in inspection, in which order, how to add one."""
