"""One thread for small matrices, and as many as before for everything after."""

import subprocess
import sys

import numpy as np
import pytest
from helpers.scenes import environment
from threadpoolctl import threadpool_info, threadpool_limits

from clothfit.base import threads

pytestmark = pytest.mark.slow  # starts processes


def used():
    """Threads of each BLAS that is loaded."""
    assert np.eye(3).sum() == 3.0
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_one_within_and_as_before_after():
    with threadpool_limits(limits=2, user_api="blas"):
        before = used()
        with threads.single():
            assert used() == {1}
        assert used() == before
        with pytest.raises(KeyboardInterrupt), threads.single():  # also where an exception passes
            raise KeyboardInterrupt
        assert used() == before


FRESH = """
from clothfit.base import threads
from threadpoolctl import threadpool_info
with threads.single():
    import scipy.linalg
    pools = [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]
assert pools and set(pools) == {1}, pools
"""


def test_what_is_loaded_later_is_limited_as_well():
    several = environment(OPENBLAS_NUM_THREADS="2", MKL_NUM_THREADS="2")
    assert subprocess.run([sys.executable, "-c", FRESH], env=several, check=False).returncode == 0
