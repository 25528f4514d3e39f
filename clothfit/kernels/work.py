"""The work that the simulations of this process and their derivatives have counted (`engine.rollout.work_of`)."""

from __future__ import annotations

import threading


class Counted:
    """The work that all threads have counted."""

    def __init__(self) -> None:
        self.work, self.lock = 0, threading.Lock()

    def add(self, work: int) -> None:
        """Count some work; whole numbers have the same sum in any order."""
        with self.lock:
            self.work += work


counted = Counted()
