"""numba as this program uses it: compiled functions, kept on disk, and four numbers at a time.

cache (compiled code on disk) → kernel (the decorator) → vectors (loops over 3-vectors), lanes/ (vectors of 4 numbers).
To write a kernel: decorate it with `kernel.kernel`, use explicit loops and scalars, and allocate outside the loops.
"""
