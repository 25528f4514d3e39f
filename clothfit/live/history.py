"""What `undo` goes back to: the scenes before the last changes."""

from __future__ import annotations

from typing import NamedTuple

from clothfit.live.sliders import Factors
from clothfit.scene.scene import Scene

MOST = 100
"""Changes that can be undone, …"""

MOST_BYTES = 64 << 20
"""… fewer where scenes are large: bytes that they may take together, about."""


class Moment(NamedTuple):
    """The scene that moves, the base of its factors, and these."""

    scene: Scene
    base: Scene
    factors: Factors


class History:
    """The moments before the last changes, the newest last."""

    def __init__(self) -> None:
        self._moments: list[tuple[str | None, Moment]] = []

    def __len__(self) -> int:
        return len(self._moments)

    def note(self, gesture: object, moment: Moment) -> None:
        """Note what was before a change: of one gesture, such as the drag of a slider, what was before all of it."""
        name = str(gesture)[:100] if gesture is not None else None
        if name is None or not self._moments or self._moments[-1][0] != name:
            most = max(min(MOST_BYTES // size(moment.scene), MOST), 1)
            self._moments = [*self._moments, (name, moment)][-most:]

    def last(self) -> Moment:
        """Take the newest moment."""
        return self._moments.pop()[1]


def size(scene: Scene) -> int:
    """Bytes that a changed scene may keep: its text, and its masses, stiffnesses and lengths."""
    return len(scene.source.text) + sum(8 * len(each.mass) + 16 * len(each.stiffness) for each in scene.cloths)
