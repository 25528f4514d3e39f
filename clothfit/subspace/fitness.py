"""How well a subspace follows a recorded motion, and what that decides: its basis, and its cubature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array
from clothfit.subspace.judge import FORGOTTEN, amplitudes, relative
from clothfit.subspace.physics import cubature
from clothfit.subspace.physics.march import roll
from clothfit.subspace.physics.reduced import Reduced, decode

AS_GOOD = 1.25
"""How far, relative to that with all elements, a recorded motion with few may be from the full one."""

GOOD = 1e-3
"""Of the RMS of a motion: what is good enough."""


@dataclass(frozen=True)
class Fitness:
    """How a reduced motion compares with the full one, over all frames of one episode."""

    rmse: float  # m
    relative: float  # to the RMS of the motion's displacements
    spectrum: float = 0.0  # of the amplitudes of the vertices' spectra, relative

    @property
    def forgets(self) -> bool:
        """Whether points mean nothing, but spectra."""
        return not self.relative <= FORGOTTEN

    def better_than(self, other: Fitness) -> bool:
        """Whether this is nearer to the recorded motion: by points, or where neither follows these, by spectrum."""
        if self.forgets and other.forgets:
            return self.spectrum < other.spectrum
        return self.relative < other.relative


def fitness(own: Reduced, x: Array) -> Fitness:
    """How a motion on the subspace compares with a recorded one, by displacements (frames, n, 3)."""
    made = decode(own, roll(own, len(x) - 1)) - own.system.x0
    rmse = float(np.sqrt(((made - x) ** 2).sum(axis=2).mean()))
    size = float(np.sqrt((x**2).sum(axis=2).mean()))
    same = np.isfinite(rmse)
    return Fitness(
        rmse, rmse / size if size > 0 else 0.0, relative(amplitudes(made), amplitudes(x)) if same else np.inf
    )


def coarsest(own: Reduced, basis: Array, choices: Sequence[cubature.Found], x: Array) -> cubature.Found:
    """The first of some choices of elements with which a recorded motion (frames, n, 3) is followed nearly as well as
    with all of them, else the last; what `own` leaves out with all of them no cubature mends.
    """
    if len(choices) == 1:
        return choices[0]
    whole = fitness(own, x)
    for each in choices[:-1]:
        found = fitness(Reduced(own.system, basis, each.selection), x)
        if whole.forgets and found.spectrum <= AS_GOOD * whole.spectrum:
            return each
        if found.relative <= max(GOOD, AS_GOOD * whole.relative) and not whole.forgets:
            return each
    return choices[-1]
