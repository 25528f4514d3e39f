"""A progress bar in notebooks, by tqdm where that is installed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from clothfit.optimise.progress import Progress


@contextmanager
def bar(receiver: Callable[[Progress], None] | None) -> Iterator[Callable[[Progress], None] | None]:
    """Who is told of the progress of a fit: the receiver, else a bar in a notebook, else nobody."""
    made = None if receiver is not None or not in_notebook() else tqdm_bar()
    if made is None:
        yield receiver
        return

    def show(progress: Progress) -> None:
        made.n = progress.evaluations
        made.set_postfix_str(f"{progress.reached}, {progress.stage}", refresh=True)

    try:
        yield show
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
