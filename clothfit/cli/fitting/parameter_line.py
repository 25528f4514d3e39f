"""The line that `clothfit estimate` prints for each kind of parameter that it fitted."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from clothfit.base.messages import counted

if TYPE_CHECKING:
    from clothfit.fit.result import FittedBlock


def certainty(block: FittedBlock) -> str:
    """What is known of the values of a block, and what is not; empty where neither was looked for."""
    parts = [f"{counted(block.count, 'value', 'values')}"]
    if any(block.interval):
        parts.append(f"{accuracy(block)} ({'median ' if block.count > 1 else ''}95 % interval)")
    if block.unidentifiable:
        parts.append(f"{len(block.unidentifiable)} not shown by the motion: {indices(block.unidentifiable)}")
    if block.unmoved:
        parts.append(f"{len(block.unmoved)} did not move: {indices(block.unmoved)}")
    return ", ".join(parts) if len(parts) > 1 else ""


def accuracy(block: FittedBlock) -> str:
    """Half of the middle one of the intervals: in percent where a fit moves the logarithm."""
    from statistics import median  # here, as it is slow to import

    from clothfit.scene.kinds import KIND

    kind, ends = KIND[block.name], [interval for interval in block.interval if interval]
    if kind.log:
        return f"±{100 * (math.sqrt(median(high / low for low, high in ends)) - 1):.2g} %"
    return f"±{median(high - low for low, high in ends) / 2:.2g} {kind.unit}"


def indices(numbers: list[int]) -> str:
    """The first few of a list of indices."""
    return ", ".join(map(str, numbers[:8])) + (", …" if len(numbers) > 8 else "")
