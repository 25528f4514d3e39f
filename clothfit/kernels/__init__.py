"""TODO: what is in kernels, in which order, how to add one."""
