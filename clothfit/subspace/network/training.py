"""Training: windows at random, their gradient, a step; now and then the error of motions that are held out.

The best values so far are kept, and a request to end gives them. All that goes on from a state (values, means of the
gradient, random numbers, time spent) is in `State`, so that a training which is resumed is the one that was not
interrupted, round by round.

Adam: a step for each value by the running mean of its gradient, relative to that of its square (D. P. Kingma, J. Ba,
ICLR 2015).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import process_time
from typing import Any

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput
from clothfit.subspace.network.layers import Loss, Motions, Recipe, Trained, gradient, played

VALIDATIONS = 60
"""How often in a training the held-out motions are played."""

WARM = 100
"""Rounds in which the rate rises to its value."""

LAST_RATE = 1e-3
"""The rate at the end of the cosine, relative."""


MINUTES = 10.0
"""Of processor time, where nobody says how long to train."""

MOST_ROUNDS = 60_000
"""Rounds beyond which motions that were held out are missed by more again: of `side.json` by 2.9 % after
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
    most: int = MOST_ROUNDS  # rounds after which it is spent, however few minutes they took

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
        return max(seconds / (60.0 * self.minutes), rounds / self.most)


@dataclass(frozen=True)
class Progress:
    """How far a training is."""

    done: float  # part of the budget
    rounds: int
    error: float  # of the held-out motions (`Training.error`); inf before the first look
    best: float


@dataclass
class State:
    """What a training goes on from."""

    values: list[Array]
    descent: Descent
    rng: np.random.Generator
    best: list[Array]
    best_error: float = np.inf
    rounds: int = 0
    seconds: float = 0.0
    looked: int = 0  # times that the held-out motions were played
    curve: list[tuple[int, float, float]] = field(default_factory=list)  # rounds, s, error


def begin(own: Trained, seed: int) -> State:
    """The state before the first round."""
    best = [each.copy() for each in own.values]
    return State(own.values, Descent(own.values), np.random.default_rng([seed, 1]), best)


@dataclass
class Training:
    """A network, and what it is trained with. `motions` are relative to the size of the coordinates."""

    own: Trained
    recipe: Recipe
    motions: Motions
    held_out: Motions
    noise: Array  # (r,), of the frames that windows begin with
    loss: Loss
    state: State
    known: dict[int, tuple[Indices, int]] = field(default_factory=dict)  # the starts of windows by their length

    def run(self, budget: Budget, report: Callable[[Progress], None]) -> bool:
        """Train until the budget is spent; False where it was interrupted. The network then has its best values."""
        state, began = self.state, process_time() - self.state.seconds
        finished = True
        try:
            while (done := budget.done(state.seconds, state.rounds)) < 1.0:
                interrupts.check()
                self.round(done)
                state.seconds = process_time() - began
                if budget.done(state.seconds, state.rounds) * VALIDATIONS >= state.looked + 1:
                    report(self.validate(budget))
        except KeyboardInterrupt:
            interrupts.answer()
            finished = False
        report(self.validate(budget))
        return finished

    def round(self, done: float) -> None:
        """One step of the descent."""
        recipe, state = self.recipe, self.state
        first, last = recipe.windows
        length = round(first * (last / first) ** min(1.0, done / GROWN))
        if length not in self.known:
            self.known = {length: self.motions.starts(length)}
        starts, length = self.known[length]
        z, w = self.motions.windows(starts[state.rng.integers(0, len(starts), recipe.batch)], length)
        begin = self.begin(z[:, :2])
        _, grad = gradient(self.own, self.loss, z, w, begin)
        state.rounds += 1
        if clipped(grad, recipe.clip):
            state.descent.step(state.values, grad, self.rate(done))

    def begin(self, frames: Array) -> Array:
        """The first two frames (B, 2, r) with noise: of both, so that they are somewhere else, and less of the second
        alone, so that they are faster or slower.
        """
        shape, kind = frames[:, 0].shape, frames.dtype.type
        moved = (self.noise * self.state.rng.standard_normal(shape)).astype(kind)
        shaken = kind(self.recipe.shake) * (self.noise * self.state.rng.standard_normal(shape)).astype(kind)
        return np.stack([frames[:, 0] + moved, frames[:, 1] + moved + shaken], axis=1)

    def rate(self, done: float) -> float:
        """The rate of the descent."""
        falling = 0.5 * (1.0 + np.cos(np.pi * done))
        return self.recipe.rate * (LAST_RATE + (1.0 - LAST_RATE) * float(falling)) * min(1.0, self.state.rounds / WARM)

    def validate(self, budget: Budget) -> Progress:
        """The error of the held-out motions; the values are kept where it is the least so far."""
        state = self.state
        error = self.error()
        if error < state.best_error:
            state.best_error, state.best = error, [each.copy() for each in state.values]
        done = budget.done(state.seconds, state.rounds)
        state.looked = int(done * VALIDATIONS)
        state.curve.append((state.rounds, state.seconds, error))
        return Progress(done, state.rounds, error, state.best_error)

    def error(self) -> float:
        """The RMSE of the held-out motions, relative to the RMS of their way since the start. From 1 on, which is that
        of standing still, whole motions tell nothing: then it is 1 and the error of windows of them.
        """
        given = self.held_out
        whole = self.missed(given.z, given.w, given.good)
        if whole < 1.0:
            return whole
        starts, length = given.starts(self.recipe.windows[1])
        z, w = given.windows(starts[::length], length)
        return 1.0 + self.missed(z, w, np.ones(z.shape[:2], bool))

    def missed(self, z: Array, w: Array, good: Flags) -> float:
        """That of motions z (E, T, r) under inputs w (E, T − 2, m), over good frames (E, T)."""
        away = (played(self.own, z, w) - z)[:, 1:][good[:, 1:]]
        moved = (z - z[:, 1:2])[:, 1:][good[:, 1:]]
        return float(np.sqrt((away.astype(float) ** 2).sum() / max(float((moved.astype(float) ** 2).sum()), 1e-300)))

    def use_best(self) -> None:
        """Give the network its best values."""
        for value, best in zip(self.state.values, self.state.best, strict=True):
            value[:] = best


