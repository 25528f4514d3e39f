"""The least forces of every vertex and step that take the cloths of a scene through keys, in a closed loop.

From the forces that hold a cloth on the first path L-BFGS goes down to those of the least effort (`Descent`).

Forces that play back to the same motion: found once more, step by step, along the steps of the engine itself.

A cloth that buckles or flutters forgets no rounding: forces that were found along one motion lead, played to a cloth
that is 1e-16 m beside it, somewhere else. So each force is the one that the closed loop applies to the state in which
the engine really is, with the tolerance of the scene. The same steps from the same start give the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array
from clothfit.base.checkpoint import Checkpoint
from clothfit.base.memory import free
from clothfit.control.closed_loop import FINEST, HUGE, SOLVE_TOLERANCE, ClosedLoop, Costs, Task
from clothfit.control.controls import Controls
from clothfit.control.keyframes import Key, last_step, path, without_fixed
from clothfit.engine import rollout
from clothfit.engine.inputs.interpolation import splined
from clothfit.engine.rollout import Rollout
from clothfit.engine.step import implicit
from clothfit.engine.system import BDF2, IMPLICIT, System, build
from clothfit.motion.divergence import Diverged
from clothfit.motion.simulate import limited
from clothfit.optimise.scipy_methods import lbfgs
from clothfit.optimise.status import Status, Stop
from clothfit.scene.forces import Forces
from clothfit.scene.scene import Scene

Report: TypeAlias = Callable[[float, float, int], object]
"""Gets the effort, N² s, what is missed of the keys that are penalties, m, and the evaluations so far."""

MOST_PAIRS, LEAST_PAIRS = 10, 5
"""Steps that L-BFGS remembers, as memory allows."""

ROUND = 200
"""Evaluations after which L-BFGS begins anew, from where a search that was killed goes on; penalties are looked at."""

STALL, GAIN, PATIENT_GAIN = 100, 5e-4, 1e-12
"""A descent ends where so many evaluations lower the effort by less than this share; one with a budget of time by less
than the second.
"""

OPTIMAL = 1e-6
"""Slope, relative to that where the search began, at which a descent has converged."""

KEY_ERRORS, NEAR_HARD = 2e-4, 5e-7
"""m: what may be left of a key that is a penalty, an ordinary and a hard one."""


NEARER, PATIENCE = 0.95, 4
"""A descent with multipliers ends after so many rounds in a row that leave more than this share of the misses."""

PENALTIES = 4.0**8
"""How much penalties may grow."""

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
class Found:
    """What a search for controls came to."""

    status: Status
    scene: Scene  # with the paths, the wind and the velocities that were found
    forces: Forces | None  # of a closed loop with the gains and places of its springs
    optimality: float
    evaluations: int


@dataclass
class Best:
    """The best forces so far."""

    f: Array  # (T, n, 3), N
    x: Array  # (T + 1, n, 3), m, where they lead
    u: Array  # (T, n, 3), N, with which it needs no springs
    value: float
    gradient: float  # its `ClosedLoop.slope`


class Descent:
    """A descent of a closed loop from forces f (T, n, 3), N."""

    def __init__(
        self, loop: ClosedLoop, f: Array, report: Report, limit: float = np.inf, patient: bool = False,
        keep: Callable[[Descent], object] | None = None, so_far: Search | None = None,
    ) -> None:  # fmt: skip
        """`limit`: evaluations, at most; `patient`: whether it may take all the time there is; `keep` gets the descent
        after each evaluation; `so_far`: where one with the same forces was that this goes on with.
        """
        self.loop, self.report, self.left, self.keep = loop, report, limit, keep
        self.gain = PATIENT_GAIN if patient and not loop.wishes else GAIN
        self.values: list[float] = []
        self.before, self.idle = np.inf, 0  # the gradient, or what was missed of keys, before; rounds without a gain
        self.most = PENALTIES * loop.penalty
        with interrupts.grace(np.inf):  # there is always a result
            value, gradient = loop(f)
        size = loop.slope(gradient)
        loop.steepest = loop.steepest or size
        self.best = Best(f, loop.x, loop.u, value, size)
        if so_far is not None:
            self.values, loop.evaluations = list(so_far.values), so_far.evaluations
            self.before, self.idle, self.most = so_far.before, so_far.idle, so_far.most
        self.begun = self.place()  # where L-BFGS last began anew

    def place(self) -> Search:
        """What a checkpoint has of it."""
        loop = self.loop
        return Search(
            loop.path, self.best.f, loop.rate, "", **loop.way, tolerance=loop.tolerance,
            values=self.values[-1 - STALL :], before=self.before, idle=self.idle, most=self.most,
            evaluations=loop.evaluations,
        )  # fmt: skip

    def run(self) -> Status:
        """Descend until it has converged or no longer gets better; a deadline or an interrupt leaves the best."""
        try:
            return self.rounds() if self.loop.wishes else self.alone()
        except interrupts.OutOfTime:
            return Status.LIMIT
        except KeyboardInterrupt:
            return Status.INTERRUPTED

    def alone(self) -> Status:
        """Descend where no key is a penalty: where the search finds nothing better, again with finer motions and a new
        memory, as long as that lowers the gradient.
        """
        while True:
            self.before = self.best.gradient if np.isinf(self.before) else self.before
            began = self.loop.evaluations
            status = self.round()
            if status is not None:
                return status
            if self.loop.evaluations - began >= ROUND:
                self.begun = self.place()
                continue
            if self.loop.tolerance <= FINEST and self.best.gradient > 0.5 * self.before:
                return Status.STALLED
            self.loop.tolerance, self.before = FINEST, np.inf
            self.restart()

    def rounds(self) -> Status:
        """Descend with multipliers until the keys that are penalties are met, or come no nearer."""
        loop = self.loop
        near = NEAR_HARD if any(wish.key.hard for wish in loop.wishes) else KEY_ERRORS
        while True:
            status = self.round()
            loop.x, loop.u = self.best.x, self.best.u
            missed = loop.missed
            if status is Status.LIMIT or (missed <= near and status is not None):
                return status
            self.idle = 0 if missed < NEARER * self.before else self.idle + 1
            if self.idle == PATIENCE:
                return Status.STALLED
            loop.insist()
            if missed > 0.25 * self.before:
                loop.penalty = min(4.0 * loop.penalty, self.most)
            self.before = min(self.before, missed)
            self.restart()

    def restart(self) -> None:
        """Values before and after a change of the multipliers cannot be compared."""
        value, gradient = self.loop(self.best.f)
        size = self.loop.slope(gradient)
        self.loop.steepest = max(self.loop.steepest, size)  # larger penalties are steeper
        self.best = Best(self.best.f, self.loop.x, self.loop.u, value, size)
        self.values = [value]
        self.begun = self.place()

    def round(self) -> Status | None:
        """Some evaluations; how the descent ended, if it has."""
        unknown, shape = self.loop.unknown, self.best.f.shape
        room = int(0.2 * free() / (16.0 * 3.0 * max(int(unknown.sum()), 1)))
        pairs = int(np.clip(room, LEAST_PAIRS, MOST_PAIRS))
        scale = np.sqrt(2.0 * self.loop.h)

        def cost(z: Array) -> tuple[float, Array]:
            f = np.zeros(shape)
            f[unknown] = z.reshape(-1, 3) / scale
            value, gradient = self.evaluate(f)
            return value, gradient[unknown].reshape(-1) / scale

        start: Array = self.best.f[unknown].reshape(-1) * scale
        try:
            lbfgs(cost, start, recent=pairs, limit=ROUND)
        except Stop as stop:
            return stop.status
        return None

    def evaluate(self, f: Array) -> tuple[float, Array]:
        """Value and gradient, noting the best. Raises Stop where the descent has ended."""
        interrupts.check()
        value, gradient = self.loop(f)
        size = self.loop.slope(gradient)
        if value < self.best.value:
            self.best = Best(f, self.loop.x, self.loop.u, value, size)
            interrupts.hold()
        self.values.append(self.best.value)
        self.report(self.loop.effort, self.loop.missed, self.loop.evaluations)
        if self.keep:
            self.keep(self)
        self.left -= 1
        if self.left <= 0:
            raise Stop(Status.LIMIT)
        if self.best.gradient <= OPTIMAL * self.loop.steepest:
            raise Stop(Status.CONVERGED)
        if len(self.values) > STALL and self.values[-1 - STALL] - self.best.value <= self.gain * abs(self.best.value):
            raise Stop(Status.STALLED)
        return value, gradient


def follow(
    scene: Scene, keys: Sequence[Key], controls: Controls, alone: Array, budget: float | None, costs: Costs,
    report: Report, file: Checkpoint | None, state: Mapping[str, Any],
) -> Found:  # fmt: skip
    """Search for the forces on each cloth with keys; `alone` (T + 1, n, 3), m, is the motion without them, `state` what
    a checkpoint had.
    """
    kept, clock, steps = Kept(file, unpacked(state)), interrupts.now(), last_step(keys)
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
            task = Task(scene, cloth, own, acting, costs)
            loop, descent, status = solved(task, alone[:, part], report, kept, share is not None)
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
    optimality = max(value for _, value in found)
    return Found(status, scene, Forces(times, u, gain, places), optimality, evaluations)


def solved(
    task: Task, alone: Array, report: Report, kept: Kept, patient: bool
) -> tuple[ClosedLoop, Descent, Status]:
    """The closed loop of a cloth, what its descent came to, and how that ended."""
    fixed, cloth = task.scene.cloths[task.cloth].fixed, task.cloth
    task = task._replace(keys=[own for key in task.keys if len((own := without_fixed(key, fixed)).vertices)])
    steps = max((key.step for key in task.keys), default=1)
    so_far = kept.searches.get(cloth)
    loop, f, ended = begun(task, alone[: steps + 1], report) if so_far is None else restored(task, so_far)
    descent = Descent(loop, f, report, patient=patient, keep=partial(kept.note, cloth), so_far=so_far)
    status = descent.run() if ended is None else ended
    kept.note(cloth, descent, status)
    return loop, descent, status


@dataclass
class Search:
    """Where the search for the forces of a cloth is, in its closed loop."""

    path: Array  # (T + 1, n, 3), m, of the loop
    forces: Array  # (T, n, 3), N, the best so far
    rate: float  # of the loop's springs, 1/s
    ended: str  # which status it ended with; "" where it has not
    multipliers: Array  # (M,), of the keys that are penalties, one after another
    penalty: float
    steepest: float  # slope where it began
    tolerance: float = SOLVE_TOLERANCE
    values: Sequence[float] = ()  # the best so far after each of the last evaluations
    before: float = np.inf
    idle: int = 0
    most: float = np.inf  # of the penalty
    evaluations: int = 0


def packed(searches: Mapping[int, Search]) -> dict[str, Any]:
    """The searches of some cloths, by number, as a checkpoint has them."""
    found: dict[str, Any] = {"cloths": list(searches)}
    for cloth, own in searches.items():
        found |= {f"{name}{cloth}": value for name, value in asdict(own).items()}
    return found


def unpacked(state: Mapping[str, Any]) -> dict[int, Search]:
    """The searches in such a state; none where there are none."""
    names = Search.__dataclass_fields__
    cloths = state.get("cloths", ())
    return {
        cloth: Search(**{name: state[f"{name}{cloth}"] for name in names if f"{name}{cloth}" in state})
        for cloth in cloths
    }


@dataclass(frozen=True)
class Kept:
    """What a checkpoint has of the searches of all cloths."""

    file: Checkpoint | None
    searches: dict[int, Search]

    def note(self, cloth: int, descent: Descent, ended: Status | None = None) -> None:
        """Keep where L-BFGS last began anew, as one that goes on from there ends as it would have ended, or where the
        search ended.
        """
        if self.file is None:
            return
        over = str(ended) if ended in (Status.CONVERGED, Status.STALLED) else ""
        self.searches[cloth] = descent.begun if ended is None else replace(descent.place(), ended=over)
        self.file.keep(lambda: packed(self.searches), now=ended is not None)


def restored(task: Task, own: Search) -> tuple[ClosedLoop, Array, Status | None]:
    """The closed loop of such a search, the forces to go on with, and how it ended, if it has."""
    with interrupts.grace(np.inf):
        loop = ClosedLoop(task, own.path, own.rate)
    loop.resume(own.multipliers, own.penalty, own.steepest)
    loop.tolerance = own.tolerance
    return loop, own.forces, Status(own.ended) if own.ended else None


def begun(task: Task, alone: Array, report: Report) -> tuple[ClosedLoop, Array, Status | None]:
    """The closed loop of a cloth and the forces f to begin with: those of a loop with steps twice as long, if there can
    be one, as it takes half the time; else along the first path through the keys. And the status where the user has
    asked for the end meanwhile.
    """
    scene, keys, steps = task.scene, task.keys, len(alone) - 1
    own = scene.cloths[task.cloth]
    if scene.method < IMPLICIT or steps < FEWEST or any(key.step % 2 for key in keys):
        still = np.where(own.fixed[None, :, None], alone, alone[:1])
        paths = [path(each, keys, own.springs, own.fixed) for each in (alone, still)]
        with interrupts.grace(np.inf):
            loop = stable(task, paths)
        return loop, np.zeros_like(loop.places), None
    longer = scene.with_step(2.0 * scene.delta, steps // 2 + 1)
    halved = [replace(key, step=key.step // 2) for key in keys]
    coarse, f, ended = begun(task._replace(scene=longer, keys=halved), alone[::2], report)
    descent = Descent(coarse, f, report, COARSE[scene.method])
    ended = descent.run() if ended is None else ended
    with interrupts.grace(np.inf):
        places = splined(np.arange(0.0, steps + 1.0, 2.0), descent.best.x, "keys")(np.arange(steps + 1))
        places[:, own.fixed] = alone[:, own.fixed]
        loop = stable(task, [places])
        loop.resume(**coarse.way)
        loop.evaluations += coarse.evaluations
    forces = np.where(loop.unknown[:, :, None], np.repeat(descent.best.u, 2, axis=0), 0.0)
    return loop, forces, ended if ended is Status.INTERRUPTED else None


def stable(task: Task, paths: Sequence[Array]) -> ClosedLoop:
    """The closed loop along the path that takes less effort, with springs just stiff enough to be stable."""
    tried: list[tuple[float, ClosedLoop]] = []
    for rate in RATES:
        tried = []
        for each in paths:
            loop = ClosedLoop(task, each, rate)
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
