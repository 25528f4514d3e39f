"""A scene on its way: it is read and tried beside what moves, and its sender is answered when it is there."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from clothfit.live.tasks.task import Task

LONG = 10.0
"""Seconds after which a sender is answered that the scene is still on its way: its code is being compiled."""

Answer = dict[str, Any]


class Loading:
    """A scene that a process reads. `heard` gets what that says."""

    def __init__(self, head: Answer, heard: Callable[[Loading, str, Answer], None], **arguments: Any) -> None:
        self.head = head  # of the answer: to which message it is
        self.answer: Future[Answer] = Future()
        self.told = False  # whether its sender was told that it is still on its way
        self._task = Task("load", lambda kind, content: heard(self, kind, content), **arguments)

    def done(self, more: Answer) -> Answer:
        """The answer that what was asked for is done."""
        return {"type": "done", **self.head, **more}

    def refused(self, reason: str) -> Answer:
        """The answer that it is not."""
        return {"type": "refused", **self.head, "reason": reason}

    def end(self, answer: Answer) -> None:
        """Answer the sender, and end the process."""
        self._task.kill()
        if not self.answer.done():
            self.answer.set_result(answer)
