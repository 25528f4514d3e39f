"""A cloth's own steps, projected on a basis U: a dense system of r equations, from all elements or few weighted ones.

samples (the forces' elements in the subspace) → nnls, cubature (few of them, weighted) → step (an iteration of the
scene's implicit step on U, compiled) → reduced (all steps) → adjoint (its gradient and tangent); and to play, pins,
dense → march (all steps in one compiled loop, their sums in single precision).

A force that the engine gains acts here once `samples` builds it for the copies, and `step` calls its kernels.
"""
