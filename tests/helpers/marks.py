"""What tests of fits are marked with: they compile one, and are hopeless without compilation."""

from collections.abc import Callable
from typing import Any

import numba
import pytest

compiled = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="hundreds of simulations need compilation")

FITS = [pytest.mark.slow, compiled]
"""For `pytestmark` of a module all of whose tests fit, or simulate as often."""


def fits(test: Callable[..., Any]) -> Callable[..., Any]:
    """The same for a single test."""
    return pytest.mark.slow(compiled(test))
