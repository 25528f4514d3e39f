"""Where searches keep their checkpoints: in the file that is asked for, else beside the output of a long one."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from clothfit.base.checkpoint import Checkpoint
from clothfit.base.errors import InvalidInput
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import STREAM, Output, is_among
from clothfit.cli.parts.estimate_files import Files
from clothfit.optimise.status import Status

CHECKPOINT_SUFFIX = ".checkpoint"

UNASKED_AFTER = 60.0  # s after which a fit keeps a checkpoint though none was asked for

ENDED = (Status.CONVERGED, Status.STALLED)
"""Statuses after which there is nothing to go on with."""


Some = TypeVar("Some", bound=Checkpoint)


def chosen(
    path: str | None, resume: bool, out: Output, inputs: Sequence[str | None], console: Console,
    make: Callable[[str, float], Some],
) -> Some | None:  # fmt: skip
    """The checkpoint of a search with that --checkpoint and output; none where there is no place for one. `make` makes
    one from its path and the seconds before which nothing is written.

    Raises InvalidInput when what is asked for cannot be.
    """
    if path is not None:
        if path == STREAM or is_among(path, (*inputs, out.path)):
            raise InvalidInput(f"--checkpoint: {path}: must be a file of its own, not an input or the output")
        return make(path, 0.0)
    regular = not out.is_stream and (os.path.isfile(out.path) or not os.path.exists(out.path))
    if not regular:
        if resume:
            raise InvalidInput("--resume: the output is no file, so none is kept beside it; name one with --checkpoint")
        return None
    beside = make(out.path + CHECKPOINT_SUFFIX, UNASKED_AFTER)
    try:
        beside.check()
    except InvalidInput as error:
        if resume:
            raise
        console.warn(f"no checkpoint is kept: {error}")
        return None
    return beside


@contextmanager
def named_if_lost(kept: Checkpoint | None) -> Iterator[None]:
    """If the result cannot be written, name the checkpoint to resume from in the error."""
    try:
        yield
    except InvalidInput as error:
        if kept is None or not kept.written:
            raise
        raise InvalidInput(f"{error}; then repeat the command with --resume: {os.fspath(kept.path)} is kept") from None


def of_fit(kept: Checkpoint | None, asked: Files, status: str, console: Console) -> None:
    """Close the checkpoint of a fit."""
    more = " and more --max-evaluations" if status == Status.LIMIT else ""
    closed(kept, asked.checkpoint is not None, status, console, asked.in_place, more)


def closed(
    kept: Checkpoint | None, asked: bool, status: str, console: Console, in_place: bool = False, more: str = ""
) -> None:
    """Remove a checkpoint that nobody asked for and that is no longer useful; print how to resume from another one,
    with `more` options.

    A fit that has written its result over its own scene (`in_place`) cannot be resumed.
    """
    if kept is None or not kept.written:
        return
    useful = status not in ENDED and not in_place
    if not useful and not asked:
        kept.remove()
    elif useful:
        console.say(f"to go on, repeat the command with --resume{more}: {kept.name}")
