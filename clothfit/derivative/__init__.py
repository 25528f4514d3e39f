"""Exact derivatives of a simulated motion, and how they are verified.

adjoint (backwards: all parameters, one cost) and sensitivity (forwards: all positions, some directions) sweep over a
motion; step_jacobian and stencil give the matrix of one step, columns the dense Jacobian; verify compares with
differences.
A new force brings its own derivatives; nothing here changes.
"""
