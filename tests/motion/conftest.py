"""What the tests of motions share."""

from collections.abc import Callable
from types import SimpleNamespace

import pytest

from clothfit.formats.animation import Animation


@pytest.fixture
def pretend(monkeypatch: pytest.MonkeyPatch) -> Callable[[Animation], None]:
    """A function that lets every file hold an animation."""
    def hold(animation: Animation) -> None:
        module = SimpleNamespace(read=lambda path: animation)
        monkeypatch.setattr("clothfit.formats.registry.module_of", lambda found: module)

    return hold
