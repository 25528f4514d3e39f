"""A task that runs in a process of its own (`worker`)."""

from __future__ import annotations

import pickle
import subprocess
import sys
import threading
from collections.abc import Callable
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
        self.name, self._heard, self.cancelled = name, heard, False
        command = [sys.executable, "-m", "clothfit.live.tasks.worker"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, **own_group())
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, args=[(name, arguments)], daemon=True)
        self._thread.start()

    def cancel(self) -> None:
        """Ask it to end with the best so far."""
        self.cancelled = True
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


def own_group() -> dict[str, Any]:
    """How a process starts that a Ctrl-C at the terminal does not reach: whoever started it ends it."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}
