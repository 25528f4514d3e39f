"""The least forces that take the cloths of a scene through keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.control import recording
from clothfit.control.closed_loop import HUGE, ClosedLoop, Costs
from clothfit.control.descent import Descent, Report
from clothfit.control.feedback import with_gains
from clothfit.control.keyframes import Key, last_step, left_of
from clothfit.control.reference import path
from clothfit.engine.inputs.splines import splined
from clothfit.engine.system import IMPLICIT
from clothfit.kernels.clock import computing
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.optimise.status import Status
from clothfit.scene.over_time.forces import Forces
from clothfit.scene.scene import Scene

FEWEST, COARSE = 40, 250
"""Steps from which on steps twice as long are tried first, and evaluations of them."""

RATES = (20.0, 40.0, 80.0, 160.0, 320.0)
"""Rates of the springs that hold a cloth near its path, 1/s, to try."""

NEAR = 1e-3
"""m: a key that the cloth passes no farther than this is reached; a hard one within a thousandth of it."""

CALM = 1.0
"""Size of the gradient by the forces, relative to that of the effort's own term, up to which the closed loop counts as
stable: more, and small forces early decide what comes late.
"""


@dataclass(frozen=True, eq=False)
class Reached:
    """How near a key the cloth came."""

    time: float  # s
    cloth: int  # of the scene, counted from 0
    rmse: float  # m, over its vertices
    hard: bool  # whether it was to be met to 1 µm

    @property
    def near(self) -> bool:
        """Whether it is reached."""
        return self.rmse <= (NEAR * 1e-3 if self.hard else NEAR)


@dataclass(frozen=True, eq=False)
class Control:
    """Forces that take a scene through keys, and what they lead to."""

    status: Status  # how the search ended
    forces: Forces  # with the gains and places of a feedback
    motion: Motion  # what `simulate` makes of them
    keys: tuple[Reached, ...]  # how near each of them the motion comes
    free: tuple[float, ...]  # m, how far the cloth is from each key without forces
    effort: float  # Σ |u|² h, N² s
    optimality: float  # gradient of the effort, relative to that at the start
    evaluations: int  # of effort and gradient
    seconds: float  # of computing
    at_bound: int  # forces of a vertex in a step that are within a thousandth of their bound


def find_forces(
    scene: Scene,
    keys: Sequence[Key],
    pushed: Sequence[Flags] | None = None,
    *,
    budget: float | None = None,
    costs: Costs = Costs(),  # noqa: B008  it cannot be changed
    report: Report | None = None,
) -> Control:
    """Find the forces of least effort Σ |u|² h under which the cloths go through keys.

    `pushed`: of each object, the vertices (n,) that forces may act on (default: all that are not fixed). `budget` in
    s. Raises InvalidInput where a key asks for a fixed vertex to be elsewhere, Diverged where no motion stays finite.
    """
    check(scene, keys)
    began, clock, steps = computing(), interrupts.now(), last_step(keys)
    times, counts = scene.delta * np.arange(steps, dtype=float), scene.vertex_counts
    u, gain, places = (np.zeros((steps, sum(counts), *rest)) for rest in ((3,), (), (3,)))
    alone, evaluations, found = moved(scene, steps), 0, []
    cloths = sorted({key.cloth for key in keys})
    for number, cloth in enumerate(cloths):
        own = [key for key in keys if key.cloth == cloth]
        part = scene.vertices(cloth)
        acting = ~scene.cloths[cloth].fixed & (True if pushed is None else pushed[cloth])
        share = None if budget is None else (budget - (interrupts.now() - clock)) / (len(cloths) - number)
        with threads.single(), interrupts.limited(share):
            loop, descent, status = solved(scene, cloth, own, alone[:, part], acting, costs, report)
        if not descent.best.value < HUGE:
            raise Diverged(f"{scene.name}: no motion through the keys stays finite; try shorter steps", 0)
        found.append((status, descent.best.gradient / (descent.steepest or 1.0)))
        evaluations += loop.evaluations
        with interrupts.grace(np.inf):
            u[: loop.steps, part] = recording.recorded(scene, loop, descent.best.f, costs.most)
        gain[: loop.steps, part] = loop.gain.min(axis=0)  # the keys' own are too stiff for a disturbed cloth
        x = descent.best.x
        places[: loop.steps, part] = x[1:] if loop.late else x[:-1]
    forces = Forces(times, u, gain, places)
    with interrupts.grace(np.inf):
        if all(status is not Status.INTERRUPTED for status, _ in found):
            forces = with_gains(scene, forces, keys, costs.most)
        motion = simulate(scene.with_forces(forces), max(steps + 1, scene.frames))
    return Control(
        max((status for status, _ in found), key=list(Status).index), forces, motion,
        tuple(reached(key, motion, scene) for key in keys), tuple(miss(key, alone, scene) for key in keys),
        scene.delta * float((u * u).sum()), max(value for _, value in found), evaluations, computing() - began,
        int((np.sqrt((u * u).sum(axis=2)) >= costs.most * (1.0 - 1e-3)).sum()),
    )  # fmt: skip


def check(scene: Scene, keys: Sequence[Key]) -> None:
    """Raise InvalidInput where keys cannot be reached by any force."""
    if scene.frame:
        raise InvalidInput(f"{scene.name}: frame: forces need axes that do not move")
    for key in keys:
        cloth = scene.cloths[key.cloth]
        held = cloth.fixed[key.vertices]
        if key.share is not None or cloth.pins or not held.any():
            continue
        far = np.abs(key.positions[held] - cloth.positions[key.vertices[held]]).max()
        if key.hard and far > 1e-3:
            vertex = key.vertices[held][0]
            raise InvalidInput(
                f"keys: vertex {vertex} of objects[{key.cloth}] is fixed, and asked to be {far:.3g} m from where it is "
                f"at {key.step * scene.delta:g} s"
            )


def moved(scene: Scene, steps: int) -> Array:
    """Where the cloths go without forces, (T + 1, n, 3), m; where they diverge, they stay from then on."""
    try:
        x = simulate(scene, steps + 1).positions
    except Diverged as error:
        if error.motion is None:
            raise
        x = error.motion.positions
    return np.concatenate([x, np.repeat(x[-1:], steps + 1 - len(x), axis=0)])


def solved(
    scene: Scene, cloth: int, keys: Sequence[Key], alone: Array, pushed: Flags, costs: Costs, report: Report | None
) -> tuple[ClosedLoop, Descent, Status]:
    """The closed loop of a cloth, what its descent came to, and how that ended."""
    fixed = scene.cloths[cloth].fixed
    keys = [kept for key in keys if len((kept := without_fixed(key, fixed)).vertices)]
    steps = max((key.step for key in keys), default=1)
    loop, f = begun(scene, cloth, keys, alone[: steps + 1], pushed, costs, report or (lambda *_: None))
    descent = Descent(loop, f, report or (lambda *_: None))
    return loop, descent, descent.run()


def begun(
    scene: Scene, cloth: int, keys: Sequence[Key], alone: Array, pushed: Flags, costs: Costs, report: Report
) -> tuple[ClosedLoop, Array]:
    """The closed loop of a cloth and the forces f to begin with: those of a loop with steps twice as long, if there can
    be one, as it takes half the time; else along the first path through the keys.
    """
    own, steps = scene.cloths[cloth], len(alone) - 1
    if scene.method < IMPLICIT or steps < FEWEST or any(key.step % 2 for key in keys):
        still = np.where(own.fixed[None, :, None], alone, alone[:1])
        paths = [path(each, keys, own.springs, own.fixed) for each in (alone, still)]
        with interrupts.grace(np.inf):
            loop = stable(scene, cloth, keys, paths, pushed, costs)
        return loop, np.zeros_like(loop.places)
    longer = scene.with_step(2.0 * scene.delta, steps // 2 + 1)
    halved = [replace(key, step=key.step // 2) for key in keys]
    coarse, f = begun(longer, cloth, halved, alone[::2], pushed, costs, report)
    descent = Descent(coarse, f, report, COARSE)
    descent.run()
    with interrupts.grace(np.inf):
        places = splined(np.arange(0.0, steps + 1.0, 2.0), descent.best.x, "keys")(np.arange(steps + 1))
        places[:, own.fixed] = alone[:, own.fixed]
        loop = stable(scene, cloth, keys, [places], pushed, costs)
        loop.resume(coarse)
    return loop, np.where(loop.unknown[:, :, None], np.repeat(descent.best.u, 2, axis=0), 0.0)


def without_fixed(key: Key, fixed: Flags) -> Key:
    """A key without the fixed vertices, whose place is given; a mean keeps them."""
    if key.share is not None:
        return key
    kept = ~fixed[key.vertices]
    velocities = None if key.velocities is None else key.velocities[kept]
    return replace(key, vertices=key.vertices[kept], positions=key.positions[kept], velocities=velocities)


def stable(
    scene: Scene, cloth: int, keys: Sequence[Key], paths: Sequence[Array], pushed: Flags, costs: Costs
) -> ClosedLoop:
    """The closed loop along the path that takes less effort, with springs just stiff enough to be stable."""
    tried: list[tuple[float, ClosedLoop]] = []
    for rate in RATES:
        tried = []
        for each in paths:
            loop = ClosedLoop(scene, cloth, keys, each, pushed, rate, costs)
            value, gradient = loop(np.zeros_like(loop.places))
            size = float(np.linalg.norm(gradient))
            calm = size / np.sqrt(2.0 * loop.h) <= CALM * np.sqrt(4.0 * max(value, 1e-300))
            tried.append((value if calm else np.inf, loop))
        if min(value for value, _ in tried) < np.inf:
            break
    loop = min(tried, key=lambda pair: pair[0])[1]
    misfit = sum(key.key.weight * float((key.left(loop.x) ** 2).sum()) for key in loop.wishes)
    loop.penalty = max(loop.effort, 1e-12) / max(misfit, 1e-12)
    return loop


def miss(key: Key, x: Array, scene: Scene) -> float:
    """Root mean square distance, m, of the vertices of a key from it, at positions x (T + 1, n, 3) of all objects."""
    away = left_of(key, x[:, scene.vertices(key.cloth)])
    return float(np.sqrt(np.mean((away**2).sum(axis=1))))


def reached(key: Key, motion: Motion, scene: Scene) -> Reached:
    """How near a key a motion comes."""
    return Reached(key.step * scene.delta, key.cloth, miss(key, motion.positions, scene), key.hard)
