"""What the tests of pages share."""

import pytest
from helpers.browsers import browser


@pytest.fixture(scope="module")
def started():
    """A browser."""
    with browser() as made:
        yield made
