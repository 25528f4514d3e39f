"""How a network is made and trained: as the paper has it, and what we found to be better (docs/subspace.md)."""

from __future__ import annotations

from dataclasses import dataclass

from clothfit.base.errors import InvalidInput

MINUTES = 10.0
"""Of processor time, where nobody says how long to train."""


@dataclass(frozen=True)
class Recipe:
    """One of them. Sizes of coordinates are relative to their standard deviations in the data."""

    hidden: tuple[float, ...]  # widths of the layers between, relative to r
    activation: str
    dense: bool  # a linear part of all coordinates and inputs, trained as well; else z̄ = α ⊙ z₁ + β ⊙ (z₁ − z₂)
    windows: tuple[int, int]  # frames that are fed with their own predictions, at the start and from GROWN on
    least: float  # size of what the layers give, where the linear part leaves less: else they learn too slowly
    batch: int
    rate: float  # of the steps of the optimiser
    decay: float | None  # of the rate with each pass through the data; None: it falls as half a cosine
    amsgrad: bool
    noise: float  # on both frames that a window begins with
    shake: float  # of the second one beside that, relative to it
    absolute: bool  # errors component by component; else the norms of frames
    velocity: float  # weight of the errors of velocities, relative to those of coordinates of the same relative size
    clip: float | None  # of the gradient's norm
    margin: float  # by which coordinates may leave the range of the data
    rests: bool  # learn also from motions that come to rest, which physics on the basis plays (`learn`)


PAPER = Recipe(
    hidden=(1.5,) * 9, activation="relu", dense=False, windows=(32, 32), least=0.0, batch=16, rate=1e-4, decay=0.999,
    amsgrad=True, noise=0.01, shake=1.0, absolute=True, velocity=1.0, clip=None, margin=0.0, rests=False,
)  # fmt: skip
"""D. Holden, B. C. Duong, S. Datta, D. Nowrouzezahrai, Subspace Neural Physics, SCA 2019: ten layers."""

OWN = Recipe(
    hidden=(2.0,) * 3, activation="elu", dense=True, windows=(4, 48), least=2e-3, batch=64, rate=1e-3, decay=None,
    amsgrad=False, noise=0.005, shake=0.1, absolute=False, velocity=0.25, clip=1.0, margin=0.1, rests=True,
)  # fmt: skip

RECIPES = {"own": OWN, "paper": PAPER}

ENOUGH = 60_000
"""Rounds of our recipe beyond which motions that were held out are missed by more again: of `side.json` by 2.9 % after
25,000 rounds, and by 3.8 % at best in 296,000.
"""

GROWN = 0.7
"""Of the training is done when windows have their full length."""


@dataclass(frozen=True)
class Budget:
    """How long to train: so many minutes of processor time, or so many rounds, which give the same on every machine
    for the same seed, but for rounding.
    """

    minutes: float = MINUTES
    rounds: int | None = None
    most: int | None = None  # rounds after which it is spent, however few minutes they took

    def check(self) -> None:
        """Raise InvalidInput where it is none."""
        if not 0.0 < self.minutes < 1e5:
            raise InvalidInput(f"--minutes must be above 0; {self.minutes:g} was given")
        if self.rounds is not None and self.rounds < 1:
            raise InvalidInput(f"--rounds must be at least 1; {self.rounds} was given")

    def done(self, seconds: float, rounds: int) -> float:
        """What part of it is spent, after so many seconds and rounds."""
        if self.rounds is not None:
            return rounds / self.rounds
        return max(seconds / (60.0 * self.minutes), rounds / self.most if self.most else 0.0)
