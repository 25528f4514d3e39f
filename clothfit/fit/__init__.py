"""A fit from beginning to end: options → model and time step → the search by a method → the result.

estimate reads like a table of contents. routes lists what is settled first (start, time step, kinds, model), and how
the values are found: by the method that is asked for, by balances of momentum, by a scan, by trajectory_fit
(Gauss–Newton by windows of frames; where those lead away from the target, by the forms of step_forms), and, where no
values reproduce the target, by the hierarchy of models from coarse to fine (auto), whose values come from afar by
continuation. start says where it begins, step_choice chooses the time step, frame_blocks what is not needed.
preparation cuts a target into windows, and lets held vertices follow it.
hints say what the target shows before, registered_fit finds its clock and place, tracked_fit where a scan is; holdout,
the verdict in result, residual_hints and confidence (by posterior, or by samples) judge the result.
To add a method: its name in options, a row of `ROUTES` in routes.
"""