def archived(state: State) -> dict[str, Array]:
    """The arrays of a state, by name; `numbers` has the rest."""
    lists = {"value": state.values, "best": state.best, "mean": [*state.descent.mean, *state.descent.square]}
    return {f"{name}{k}": each for name, own in lists.items() for k, each in enumerate(own)}


def numbers(state: State) -> dict[str, Any]:
    """The rest of a state, as JSON holds it."""
    found = {name: getattr(state, name) for name in ("best_error", "rounds", "seconds", "looked", "curve")}
    return found | {"count": state.descent.count, "random": state.rng.bit_generator.state}


def restore(state: State, held: dict[str, Any], about: dict[str, Any]) -> None:
    """Fill a state at its beginning with another one. Raises KeyError, TypeError, ValueError where it does not fit."""
    for name, each in archived(state).items():
        each[:] = held[name]
    state.best_error, state.rounds = float(about["best_error"]), int(about["rounds"])
    state.seconds, state.looked = float(about["seconds"]), int(about["looked"])
    state.curve = [(int(a), float(b), float(c)) for a, b, c in about["curve"]]
    state.descent.count, state.rng.bit_generator.state = int(about["count"]), about["random"]


FIRST, SECOND, LEAST = 0.9, 0.999, 1e-8


class Descent:
    """The means of some arrays' gradients."""

    def __init__(self, values: Sequence[Array]) -> None:
        self.mean = [np.zeros_like(each) for each in values]
        self.square = [np.zeros_like(each) for each in values]
        self.count = 0

    def step(self, values: Sequence[Array], grad: Sequence[Array], rate: float) -> None:
        """Change the values along their gradients."""
        self.count += 1
        unbiased = np.sqrt(1.0 - SECOND**self.count)
        size = rate * unbiased / (1.0 - FIRST**self.count)
        for k, (value, g) in enumerate(zip(values, grad, strict=True)):
            kind = value.dtype.type
            self.mean[k] += kind(1.0 - FIRST) * (g - self.mean[k])
            self.square[k] += kind(1.0 - SECOND) * (g * g - self.square[k])
            value -= kind(size) * self.mean[k] / (np.sqrt(self.square[k]) + kind(LEAST * unbiased))


def clipped(grad: Sequence[Array], most: float) -> bool:
    """Shorten a gradient to a norm, in place; returns whether it is finite."""
    norm = float(np.sqrt(sum(float((each * each).sum()) for each in grad)))
    if norm > most:
        for each in grad:
            each *= each.dtype.type(most / norm)
    return bool(np.isfinite(norm))
