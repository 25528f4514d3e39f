"""A fit of few values in the subspace, where a simulation and its derivatives cost little: the start of a full fit.

The basis comes from the target, where all of it is seen, and from the motion of the start; the cubature from the
latter. Gauss–Newton steps with Levenberg's damping (`optimise` has those of full fits) take the exact tangents of the
reduced motion, in the logarithms of values that are above 0. Then one full simulation with the values found shows
whether the subspace still holds: if its error differs much from that in the subspace, its motion joins the others and
a new basis is built.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.engine.system import System, build
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate_cloths
from clothfit.scene.fit_vector import bounds, changes, elements, extra_kinds, fitted_cloths, parameters, with_parameters
from clothfit.scene.scene import Scene
from clothfit.subspace import basis, carrier
from clothfit.subspace.physics import adjoint, cubature
from clothfit.subspace.physics.reduced import Reduced, check, decode

MOST_VALUES = 64
"""Tangents are swept one by one."""

ROUNDS, ITERATIONS = 4, 25
NEAR = 0.01
"""How far, relative, the full error may be from that in the subspace, or from the RMS of the motion times this."""

GAIN = 0.9
"""What a round from the third on brings the full error to, relative to the best before it, where another follows."""

SAMPLES = 100
SMALLEST_STEP = 1e-5
"""Of a logarithm, where the iterations end."""


@dataclass(frozen=True)
class Found:
    """A start, and how it was found."""

    scene: Scene
    rmse: float  # m, in full, of all that is observed
    evaluations: int  # simulations in the subspace, tangents included
    rounds: int  # bases that were built, and full simulations


class Memory:
    """Motions in memory, as `recording.Data` has them in a file."""

    def __init__(self, x0: Array) -> None:
        self.x0, self.x = x0, list[Array]()

    def motion(self, episode: int, cloth: int) -> tuple[Array, Flags]:
        """The displacements (frames, n, 3), m, and which frames are good."""
        return self.x[episode] - self.x0, np.ones(len(self.x[episode]), bool)


class Problem:
    """One cloth, its target, and the subspace of the motions seen so far."""

    def __init__(self, scene: Scene, cloth: int, target: Motion, size: int) -> None:
        self.scene, self.cloth, self.size = scene, cloth, size
        self.frames = min(len(target.times), scene.frames)
        self.target, self.seen = target.of(cloth)[: self.frames], target.seen(cloth)[: self.frames]
        self.system = build(scene, cloth, steps=self.frames - 1)
        check(self.system)
        self.memory = Memory(self.system.x0)
        if self.seen.all():
            self.memory.x.append(self.target)
        self.evaluations = 0

    def under(self, p: Array) -> System:
        """The system with fitted values p (P,)."""
        from clothfit.engine.system import with_elements

        return with_elements(self.system, elements(self.scene, self.cloth, p))

    def rebuild(self, full: Array, p: Array) -> None:
        """Take a full motion (frames, n, 3) with values p in, and make the basis and the cubature anew."""
        self.memory.x.append(full)
        system, count = self.under(p), len(self.memory.x)
        data: Any = self.memory  # in place of a file
        found = basis.decompose(data, self.cloth, [system] * count, self.size, range(count))
        self.basis = basis.enriched(found, system, self.size, full[-1], 0)
        own = Reduced(system, self.basis)
        q = carrier.coordinates(full - system.x0, system, carrier.projection(self.basis, system))
        v = np.diff(q, axis=0) / own.h
        times = sorted({int(t) for t in np.linspace(1, len(full) - 2, SAMPLES)}) if len(full) > 3 else []
        steps = [cubature.Sample(0, t, q[t], v[t - 1], v[t]) for t in times]
        self.chosen = cubature.find([own], steps, 0.003, 0).selection if steps else own.chosen

    def residuals(self, p: Array, columns: Sequence[Array]) -> tuple[Array, Array]:
        """How far the reduced motion is from the target (R,), m, and its derivative along some directions (R, C)."""
        own = Reduced(self.under(p), self.basis, self.chosen)
        motion = adjoint.simulate(own, self.frames - 1)
        self.evaluations += 1 + len(columns)
        if len(motion.states) < self.frames:
            return np.array([np.inf]), np.zeros((1, len(columns)))
        away = (decode(own, motion.q) - self.target)[self.seen].ravel()
        J = np.empty((len(away), len(columns)))
        flat = own.basis.reshape(-1, own.r)
        for k, direction in enumerate(columns):
            dq = adjoint.tangent(own, motion, changes(self.scene, self.cloth, p, direction))
            J[:, k] = (dq @ flat.T).reshape(self.frames, -1, 3)[self.seen].ravel()
        return away, J


def checked(scene: Scene, target: Motion) -> None:
    """Raise InvalidInput where the subspace cannot help."""
    count = len(parameters(scene))
    if not 0 < count <= MOST_VALUES:
        flagged = f"the scene flags {count}; see --model F, G, R, M"
        raise InvalidInput(f"--subspace fits 1 to {MOST_VALUES} values; {flagged}")
    for cloth in fitted_cloths(scene):
        others = set(extra_kinds(scene, cloth)) - set(adjoint.KINDS)
        if others:
            raise InvalidInput(f"--subspace does not fit {min(others)}")
    steps = target.times / scene.delta
    if not np.allclose(steps, np.arange(len(steps)), atol=1e-6):
        raise InvalidInput("--subspace needs a target with a frame for each time step")


def fit(
    scene: Scene, target: Motion, start: Scene | None, size: int = 64, report: Callable[[str], None] = lambda _: None
) -> Found:
    """The values of a scene with which its reduced motion is nearest to a target, from those of `start`."""
    checked(scene, target)
    with threads.single():
        return rounds(scene, target, parameters(start or scene, scene), size, report)


def rounds(scene: Scene, target: Motion, p: Array, size: int, report: Callable[[str], None]) -> Found:
    """Fit, look at the full motion, and build the basis anew, until they agree."""
    problems = [Problem(scene, cloth, target, size) for cloth in fitted_cloths(scene)]
    best, error, number, reduced = p, full_error(scene, p, problems), 0, np.inf
    current, full = p, error
    while number < ROUNDS:
        number += 1
        for problem, x in zip(problems, full[1], strict=True):
            problem.rebuild(x, current)
        current, reduced = minimise(problems, scene, best)
        full = full_error(scene, current, problems)
        gained = full[0] < GAIN * error[0]
        report(f"round {number} in the subspace: {1e3 * reduced:.4g} mm there, {1e3 * full[0]:.4g} mm in full")
        if full[0] < error[0]:
            best, error = current, full
        if (number > 2 and not gained) or abs(full[0] - reduced) <= NEAR * max(full[0], NEAR * full[2]):
            break
    made = with_parameters(scene, best)
    return Found(made, error[0], sum(each.evaluations for each in problems), number)


def full_error(scene: Scene, p: Array, problems: Sequence[Problem]) -> tuple[float, list[Array], float]:
    """The RMSE, m, of the full motion with values p, the motions (frames, n, 3) and the RMS of their displacements."""
    cloths = [problem.cloth for problem in problems]
    motion = simulate_cloths(with_parameters(scene, p), cloths, problems[0].frames)
    motions = [motion.of(cloth) for cloth in cloths]
    away = np.concatenate([(x - own.target)[own.seen] for x, own in zip(motions, problems, strict=True)])
    moved = np.concatenate([(x - x[0]).reshape(-1, 3) for x in motions])
    return float(np.sqrt((away**2).sum(axis=1).mean())), motions, float(np.sqrt((moved**2).sum(axis=1).mean()))


def minimise(problems: Sequence[Problem], scene: Scene, p: Array) -> tuple[Array, float]:
    """Levenberg's iterations from p (P,); the values found and the RMSE, m."""
    low, high = bounds(scene)
    scale = np.where(p > 0, p, np.maximum(np.abs(p), 1.0))
    grows = p > 0

    def along(p: Array) -> list[Array]:
        return [np.where(np.arange(len(p)) == i, np.where(grows, p, scale), 0.0) for i in range(len(p))]

    away, J = evaluated(problems, p, along(p))
    damping = 1e-3
    for _ in range(ITERATIONS):
        interrupts.check()
        normal, slope = J.T @ J, J.T @ away
        own = np.maximum(np.diag(normal), 1e-300)
        dy = np.clip(-np.linalg.solve(normal + damping * np.diag(own), slope), -2.0, 2.0)
        moved = np.clip(np.where(grows, p * np.exp(dy), p + scale * dy), low, high)
        better, _ = evaluated(problems, moved, [])
        if better @ better < away @ away:
            p, damping = moved, damping * 0.1
            away, J = evaluated(problems, p, along(p))
        else:
            damping *= 10.0
        if np.abs(dy).max() < SMALLEST_STEP or damping > 1e8:
            break
    return p, float(np.sqrt(3.0 * (away**2).mean()))


def evaluated(problems: Sequence[Problem], p: Array, columns: Sequence[Array]) -> tuple[Array, Array]:
    """The residuals of all cloths, and their derivative."""
    found = [problem.residuals(p, columns) for problem in problems]
    return np.concatenate([away for away, _ in found]), np.concatenate([J for _, J in found])
