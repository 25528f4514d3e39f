"""Several numbers at once: intrinsics of numba.

`compiled` has them, in double and in single precision; kernels import their names from `operations`. To add one: write
it, and say in `operations` and in the tests, with NumPy, what it is.
"""
