"""TODO: what is in evaluation, in which order, how to add one."""
