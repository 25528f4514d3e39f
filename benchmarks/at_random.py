"""Disturb runs by turns at random instants: the loop, the table and the exit code of `kills` and `signals`."""

from __future__ import annotations

import itertools
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NoReturn, Protocol, TypeVar


class Kind(Protocol):
    """A kind of run, and what became of those that were disturbed."""

    seconds: float  # that one takes
    counts: Counter[str]

    @property
    def name(self) -> str:
        """In tables and faults."""


K = TypeVar("K", bound=Kind)


def total(kinds: Sequence[Kind], what: str) -> int:
    """How often something was counted, of all kinds together."""
    return sum(kind.counts[what] for kind in kinds)


def by_turns(
    kinds: Sequence[K], disturb: Callable[[K, int], list[str]], what: str, count: int, seconds: float = math.inf
) -> list[str]:
    """Let the kinds take turns to be disturbed until `what` was counted so often, or so many seconds have passed.

    `disturb` does it to one run, of that number, counts what happens and returns the faults. Returns all of them.
    """
    began, faults = time.perf_counter(), list[str]()
    for number in itertools.count():
        kind = kinds[number % len(kinds)]
        if total(kinds, what) >= count or time.perf_counter() - began > seconds:
            return faults
        faults += [f"{number}: {kind.name}: {fault}" for fault in disturb(kind, number)]
    return faults


def show(kinds: Sequence[Kind], title: str, names: Sequence[str], summary: str, faults: list[str]) -> NoReturn:
    """Print what was counted under `names`, a summary, and each fault; exits with 1 where there is one."""
    print(f"| {title} | seconds | {' | '.join(names)} |")
    print("|---|---|" + "---|" * len(names))
    for kind in kinds:
        print(f"| {kind.name} | {kind.seconds:.1f} | {' | '.join(str(kind.counts[name]) for name in names)} |")
    print(f"{summary}; {len(faults)} faults")
    for fault in faults:
        print(fault, file=sys.stderr)
    sys.exit(1 if faults else 0)
