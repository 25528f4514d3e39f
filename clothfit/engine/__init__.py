"""TODO: what is in engine, in which order, how to add one."""
