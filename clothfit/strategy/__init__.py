"""How a fit comes from its start to its best point.

start says where it begins. auto has the routes by balances of momentum, by a scan, by
the trajectory_fit (Gauss–Newton by windows of frames) and, where no values reproduce the target, by the hierarchy of
models from coarse to fine (few_values fits the coarse ones), whose values come from afar by continuation. Where windows
lead the trajectory_fit astray it goes through the nudging and forms of step_forms. step_choice chooses the time step,
frame_blocks what is not needed. To add a way: a function of a `Search`, and a row of `ROUTES` in `fit.routes`, which
says when each is taken.
"""
