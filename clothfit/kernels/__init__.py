"""numba as this program uses it: compiled functions, kept on disk, and four numbers at a time.

dependencies (what a kernel's code depends on) → linking (what is kept of it) → cache (on disk) → once (one process
compiles, others wait) → kernel (the decorator) → lanes/ (vectors of 4 numbers) → vectors (3-vectors). raster: pixels of
pictures. clock: seconds of computing, without compilation; work: what simulations count beside it. parallel:
independent parts on several threads; lapack: dense linear algebra that lets other threads run.
To write a kernel: decorate it with `kernel.kernel`, use explicit loops and scalars, and allocate outside the loops.
"""
