"""How good a fit or an integrator is: errors of motions and parameters, speed against error.

evaluate compares two scenes; setting, trial and work_precision measure integrators against the reference of richardson
and runge_kutta; fit_methods measures ways to fit.
To add a column: `trial` measures it, the command prints it.
"""
