"""A fit from beginning to end: options → model and time step → the search by a method → the result.

estimate reads like a table of contents and runs the method: auto, the default (`strategy`), or another. preparation
chooses the time step (`strategy.step_choice`) and the model where that is asked for, and cuts a target into windows.
hints say what the target shows before, registered_fit finds its clock and place; holdout, the verdict in result,
residual_hints and confidence (by posterior, or by samples) judge the result.
To add a method: its name in options, a line in `estimate.found_by`.
"""
