"""Who watches a fit; in notebooks a progress bar, by tqdm where that is installed."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clothfit.fit.hints import Hint
    from clothfit.objective.memory_needs import Needs
    from clothfit.optimise.progress import Progress
    from clothfit.scene.scene import Scene


class Observer:
    """Watches a fit. It does nothing; override what is of interest. What a method raises ends the fit."""

    def progress(self, progress: Progress) -> None:
        """Called after each evaluation, and now and then while a step of thousands of values is computed."""

    def hint(self, hint: Hint) -> None:
        """Called with each hint that the targets give before a fit."""

    def memory(self, needs: Needs) -> None:
        """Called with the memory that the fit will need, before it begins."""

    def result(self, scene: Scene) -> None:
        """Called with the best scene when the search has ended, before anything else is looked at."""


class Bar(Observer):
    """A bar of evaluations."""

    def __init__(self, shown: Any) -> None:
        """`shown`: a bar of tqdm."""
        self.shown = shown

    def progress(self, progress: Progress) -> None:
        self.shown.n = progress.evaluations
        self.shown.set_postfix_str(f"{progress.reached}, {progress.stage}", refresh=True)


@contextmanager
def bar(observer: Observer | None) -> Iterator[Observer]:
    """Who watches a fit: the observer, else a bar in a notebook, else nobody."""
    made = tqdm_bar() if observer is None and in_notebook() else None
    if made is None:
        yield observer or Observer()
        return
    try:
        yield Bar(made)
    finally:
        made.close()


def in_notebook() -> bool:
    """Whether Jupyter runs this."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return hasattr(shell, "kernel")


def tqdm_bar() -> Any:
    """A bar of evaluations; None without tqdm."""
    try:
        return import_module("tqdm.auto").tqdm(desc="fit", unit=" evaluations", leave=False)
    except ImportError:
        return None
