"""Several numbers at once: intrinsics of numba.

`compiled` and `compiled_singles` have them, in double and in single precision; kernels import their names from
`operations`. To add one: write it, name it in `operations`, and say in the tests what it is with NumPy.
"""
