"""What is known of a scene before it is fitted, and how good a fit or an integrator is.

overview (its contents), forecast (stable time steps, memory, inputs over time), gradient_check (whether the gradient is
that of the cost, and which contacts change); evaluate compares two scenes, work_precision integrators with the
motion that reference finds.
To add a line to `clothfit info`: a field in overview or forecast. To add a column to `evaluate --speed`: measure it in
work_precision, print it in the command.
"""
