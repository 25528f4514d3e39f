"""How good a fit or an integrator is: errors of motions and parameters, speed against error.

evaluate compares two scenes; setting, trial and work_precision measure integrators against a reference motion from
richardson and runge_kutta; fit_methods measures the methods of estimation.
To add a column: measure it in `trial`, print it in the command.
"""
