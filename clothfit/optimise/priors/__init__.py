"""What is believed of values before the data.

patterns are those in which the values of a fabric go together; prior is the belief that values scatter along them, and
each by itself; evidence finds the widths of that scatter that make the data most likely.
"""
