"""A fit from beginning to end: options → start → the search by a method → what the data determine → the result.

estimate reads like a table of contents; start chooses where to begin (fabric, coarse_search, start_warnings); methods
runs auto, the default (trajectory_fit, stages), or another; holdout, null_space and confidence judge the result.
To add a method: its name in options, a line in `methods`.
"""
