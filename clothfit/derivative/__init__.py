"""TODO: what is in derivative, in which order, how to add one."""
