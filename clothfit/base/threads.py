"""How many processors there are, and one thread for dense linear algebra: matrices of a few hundred rows gain little
from more threads, and lose much when another program keeps a core busy, because the threads of BLAS wait for each other
at every step.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController


@cache
def libraries() -> ThreadpoolController:
    """The BLAS of NumPy and that of SciPy; to find them takes longer than many a fit's step."""
    import scipy.linalg.blas  # noqa: F401  only a loaded BLAS can be found, and SciPy's is not NumPy's
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@contextmanager
def single() -> Iterator[None]:
    """Let BLAS use one thread within the block."""
    with libraries().limit(limits=1, user_api="blas"):
        yield


def usable_cores() -> int:
    """Cores that this program may use."""
    from joblib import cpu_count

    return int(cpu_count())
