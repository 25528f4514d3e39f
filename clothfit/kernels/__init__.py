"""numba as this program uses it: compiled functions, kept on disk, and four numbers at a time.

kernel (the decorator) → cache (what is compiled, on disk) → vectors (3-vectors) → lanes/ (the processor's vectors).
To write a kernel: decorate it with `kernel.kernel`, use explicit loops and scalars, and allocate outside the loops.
"""
