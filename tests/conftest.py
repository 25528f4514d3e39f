"""What holds for all tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from clothfit import threads


@pytest.fixture(scope="session", autouse=True)
def _one_thread() -> Iterator[None]:
    """Dense algebra of small matrices on one thread, as in a fit: more of them wait for each other."""
    with threads.single():
        yield
