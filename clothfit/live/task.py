"""A task that runs in a process of its own (`worker`)."""

from __future__ import annotations

import pickle
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any

Heard = Callable[[str, dict[str, Any]], None]

PATIENCE = 1.0
"""Seconds that a process has to end by itself."""


class Task:
    """A task that runs; `heard` is called in a thread with each message, the last of which is "done", "failed" or
    "cancelled".
    """

    def __init__(self, name: str, heard: Heard, **arguments: Any) -> None:
        self.name, self._heard = name, heard
        command = [sys.executable, "-m", "clothfit.live.worker"]
        group = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)  # on Windows
        self._process = subprocess.Popen(  # which a Ctrl-C at the terminal does not reach: whoever started it ends it
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True, creationflags=group
        )
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, args=[(name, arguments)], daemon=True)
        self._thread.start()

    def cancel(self) -> None:
        """Ask it to end with the best so far."""
        self._say("cancel")

    def kill(self) -> None:
        """End it at once; nothing more is heard."""
        self._heard = ignored
        with suppress(OSError):
            self._process.kill()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(PATIENCE)

    def _say(self, word: Any) -> None:
        with self._lock, suppress(OSError, ValueError):  # it may have ended
            assert self._process.stdin is not None
            pickle.dump(word, self._process.stdin)
            self._process.stdin.flush()

    def _run(self, task: Any) -> None:
        self._say(task)
        assert self._process.stdout is not None
        ended = False
        while not ended:
            try:
                kind, content = pickle.load(self._process.stdout)
            except (EOFError, OSError, ValueError, pickle.UnpicklingError):
                kind, content = "failed", {"reason": f"the process of {self.name} died", "code": 1, "invalid": False}
            ended = kind in ("done", "failed", "cancelled")
            if ended:
                with suppress(OSError):
                    self._process.kill()  # it has nothing left to do
                self._process.wait()
            self._heard(kind, content)


def ignored(kind: str, content: dict[str, Any]) -> None:
    """Hear nothing."""


# ---- A scene on its way: it is read and tried beside what moves, and its sender is answered when it is there.

LONG = 10.0
"""Seconds after which a sender is answered that the scene is still on its way: its code is being compiled."""

Answer = dict[str, Any]


class Loading:
    """A scene that a process reads. `heard` gets what that says."""

    def __init__(self, head: Answer, heard: Callable[[Loading, str, Answer], None], **arguments: Any) -> None:
        self.head = head  # of the answer: to which message it is
        self.answer: Future[Answer] = Future()
        self.answered = False  # whether its sender was told that it is still on its way
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
