"""A fit from beginning to end: options → model and time step → the search by a method → the result.

estimate reads like a table of contents. routes lists what is settled first (start, time step, kinds, model), and how
the values are found: by the method that is asked for, or by the ways of `strategy`. preparation cuts a target into
windows, and lets held vertices follow it.
hints say what the target shows before, registered_fit finds its clock and place, tracked_fit where a scan is; holdout,
the verdict in result, residual_hints and confidence (by posterior, or by samples) judge the result.
To add a method: its name in options, a row of `ROUTES` in routes.
"""
