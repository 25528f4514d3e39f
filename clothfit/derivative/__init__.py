"""Exact derivatives of a simulated motion, and how they are verified.

adjoint (backwards: one cost by all parameters; forwards: all positions along one direction) and sensitivity (forwards:
all positions by many parameters at once, in columns) sweep over a motion. step_jacobian gives the matrices of one step,
envelope_cholesky solves with them, contact has what a cloth adds that touches itself; verify compares derivatives with
differences.
A new force brings its own derivatives; nothing here changes.
"""
