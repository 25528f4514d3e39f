"""Which states of a motion are kept where not all of them fit into memory.

A reverse sweep needs the states of a motion in the opposite order. Where not all of them fit, snapshots are kept, and
the steps between two of them are computed again when their turn comes. With one level of snapshots every step is
computed twice, with L levels at most L + 1 times, and m^L parts need only L m snapshots. A. Griewank, Achieving
logarithmic growth of temporal and spatial complexity in reverse automatic differentiation, Optimization Methods and
Software 1, 1992.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

LIVE = 3
"""Snapshots in use while steps are computed, beside those that are kept."""


class Plan(NamedTuple):
    """Which states of a motion are kept."""

    length: int  # steps whose states are held at a time
    strides: tuple[int, ...] = ()  # steps between snapshots, from coarse to fine; the last is `length`
    snapshots: int | None = None  # the most at a time; None: every state is kept, or none is needed again


def plan(steps: int, state: int, snapshot: int, most: float) -> Plan | None:
    """The plan that keeps `steps` states of `state` bytes within `most` bytes and computes the fewest steps again; a
    snapshot has `snapshot` bytes. None where no plan is small enough.
    """
    if steps * state <= most:
        return Plan(max(steps, 1), (max(steps, 1),))
    return next((found for found in plans(steps) if size(found, state, snapshot) <= most), None)


def plans(steps: int) -> Iterator[Plan]:
    """All plans with snapshots, those that compute the fewest steps again first."""
    for levels in range(1, max(steps - 1, 1).bit_length() + 1):
        for parts in range(2, steps + 1):
            length = -(-steps // parts**levels)
            yield Plan(length, tuple(length * parts**i for i in reversed(range(levels))), levels * parts)
            if length == 1:
                break


def size(found: Plan, state: int, snapshot: int) -> int:
    """Bytes that a plan holds."""
    return found.length * state + (0 if found.snapshots is None else (LIVE + found.snapshots) * snapshot)


def least(steps: int, state: int, snapshot: int) -> int:
    """The fewest bytes with which a motion of this many steps can be swept back."""
    return min([steps * state, *(size(found, state, snapshot) for found in plans(steps))])
