"""The linear system A w = b of an implicit step, symmetric, in 3×3 blocks.

sparse (the matrix) → ssor (preconditioner) → cg (conjugate gradients) → cg_two_threads (those of large cloths, the
second thread by two_threads) → coarsening, smoothing, multigrid (the preconditioner of very large ones), cg_multigrid,
minres (where their matrix is indefinite) → linear (chooses, and solves directly where none of them converges). guess
extrapolates a first solution.
To add a preconditioner: a module with a `solve` as in `cg_multigrid`, its memory in `linear.Workspace`, and a line in
`linear.iterate`.
"""
