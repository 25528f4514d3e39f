"""The least forces of every vertex and step that take the cloths of a scene through keys, in a closed loop.

Forces that play back to the same motion: found once more, step by step, along the steps of the engine itself.

A cloth that buckles or flutters forgets no rounding: forces that were found along one motion lead, played to a cloth
that is 1e-16 m beside it, somewhere else. So each force is the one that the closed loop applies to the state in which
the engine really is, with the tolerance of the scene. The same steps from the same start give the same bits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array, Flags
from clothfit.base.checkpoint import Checkpoint
from clothfit.control.closed_loop import HUGE, ClosedLoop, Costs
from clothfit.control.controls import Controls
from clothfit.control.descent import Descent, Report
from clothfit.control.keyframes import Key, last_step, path, without_fixed
from clothfit.engine import rollout
from clothfit.engine.inputs.interpolation import splined
from clothfit.engine.rollout import Rollout
from clothfit.engine.step import implicit
from clothfit.engine.system import BDF2, IMPLICIT, System, build
from clothfit.motion.divergence import Diverged
from clothfit.motion.simulate import limited
from clothfit.optimise.status import Status
from clothfit.scene.forces import Forces
from clothfit.scene.scene import Scene

FEWEST, COARSE = 40, {IMPLICIT: 120, BDF2: 350}
"""Steps from which on steps twice as long are tried first, and evaluations of them: those of BDF2 lead nearer to what
shorter ones come to, as Euler's damping grows with the step.
"""

RATES = (20.0, 40.0, 80.0, 160.0, 320.0)
"""Rates of the springs that hold a cloth near its path, 1/s, to try."""

CALM = 1.0
"""Size of the gradient by the forces, relative to that of the effort's own term, up to which the closed loop counts as
stable: more, and small forces early decide what comes late.
"""


@dataclass(frozen=True, eq=False)
class Followed:
    """What a search in the closed loop came to."""

    status: Status
    forces: Forces  # with the gains and places of the loop's springs
    optimality: float
    evaluations: int


def follow(
    scene: Scene, keys: Sequence[Key], controls: Controls, alone: Array, budget: float | None, costs: Costs,
    report: Report, kept: Kept,
) -> Followed:  # fmt: skip
    """Search for the forces on each cloth with keys; `alone` (T + 1, n, 3), m, is the motion without them."""
    clock, steps = interrupts.now(), last_step(keys)
    times, counts = scene.delta * np.arange(steps, dtype=float), scene.vertex_counts
    u, gain, places = (np.zeros((steps, sum(counts), *rest)) for rest in ((3,), (), (3,)))
    evaluations, found = 0, []
    cloths = sorted({key.cloth for key in keys})
    for number, cloth in enumerate(cloths):
        own = [key for key in keys if key.cloth == cloth]
        part = scene.vertices(cloth)
        acting = ~scene.cloths[cloth].fixed & (True if controls.forces is None else controls.forces[cloth])
        share = None if budget is None else (budget - (interrupts.now() - clock)) / (len(cloths) - number)
        with threads.single(), interrupts.limited(share):
            loop, descent, status = solved(scene, cloth, own, alone[:, part], acting, costs, report, kept, share)
        if not descent.best.value < HUGE:
            raise Diverged(f"{scene.name}: no motion through the keys stays finite; try shorter steps", 0)
        found.append((status, descent.best.gradient / (loop.steepest or 1.0)))
        evaluations += loop.evaluations
        with interrupts.grace(np.inf):
            u[: loop.steps, part] = recorded(scene, loop, descent.best.f, costs.most)
        gain[: loop.steps, part] = loop.gain.min(axis=0)  # the keys' own are too stiff for a disturbed cloth
        x = descent.best.x
        places[: loop.steps, part] = x[1:] if loop.late else x[:-1]
    status = max((status for status, _ in found), key=list(Status).index)
    return Followed(status, Forces(times, u, gain, places), max(value for _, value in found), evaluations)


def solved(
    scene: Scene, cloth: int, keys: Sequence[Key], alone: Array, pushed: Flags, costs: Costs, report: Report,
    kept: Kept, budget: float | None = None,
) -> tuple[ClosedLoop, Descent, Status]:  # fmt: skip
    """The closed loop of a cloth, what its descent came to, and how that ended."""
    fixed = scene.cloths[cloth].fixed
    keys = [own for key in keys if len((own := without_fixed(key, fixed)).vertices)]
    steps = max((key.step for key in keys), default=1)
    if cloth in kept.searches:
        loop, f, ended = kept.restored(scene, cloth, keys, pushed, costs)
    else:
        loop, f, ended = begun(scene, cloth, keys, alone[: steps + 1], pushed, costs, report)
    descent = Descent(loop, f, report, patient=budget is not None, keep=partial(kept.note, cloth))
    status = descent.run() if ended is None else ended
    kept.note(cloth, descent, status)
    return loop, descent, status


@dataclass
class Search:
    """Where the search for the forces of a cloth is, in its closed loop."""

    path: Array  # (T + 1, n, 3), m, of the loop
    forces: Array  # (T, n, 3), N, the best so far
    multipliers: Array  # (M,), of the keys that are penalties, one after another
    rate: float  # of the loop's springs, 1/s
    penalty: float
    steepest: float  # slope where it began
    ended: str  # which status it ended with; "" where it has not


def packed(searches: Mapping[int, Search]) -> dict[str, Any]:
    """The searches of some cloths, by number, as a checkpoint has them."""
    found: dict[str, Any] = {"cloths": list(searches)}
    for cloth, own in searches.items():
        found |= {f"{name}{cloth}": value for name, value in asdict(own).items()}
    return found


def unpacked(state: Mapping[str, Any]) -> dict[int, Search]:
    """The searches in such a state; none where there are none."""
    names = Search.__dataclass_fields__
    return {cloth: Search(*(state[f"{name}{cloth}"] for name in names)) for cloth in state.get("cloths", ())}


class Kept:
    """What a checkpoint has of the searches of all cloths."""

    def __init__(self, file: Checkpoint | None, state: Mapping[str, Any]) -> None:
        self.file, self.searches = file, unpacked(state)

    def restored(
        self, scene: Scene, cloth: int, keys: Sequence[Key], pushed: Flags, costs: Costs
    ) -> tuple[ClosedLoop, Array, Status | None]:
        """The loop of a cloth, the forces to go on with, and how its search ended, if it has."""
        own, at = self.searches[cloth], 0
        with interrupts.grace(np.inf):
            loop = ClosedLoop(scene, cloth, keys, own.path, pushed, own.rate, costs)
        loop.penalty, loop.steepest = own.penalty, own.steepest
        for i, wish in enumerate(loop.wishes):
            size = wish.multiplier.size
            loop.wishes[i] = replace(wish, multiplier=own.multipliers[at : at + size].reshape(-1, 3))
            at += size
        return loop, own.forces, Status(own.ended) if own.ended else None

    def note(self, cloth: int, descent: Descent, ended: Status | None = None) -> None:
        """Keep where the search of a cloth is."""
        if self.file is None:
            return
        loop = descent.loop
        left = np.concatenate([np.zeros(0), *(wish.multiplier.reshape(-1) for wish in loop.wishes)])
        over = str(ended) if ended in (Status.CONVERGED, Status.STALLED) else ""
        self.searches[cloth] = Search(loop.path, descent.best.f, left, loop.rate, loop.penalty, loop.steepest, over)
        self.file.keep(lambda: packed(self.searches), now=ended is not None)


def begun(
    scene: Scene, cloth: int, keys: Sequence[Key], alone: Array, pushed: Flags, costs: Costs, report: Report
) -> tuple[ClosedLoop, Array, Status | None]:
    """The closed loop of a cloth and the forces f to begin with: those of a loop with steps twice as long, if there can
    be one, as it takes half the time; else along the first path through the keys. And the status where the user has
    asked for the end meanwhile.
    """
    own, steps = scene.cloths[cloth], len(alone) - 1
    if scene.method < IMPLICIT or steps < FEWEST or any(key.step % 2 for key in keys):
        still = np.where(own.fixed[None, :, None], alone, alone[:1])
        paths = [path(each, keys, own.springs, own.fixed) for each in (alone, still)]
        with interrupts.grace(np.inf):
            loop = stable(scene, cloth, keys, paths, pushed, costs)
        return loop, np.zeros_like(loop.places), None
    longer = scene.with_step(2.0 * scene.delta, steps // 2 + 1)
    halved = [replace(key, step=key.step // 2) for key in keys]
    coarse, f, ended = begun(longer, cloth, halved, alone[::2], pushed, costs, report)
    descent = Descent(coarse, f, report, COARSE[scene.method])
    ended = descent.run() if ended is None else ended
    with interrupts.grace(np.inf):
        places = splined(np.arange(0.0, steps + 1.0, 2.0), descent.best.x, "keys")(np.arange(steps + 1))
        places[:, own.fixed] = alone[:, own.fixed]
        loop = stable(scene, cloth, keys, [places], pushed, costs)
        loop.resume(coarse)
    forces = np.where(loop.unknown[:, :, None], np.repeat(descent.best.u, 2, axis=0), 0.0)
    return loop, forces, ended if ended is Status.INTERRUPTED else None


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


def recorded(scene: Scene, loop: ClosedLoop, f: Array, most: float = np.inf) -> Array:
    """The forces u (T, n, 3), N, that the closed loop with forces f applies, none above `most` N. They end early where
    the motion diverges.
    """
    steps = len(f)
    times = loop.h * np.arange(loop.steps, dtype=float)
    table = Forces(times, np.zeros((loop.steps, sum(scene.vertex_counts), 3)))
    played, closed = build(scene.with_forces(table), loop.cloth, steps=loop.steps), loop.system
    assert closed.inputs is not None
    assert played.inputs is not None
    closed.inputs.force[:steps] = f
    u = played.inputs.force
    whole, work = rollout.empty(played, steps), implicit.workspace(played)
    beside = implicit.workspace(closed)
    for t in range(steps):
        one = whole.part(t, t + 1)
        at = ahead(closed, one, scene.tolerance, beside) if loop.late else one.x[0]
        asked = f[t] + loop.gain[t, :, None] * (loop.places[t] - at)
        u[t] = limited(np.where(loop.pushed[:, None], asked, 0.0), most)
        if rollout.fill(played, scene.tolerance, work, one) < 1:
            break
        interrupts.check()
    return u[:steps].copy()


def ahead(closed: System, one: Rollout, tolerance: float, work: implicit.Workspace) -> Array:
    """Where the closed loop takes the state before a step, (n, 3), m."""
    own = rollout.empty(closed, 1)._replace(
        v=one.v, x_before=one.x_before, v_before=one.v_before, ready=one.ready, first=one.first
    )
    own.x[0] = one.x[0]
    rollout.fill(closed, tolerance, work, own)
    after: Array = own.x[1]
    return after
