"""How good a fit or an integrator is: errors of motions and parameters, speed against error.

evaluate compares two scenes; trial and work_precision measure integrators against the motion that reference finds.
To add a column: measure it in `trial`, print it in the command.
"""
