"""A fit from beginning to end: options → start → the search by a method → what the data determine → the result.

estimate reads like a table of contents; auto is the default method; fabric and start give starting values; holdout,
null_space and confidence judge the result.
To add a method: a line in `auto`, and its name in options.
"""
