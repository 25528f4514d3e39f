"""The linear system A w = b of an implicit step, symmetric, in 3×3 blocks.

sparse (the matrix) → ssor (preconditioner) → cg (conjugate gradients) → coarsening, smoothing, multigrid (the
preconditioner of large cloths), cg_multigrid (with a second thread by two_threads), minres (where their matrix is
indefinite) → linear (chooses, and solves directly where none of them converges). guess extrapolates a first solution.
To add a preconditioner: a module with a `solve` as in `cg_multigrid`, its memory in `linear.Workspace`, and a line in
`linear.solve`.
"""
