"""Minimisers, which know a cost and its derivatives but no scene file.

coordinates (scaled parameters) → search (the cost, the best point; status: the budget and the ends; progress: what is
reported) → scipy_methods, gauss_newton (with trust_region and prior) and matrix_free, each on a trajectory; scan
and momentum (with balances) find starts; checkpoint lets a fit go on after it was
killed.
To add an optimiser: a module with `minimise(search, …)` that returns how it ended, and a line in `fit/estimate` or
`scipy_methods`.
"""
