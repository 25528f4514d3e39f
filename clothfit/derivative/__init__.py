"""Exact derivatives of a simulated motion, and how they are verified.

adjoint (backwards: one cost by all parameters; forwards: all positions along one direction) and sensitivity (forwards:
all positions by many parameters at once) sweep over a motion. step_jacobian and stencil give the matrices of one step,
columns which parameter moves which elements, pins how they lead others; verify compares derivatives with differences.
A new force brings its own derivatives; nothing here changes.
"""
