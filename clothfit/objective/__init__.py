"""The cost of a fit: how far a motion is from its targets, and its gradient.

target and experiment (what was seen) → measures/ (what is compared) → loss (how outliers count) → comparison → run (one
cloth under one target) → objective (all of them, as a function of the parameters). memory_needs says what it will take.
To add something to compare: see `measures/measure`.
"""
