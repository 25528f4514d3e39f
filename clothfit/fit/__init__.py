"""A fit from beginning to end: options → start → the search by a method → what the data determine → the result.

estimate reads like a table of contents and runs the method: auto, the default, which leads to trajectory_fit, or
another. start chooses where to begin (with coarse_search). hints say what the target shows before, registered_fit finds
its clock and place; holdout, verdict, residual_hints and confidence (by posterior) judge the result.
To add a method: its name in options, a line in `estimate.found_by`.
"""
