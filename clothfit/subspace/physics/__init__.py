"""A cloth's own steps, projected on a basis U: a dense system of r equations, from all elements or few weighted ones.

samples (the forces' elements in the subspace, and the cloth on U) → cubature (few elements, weighted); and to play,
dense → march (all steps in one compiled loop, their sums in single precision).

A force that the engine gains acts here once `samples` builds it for the copies and calls its kernels.
"""
