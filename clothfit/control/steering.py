"""Gauss–Newton through the simulation: from the numbers of few controls to those that bring the cloths nearest to keys.

The keys come in one after another, as a motion that has missed the first says little about the second. Each search is
SciPy's trust-region reflective method with LSMR, which takes products with J only. Keys come before effort: its weight
γ falls from round to round while that brings the cloths nearer. Hard keys are insisted on by multipliers. It begins
with no control, and with handles on the way that the keys suggest (`keyframes`), whichever comes nearer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array
from clothfit.base.checkpoint import Checkpoint
from clothfit.base.errors import InvalidInput
from clothfit.control.closed_loop import Costs
from clothfit.control.controls import Controls, steered
from clothfit.control.following import KEY_ERRORS, NEAR_HARD, Found, Report
from clothfit.control.keyframes import Key, last_step, left_of, path, without_fixed
from clothfit.control.shooting import Shooting, Shot
from clothfit.motion.divergence import Diverged
from clothfit.optimise.status import Status
from clothfit.scene.scene import Scene

SHARES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
"""γ over the misses without control, from round to round."""

GAIN = 0.9
"""A round that leaves more than this share of the misses is the last."""

ROUGH, FINE = 12, 60
"""Evaluations of a search up to a key that is not the last, and of one over all keys."""

SLOW, SLOWEST = 3e-3, 1e-6
"""Relative reduction of the cost by a step that ends a search, and the last one."""

INSISTS = 12
"""Rounds with multipliers, at most."""


def steer(
    scene: Scene, keys: Sequence[Key], controls: Controls, alone: Array, budget: float | None, costs: Costs,
    report: Report, file: Checkpoint | None, state: Mapping[str, Any],
) -> Found:  # fmt: skip
    """Search for the controls of a scene; `alone` (T + 1, n, 3), m, is the motion without them, `state` what a
    checkpoint had.
    """
    steps = last_step(keys)
    given = steered(scene, controls, steps * scene.delta)
    free = [
        kept
        for key in keys
        if len((kept := without_fixed(key, given.cloths[key.cloth].fixed & ~controls.led(scene, key.cloth))).vertices)
    ]
    problem = Shooting(given, free, controls, steps, costs)
    if not problem.size:
        raise InvalidInput(f"{scene.name}: no control can move anything that the keys ask for; all of it is fixed")
    search = Steering(problem, report, file, [Ended(*each) for each in state.get("ended", ())])
    starts = [np.zeros(problem.size), suggested(problem, alone)]
    if "z" in state and state["z"].shape == (problem.size,):
        starts.append(state["z"])
    problem.compile()
    with threads.single(), interrupts.limited(budget):
        status = search.run(starts)
    with interrupts.grace(np.inf):
        optimality = search.optimality()
    z, values = search.found.z, given
    moved: dict[str, Any] = {}
    for block, own in problem.own(z):
        if block.cloth < 0:
            moved[block.kind] = block.values(own)
        elif block.kind != "force":
            each = moved.setdefault(block.kind, [getattr(cloth, block.kind) for cloth in given.cloths])
            each[block.cloth] = block.values(own)
    if moved:
        masses, stiffnesses = ([getattr(cloth, name) for cloth in given.cloths] for name in ("mass", "stiffness"))
        values = given.with_values(masses, stiffnesses, **moved)
    forces = problem.forces(z) if controls.pushes else None
    return Found(status, values, forces, optimality, problem.evaluations)


def suggested(problem: Shooting, alone: Array) -> Array:
    """The numbers (Q,) with which handles go the way that a path through the keys has there."""
    scene, z = problem.scene, np.zeros(problem.size)
    for i, block in enumerate(problem.blocks):
        if block.kind != "path":
            continue
        own = scene.cloths[block.cloth]
        led = problem.controls.led(scene, block.cloth)
        keys = [key for key in problem.keys if key.cloth == block.cloth]
        x = alone[:, scene.vertices(block.cloth)]
        away = path(x, keys, own.springs, own.fixed & ~led) - x
        wanted = np.zeros_like(own.path)
        for number, pin in enumerate(own.pins):
            mine = own.key_pins == number
            if mine.any() and pin.own:
                steps = np.minimum(np.round(pin.own.times / scene.delta).astype(int), len(x) - 1)
                wanted[mine] = away[steps][:, pin.vertices].mean(axis=1)
        z[problem.parts[i] : problem.parts[i + 1]] = block.nearest(wanted)
    return z


class Ended(NamedTuple):
    """What a search of a `Steering` came to."""

    z: Sequence[float]  # (Q,), its last point
    best: Sequence[float]  # (Q,), the best of all so far
    latest: Sequence[float]  # (Q,), the last one that was tried
    value: float  # the cost of the best
    converged: bool
    evaluations: int  # so far


class Steering:
    """A search over the controls of a steered scene."""

    def __init__(self, problem: Shooting, report: Report, file: Checkpoint | None, ended: Sequence[Ended]) -> None:
        """`ended`: the searches that were over when the file was written; they are not done again."""
        self.problem, self.report, self.file = problem, report, file
        self.known, self.over = iter(ended), list[Ended]()
        self.best: Shot | None = None
        self.value, self.converged = np.inf, False
        self.latest = np.zeros(problem.size)  # the last point of any search

    def run(self, starts: Sequence[Array]) -> Status:
        """Search from the better of some starts (Q,). A deadline or an interrupt leaves the best."""
        problem = self.problem
        with interrupts.grace(np.inf):  # there is always a result
            problem.gamma = 0.0
            misses = [self.offer(z) for z in starts]
            if self.best is None:
                raise Diverged(f"{problem.scene.name}: no motion stays finite; try shorter steps", 0)
            whole = misses[0] if np.isfinite(misses[0]) else min(misses)
        try:
            return self.rounds(max(whole, 1e-300))
        except interrupts.OutOfTime:
            return self.cut(Status.LIMIT)
        except KeyboardInterrupt:
            return self.cut(Status.INTERRUPTED)

    def cut(self, status: Status) -> Status:
        """End early, with the best of all keys, or of those that were searched for so far."""
        self.problem.horizon = self.problem.steps
        with interrupts.grace(np.inf):
            self.again([self.found.z, self.latest])
        if self.file:
            self.file.keep(lambda: {"z": self.found.z}, now=True)
        return status

    def rounds(self, whole: float) -> Status:
        """Searches over more and more keys, then with less and less weight of the effort; `whole`: m², misses at first.
        """
        problem, z = self.problem, self.found.z
        candidates = [z]
        problem.gamma = SHARES[0] * whole
        for step in sorted({key.step for key in problem.keys})[:-1]:
            problem.horizon = step
            z = self.search(z, ROUGH, SLOW)
        candidates, missed, problem.horizon = [*candidates, z], np.inf, problem.steps
        for share in SHARES:
            problem.gamma = share * whole
            self.again(candidates)
            self.search(self.found.z, FINE, SLOW)
            before, missed = missed, self.misses(self.found)
            if (problem.missed(self.found) <= KEY_ERRORS).all() or missed > GAIN * before:
                break
            candidates = [self.found.z]
        return self.insisted(self.ended())

    def again(self, candidates: Sequence[Array]) -> None:
        """Compare by the cost as it is now."""
        self.value = np.inf
        for each in candidates:
            self.offer(each)

    def ended(self) -> Status:
        """A last search from the best point, and how it ended."""
        self.search(self.found.z, FINE, SLOWEST)
        return Status.CONVERGED if self.converged else Status.STALLED

    def insisted(self, status: Status) -> Status:
        """Raise the multipliers of hard keys until they are met or come no nearer."""
        problem, before = self.problem, np.inf
        hard = [i for i, key in enumerate(problem.keys) if key.hard]
        for _ in range(INSISTS if hard else 0):
            left = float(problem.missed(self.found)[hard].max())
            if left <= NEAR_HARD:
                return status
            if left > 0.95 * before:
                return Status.STALLED
            before = left
            for i in hard:
                key = problem.keys[i]
                problem.multipliers[i] = problem.multipliers[i] + left_of(key, self.found.motions[key.cloth].x)
            self.again([self.found.z])
            status = self.ended()
        return status

    @property
    def found(self) -> Shot:
        """The best point."""
        assert self.best is not None
        return self.best

    def optimality(self) -> float:
        """The gradient of the cost at the best point, relative to that without control."""
        problem = self.problem
        shots = self.found, problem.shoot(np.zeros(problem.size))
        last, first = (np.inf if s is None else np.linalg.norm(problem.pull(s, problem.residuals(s))) for s in shots)
        return float(last / first) if first > 0 else 0.0

    def misses(self, shot: Shot) -> float:
        """What the keys add to the cost, m²."""
        gamma, self.problem.gamma = self.problem.gamma, 0.0
        r = self.problem.residuals(shot)
        self.problem.gamma = gamma
        return float(r @ r)

    def note(self, shot: Shot, r: Array) -> float:
        """The cost of a shot with residuals r (N,), m², noting the best."""
        value = float(r @ r)
        if value < self.value:
            interrupts.hold()
            self.best, self.value = shot, value
        return value

    def offer(self, z: Array) -> float:
        """The cost at z (Q,), infinite where the motion diverges, noting the best."""
        shot = self.problem.shoot(z)
        return np.inf if shot is None else self.note(shot, self.problem.residuals(shot))

    def search(self, z: Array, evaluations: int, slow: float) -> Array:
        """Gauss–Newton from z (Q,) until a step lowers the cost by less than the share `slow`; returns the last point.
        Over all keys it notes the best.
        """
        if (known := next(self.known, None)) is not None:
            return self.repeated(known)
        from scipy.optimize import least_squares
        from scipy.sparse.linalg import LinearOperator

        problem = self.problem
        last: dict[str, Any] = {}
        whole = problem.horizon == problem.steps

        def residuals(z: Array) -> Array:
            interrupts.check()
            shot = problem.shoot(z)
            if shot is None:
                return np.full(last["count"], np.inf)
            r = problem.residuals(shot)
            last.update(shot=shot, count=len(r))
            self.latest = shot.z
            if whole:
                self.note(shot, r)
            self.report(0.0, float(problem.missed(shot).max()), problem.evaluations)
            if self.file:
                self.file.keep(lambda: {"ended": self.over})
            return r

        def jacobian(z: Array, *_: Any) -> LinearOperator | Array:
            shot: Shot = last["shot"]  # SciPy asks at the last point where the residuals were finite
            if not np.array_equal(shot.z, z):
                shot = problem.shoot(z) or shot
            if problem.is_small:
                return problem.matrix(shot)

            def product(sweep: Callable[[Shot, Array], Array], vector: Array) -> Array:
                interrupts.check()
                return sweep(shot, vector.reshape(-1))

            push, pull = partial(product, problem.push), partial(product, problem.pull)
            return LinearOperator((last["count"], problem.size), matvec=push, rmatvec=pull, dtype=float)

        solve: Any = least_squares
        found = solve(
            residuals, z, jacobian, method="trf", tr_solver="exact" if problem.is_small else "lsmr",
            max_nfev=evaluations, ftol=slow, xtol=1e-9, gtol=None,
        )  # fmt: skip
        self.converged = found.status > 0
        last_z, best, latest = (np.asarray(each, float).tolist() for each in (found.x, self.found.z, self.latest))
        self.over.append(Ended(last_z, best, latest, self.value, self.converged, problem.evaluations))
        return np.asarray(found.x)

    def repeated(self, known: Ended) -> Array:
        """The last point of a search that is over, after which all is as it was."""
        z, best, self.latest = (np.array(each) for each in known[:3])
        horizon, self.problem.horizon = self.problem.horizon, self.problem.steps
        self.best = self.problem.shoot(best)
        self.problem.horizon = horizon
        self.value, self.converged, self.problem.evaluations = known[3:]
        self.over.append(known)
        return z
