"""The linear system A w = b of an implicit step, symmetric, in 3×3 blocks.

sparse (the matrix) → ssor (preconditioner), multigrid (that of very large cloths) → cg (conjugate gradients) → linear
(cg, and a direct solution where it does not converge). guess extrapolates a first solution; two_threads shares work.
To add a preconditioner: a module with what `cg` calls of ssor, and a line where `cg` chooses.
"""
