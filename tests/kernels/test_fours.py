"""Elements by fours: those that are left over count once, and what their empty lanes hold is kept nowhere."""

import numpy as np
import pytest

from clothfit.kernels.fours import add_some, add_to_objects, kept, of_objects, some
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import sum4

pytestmark = pytest.mark.slow  # compiles kernels


@kernel
def copied(a, out):
    """out += a, and the sums of its numbers with 7 for empty lanes, and with 0."""
    with_sevens, plain = 0.0, 0.0
    for i in range(0, len(a), 4):
        numbers = some(a, i, len(a), 7.0)
        add_some(out, i, len(a), numbers)
        with_sevens += sum4(numbers)
        plain += sum4(kept(numbers, i, len(a)))
    return with_sevens, plain


@kernel
def by_object(numbers, owner, out):
    """out (K,) += the number of its object for each element."""
    for i in range(0, len(owner), 4):
        add_to_objects(out, owner, i, len(owner), of_objects(numbers, owner, i, len(owner)))


@pytest.mark.parametrize("count", range(1, 10))
def test_elements_that_are_left_over_count_once(count):
    a, out = np.arange(1.0, count + 1.0), np.zeros(count)
    with_sevens, plain = copied(a, out)
    assert out.tolist() == a.tolist()  # whole numbers: exact
    assert (plain, with_sevens) == (a.sum(), a.sum() + 7.0 * (-count % 4))
    owner, numbers, sums = np.arange(count, dtype=np.int32) % 3, np.array([1.0, 10.0, 100.0]), np.zeros(3)
    by_object(numbers, owner, sums)
    assert sums.tolist() == [numbers[k] * (owner == k).sum() for k in range(3)]
