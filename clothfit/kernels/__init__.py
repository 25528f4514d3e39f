"""numba as this program uses it: compiled functions, kept on disk, and four numbers at a time.

dependencies (what a kernel's code depends on) → linking (what is kept of it), records (tuples that go as one pointer,
to memory that unboxing fills) → cache (on disk) → once (one process compiles, others wait), helper (one that compiles
along, by backward) → apart (kernels that are called through a pointer) → compiling → kernel (the decorator) →
lanes/ (vectors of 4 numbers) → vectors (3-vectors). progress: how far a compilation is.
raster: pixels of pictures. clock: seconds of computing, without compilation; work: what simulations count beside it.
parallel: independent parts on several threads; lapack: dense linear algebra that lets other threads run.
All that rests on what numba does not promise is in cache, linking, compiling, records, unboxing, apart and backward:
its classes of caches, code libraries, pipelines, data models, calls and type inference may change with any version,
and pyproject.toml sets no upper bound. `.ci/run` tries the newest one.
To write a kernel: decorate it with `kernel.kernel`, use explicit loops and scalars, and allocate outside the loops. One
that does much work and has several callers is marked `apart`: it is compiled once, and when it is first needed.
"""
