"""TODO: what is in pictures, in which order, how to add one."""
