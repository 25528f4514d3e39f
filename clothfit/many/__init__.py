"""TODO: what is in many, in which order, how to add one."""
