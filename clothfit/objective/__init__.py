"""The cost of a fit: how far a motion is from its targets, and its gradient.

target and experiment (what was seen) → measures (what is compared) → comparison (with how outliers count) →
running_cost (chunk by chunk) → run (one cloth under one target) → objective (all of them, as a function of the
parameters). memory_needs is what it will take, identifiability what a motion can reveal and what is hard to tell apart,
whiteness whether what is left is noise. own_cost is a cost that the user gives, differentiable what users have of all
this.
To add something to compare: see `measures`.
"""
