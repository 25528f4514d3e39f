"""One thread for dense linear algebra: matrices of a few hundred rows gain little from more threads, and lose much when
another program keeps a core busy, because the threads of BLAS wait for each other at every step.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def single() -> Iterator[None]:
    """Let BLAS use one thread within the block."""
    import scipy.linalg  # noqa: F401  only a loaded BLAS can be limited, and SciPy's is not NumPy's
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield
