"""TODO: what is in optimise, in which order, how to add one."""
