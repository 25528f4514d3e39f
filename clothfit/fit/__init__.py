"""TODO: what is in fit, in which order, how to add one."""
