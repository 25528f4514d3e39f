"""The cost of a scene's parameters against target motions, with its exact gradient and the tangent of the motion.

One scene, one target is the common case. With several experiments, each a target and the scene it was recorded in, the
costs add up: the same parameters must explain all of them. Only the cloths that have parameters are simulated. The
errors of the linear systems enter the gradient directly: solved to 1e-10, as in a fit, it agrees with the derivative of
the cost to about 1e-8; to 1e-14, as far as rounding allows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from functools import cached_property, partial
from typing import Any, TypeAlias

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import checked_tolerance
from clothfit.base.memory import budget
from clothfit.derivative import adjoint
from clothfit.derivative.adjoint import CostDerivative, Observer, TrajectoryMemory
from clothfit.engine.fallbacks import NO_FALLBACKS, Fallbacks
from clothfit.engine.prescribed import Forms, forms_from, forms_of
from clothfit.engine.rollout import Rollout
from clothfit.engine.system import System, build
from clothfit.engine.tape import Plan, Tape
from clothfit.motion.degrade import rounding
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import in_groups, in_world
from clothfit.objective import memory_needs as storage
from clothfit.objective.comparison import OWN, Comparison, loss_named, objective_weights
from clothfit.objective.experiment import Experiment, Targets, experiments
from clothfit.objective.identifiability import identifiable
from clothfit.objective.measures import Cloud, surface_of
from clothfit.objective.memory_needs import Needs
from clothfit.objective.own_cost import OwnComparison, OwnCost, Whole, unseen
from clothfit.objective.run import Recent, Run, at_rest, cost_at_rest, seen_in
from clothfit.objective.running_cost import KeptStates, running_cost
from clothfit.objective.target import first_step, target, without_start
from clothfit.scene.block import Block
from clothfit.scene.fit_vector import changes, check_shape, extra_kinds, fitted_cloths, parameters
from clothfit.scene.kinds import REST
from clothfit.scene.scene import Scene, check_is_scene

TIGHT = 1e-14
"""Default tolerance of the linear systems, relative: their errors enter the gradient directly."""

NEGLIGIBLE_BYTES = 64_000_000
"""Bytes of matrices that are always allowed: the libraries of the program take as much."""


Compared: TypeAlias = str | Mapping[str, float] | OwnCost
"""What is compared: one objective by its name, several with their weights, or a cost of one's own."""


class Objective:
    """The cost G(p) of one scene against one or more targets, with its gradient; prepared once, for many p (P,)."""

    def __init__(
        self,
        scene: Scene,
        motion: Targets | None,
        tolerance: float | None = None,
        frames: int | Sequence[int | None] | None = None,
        *,
        objective: Compared = "position",
        loss: str = "linear",
        loss_scale: float | None = None,
        memory: int | str | None = None,
    ) -> None:
        """The arguments are those that the public `differentiable.Objective` explains; without a `motion` only a cost
        of one's own (`own_cost`) can be compared. Raises InvalidMotion, InvalidInput.
        """
        check_is_scene(scene)
        self.scene = scene
        self.memory = budget(memory)
        self.tolerance = checked_tolerance(tolerance, TIGHT)
        self.blocks = scene.blocks
        self.objects = fitted_cloths(scene)
        self.cloths = sorted({scene.together(cloth)[0] for cloth in self.objects})  # one of each group
        self.own = objective if callable(objective) else None
        self.weights = {OWN: 1.0} if callable(objective) else objective_weights(objective)
        self.loss = loss_named(loss, loss_scale)
        if self.own and not self.loss.is_linear:
            raise InvalidInput("loss: a cost of one's own has its own; leave this out")
        self.experiments = experiments(scene, unseen(scene) if motion is None else motion)
        self.wholes: dict[int, Whole] = {}  # of each target, where the cost is one's own
        self._ends = list(frames) if isinstance(frames, Sequence) else [frames] * len(self.experiments)
        self.runs = tuple(
            self._run(number, experiment, cloth, end)
            for number, (experiment, end) in enumerate(zip(self.experiments, self._ends, strict=True))
            for cloth in self.cloths
        )
        self._recent = Recent(self.runs, self.tolerance, self.memory)

    def _run(self, number: int, experiment: Experiment, cloth: int, frames: int | None) -> Run:
        motion, scene = experiment
        there = in_groups(in_world(motion, scene), scene)
        goal = target(there, cloth, scene.delta, None if frames is None else frames - 1)
        shifted = scene.cloths[cloth].mode("shift") != "n"  # of a cloth that touches no other
        surface = surface_of(there, cloth)
        surface = surface and surface.within(goal, start=not shifted and scene.method != REST)
        if shifted:
            goal = without_start(goal, np.concatenate([pin.vertices for pin in scene.cloths[cloth].pins]))
        if scene.method == REST:  # of which every frame is the same
            goal = without_start(goal, np.arange(goal.observed.shape[1], dtype=np.int32))
        system = build(scene, cloth, steps=goal.last_step)
        if self.own:
            if scene.frame:
                raise InvalidInput(f"{scene.name}: frame: a cost of one's own needs axes that do not move")
            whole = self.wholes.setdefault(number, Whole(self.own, scene, motion, goal, self.cloths))
            return Run(cloth, scene, system, OwnComparison(whole, goal, cloth), number)
        compared = Comparison(goal, system, self.weights, self.loss, motion.name, surface)
        return Run(cloth, scene, system, compared, number)

    def blocks_of(self, cloth: int) -> list[Block]:
        """The blocks of a cloth and of those that are simulated with it."""
        return [block for block in self.blocks if block.cloth in self.scene.together(cloth)]

    def until(self, frames: int | Sequence[int], tolerance: float | None = None) -> Objective:
        """The same objective over the first `frames` frames, one number for all targets or one for each, solved to
        another tolerance.
        """
        wanted = frames if isinstance(frames, Sequence) else [frames] * len(self._ends)
        shorter = [first if end is None else min(first, end) for first, end in zip(wanted, self._ends, strict=True)]
        return self.against(self.scene, self.experiments, shorter, tolerance)

    def flagging(self, scene: Scene, tolerance: float | None = None) -> Objective:
        """The same objective for a `scene` with other values and flags, solved to another tolerance."""
        pairs = [Experiment(motion, scene if own is self.scene else own) for motion, own in self.experiments]
        return self.against(scene, pairs, self._ends, tolerance)

    def in_scenes(self, given: Sequence[Experiment], tolerance: float | None = None) -> Objective:
        """The same objective in other scenes of its experiments, solved to another tolerance."""
        return self.against(self.scene, given, self._ends, tolerance)

    def with_forms(self, forms: Sequence[Forms]) -> Objective:
        """The same objective of motions whose steps have these forms, of each run."""
        other = copy(self)
        other.runs = tuple(run._replace(forms=own) for run, own in zip(self.runs, forms, strict=True))
        other._recent = Recent(other.runs, other.tolerance, other.memory)
        return other

    def forms(self, p: Array) -> list[Forms]:
        """The forms that the steps of the motions of p (P,) take. Raises Diverged."""
        return [forms_of(self.simulate(run, p)[1].forward()) for run in self.runs]

    def forms_along(self, other: Objective, p: Array) -> list[Forms]:
        """The forms that steps take from the states of the motions of p (P,) by another objective. Raises Diverged."""
        return [
            forms_from(run.changed(p), other.simulate(its, p)[1].forward(), self.tolerance)
            for run, its in zip(self.runs, other.runs, strict=True)
        ]

    def against(
        self, scene: Scene, given: Sequence[Experiment], frames: int | Sequence[int | None] | None,
        tolerance: float | None = None,
    ) -> Objective:  # fmt: skip
        """The same objective for other experiments of a `scene`, over so many frames of each."""
        scale = None if self.loss.is_linear else self.loss.scale
        return Objective(
            scene, list(given), tolerance or self.tolerance, frames,
            objective=self.own or self.weights, loss=self.loss.name, loss_scale=scale, memory=self.memory,
        )  # fmt: skip

    @cached_property
    def cost_at_rest(self) -> float:
        """G of cloths that do not move."""
        return sum(cost_at_rest(run) for run in self.runs)

    @cached_property
    def rms_displacement(self) -> float:
        """Root mean square distance, m, of the observed positions from where their cloths start."""
        return self.distance(at_rest)

    def distance(self, show: Callable[[Run, Observer], object]) -> float:
        """Root mean square distance of the observed positions, m, in motions that `show` shows to an observer."""
        squares = 0.0
        for run in self.runs:
            goal = run.comparison.goal._replace(weights=np.zeros((0, 0)))  # each counts once
            distances = running_cost(Comparison(goal, run.system, surface=run.comparison.surface))
            show(run, distances.update)
            squares += distances.value
        return float(np.sqrt(squares / max(self.observations, 1)))

    @cached_property
    def rounding(self) -> float:
        """Error, m, that the rounding of the targets' numbers alone may leave (`motion.rounding`); 0 where other things
        than positions are compared.
        """
        if list(self.weights) != ["position"]:
            return 0.0
        squares = [rounding(self.experiments[run.experiment].motion) ** 2 for run in self.runs]
        weights = [run.comparison.total_weight for run in self.runs]
        return float(np.sqrt(np.dot(squares, weights) / (sum(weights) or 1.0)))

    @cached_property
    def needs(self) -> Needs:
        """The memory that a gradient takes. Raises InvalidInput when `memory` is too little."""
        return storage.needs(self.runs, [experiment.motion for experiment in self.experiments], self.memory)

    @property
    def room(self) -> float:
        """Bytes that the matrices of a method may take beside the targets."""
        return max(storage.COUNTED * self.memory - self.needs.held, NEGLIGIBLE_BYTES)

    @property
    def first_step(self) -> int:
        """The first step after the start at which, or before which, anything is observed; 0 where nothing is."""
        return first_step((run.comparison.goal, run.comparison.observed) for run in self.runs)

    @property
    def steps(self) -> int:
        """Number of simulated steps of the longest target."""
        return max((run.steps for run in self.runs), default=0)

    @property
    def plain(self) -> bool:
        """Whether G is the sum of squared distances, in m², and nothing else."""
        return all(run.comparison.plain for run in self.runs)

    @property
    def scanned(self) -> bool:
        """Whether a target is a scan, whose vertices are known as a cloth was drawn to it, and no better."""
        return any(isinstance(run.comparison.surface, Cloud) for run in self.runs)

    @property
    def observations(self) -> int:
        """Number of vertex positions that are compared."""
        return sum(int(run.comparison.observed.sum()) for run in self.runs)

    @property
    def frames(self) -> int:
        """Number of frames that are compared, of all targets together."""
        # all cloths of an experiment have the same frames
        return sum({run.experiment: len(run.comparison.goal.step) for run in self.runs}.values())

    @property
    def shows_motion(self) -> bool:
        """Whether anything that can move is compared after the initial state; true where nothing can move."""
        fixed = [(~run.system.vertex.free, run.comparison.seen) for run in self.runs]
        return any((seen & ~held).any() or held.all() for held, seen in fixed)

    @cached_property
    def identifiable(self) -> Flags:
        """Which values of the fit vector (P,) at least one of the targets can reveal."""
        revealed = [
            identifiable(experiment.scene, seen_in(run for run in self.runs if run.experiment == number))
            for number, experiment in enumerate(self.experiments)
        ]
        return np.asarray(np.any(revealed, axis=0))

    def rmse(self, cost: float) -> float:
        """Root mean square distance, m, of a cost, m²; for other objectives in the unit of what they compare."""
        return float(np.sqrt(cost / (sum(run.comparison.total_weight for run in self.runs) or 1.0)))

    def position_rmse(self, p: Array) -> float:
        """Root mean square distance of the observed positions at p (P,), m, for any objective; NaN where nothing is
        observed. Raises Diverged.
        """
        return self.distance(lambda run, observe: self.simulate(run, p, observe)) if self.observations else np.nan

    def cost(self, p: Array, cloth: int | None = None) -> float:
        """G(p), m², for p (P,), or the part of one fitted cloth and of those that are simulated with it, where no cost
        joins them. Raises Diverged.
        """
        if self.joint:
            self.place(p)
            return sum(whole.evaluated()[0] for whole in self.wholes.values())
        costs = list[float]()
        for run in (run for run in self.runs if cloth is None or cloth in self.scene.together(run.cloth)):
            cost = running_cost(run.comparison)
            self.simulate(run, p, cost.update)
            costs.append(cost.value)
        return sum(costs)

    def cost_or_infinity(self, p: Array, cloth: int | None = None) -> float:
        """The same; infinite where the simulation diverges or the cost overflows."""
        try:
            value = self.cost(p, cloth)
        except Diverged:
            return np.inf
        return value if np.isfinite(value) else np.inf

    def cost_and_gradient(self, p: Array) -> tuple[float, Array]:
        """G(p), m², and its exact gradient ∂G/∂p (P,). Raises Diverged."""
        total, gradient = 0.0, np.zeros(len(check_shape(self.scene, p)))
        if self.joint:
            self.place(p)
        for run in self.runs:
            cost = running_cost(run.comparison)
            system, tape = self.simulate(run, p, cost.update, plan=self.plan(run))
            total += cost.value
            self.add_pullback(run, p, system, tape, cost.derivative, gradient)
        if not np.isfinite(gradient).all():
            raise Diverged(f"{self.scene.name}: the gradient overflows", 0)
        return total, gradient

    @property
    def joint(self) -> bool:
        """Whether the cost joins several objects that are fitted."""
        return self.own is not None and len(self.cloths) > 1

    def place(self, p: Array) -> None:
        """Put all objects of a cost of one's own where p (P,) takes them. Raises Diverged."""
        for run in self.runs:
            kept = KeptStates(run.comparison)
            self.simulate(run, p, kept.update)
            self.wholes[run.experiment].place(run.cloth, kept.states)

    def begin_at(self, p: Array) -> None:
        """Let searches for shapes at rest begin at that of p (P,) from now on."""
        for run in self.runs:
            self._recent.begin_at(run, p)

    def positions(self, p: Array) -> list[Array]:
        """The positions (T + 1, n, 3), m, of each run at p (P,), after every step. Raises Diverged."""
        found = []
        for run in self.runs:
            x = np.tile(run.system.x0, (run.steps + 1, 1, 1))
            self.simulate(run, p, partial(keep, x))
            found.append(run.axes.own(x) if run.axes else x)
        return found

    def tangent(self, p: Array, direction: Array) -> list[Array]:
        """Change of the positions (T + 1, n, 3) of each run along `direction` (P,) from p. Raises Diverged."""
        found = []
        for run in self.runs:
            system, tape = self.simulate(run, p)
            along = changes(run.scene, run.cloth, p, direction)
            change = adjoint.tangent(system, tape, along, self.tolerance)
            found.append(run.axes.directions(change) if run.axes else change)
        return found

    def pullback(self, p: Array, by_position: Sequence[Array]) -> Array:
        """The transpose of `tangent` at p: (P,) from one weight (T + 1, n, 3) per run. Raises Diverged."""
        gradient = np.zeros(len(check_shape(self.scene, p)))
        for run, weight in zip(self.runs, by_position, strict=True):
            own = run.axes.world_directions(weight) if run.axes else weight
            self.add_pullback(run, p, *self.simulate(run, p, plan=self.plan(run)), own, gradient)
        return gradient

    def add_pullback(
        self, run: Run, p: Array, system: System, memory: TrajectoryMemory, by_position: Array | CostDerivative,
        gradient: Array, tolerance: float | None = None,
    ) -> None:  # fmt: skip
        """Add to `gradient` (P,) that of a cost with ∂G/∂x = by_position (T + 1, n, 3), along the finished motion of p
        (P,), its linear systems solved to a `tolerance`, relative; None: that of the motion.
        """
        solved = self.tolerance if tolerance is None else tolerance
        grad = adjoint.gradient(system, memory, by_position, solved, extra_kinds(self.scene, run.cloth))
        for block, part in run.acting:
            gradient[block.part] += block.reduce(getattr(grad, block.name)[part], p)

    def remedies(self, p: Array) -> Fallbacks:
        """Which fallbacks the steps of the motions of p (P,) need. Raises Diverged."""
        found = NO_FALLBACKS
        for run in self.runs:
            found = found.together(self._recent.fallbacks(run, p))
        return found

    def plan(self, run: Run) -> Plan:
        """Which states of a run are kept for the way back. Raises InvalidInput where no plan is small enough."""
        return self.needs.plans[run.system.x0.shape, run.steps]

    def remembers(self, p: Array) -> bool:
        """Whether the motions of p (P,) are known, so that its cost takes no time."""
        return all(self._recent.has(run, p) for run in self.runs)

    def simulate(self, run: Run, p: Array, *observers: Observer, plan: Plan | None = None) -> tuple[System, Tape]:
        """Simulate a run with parameters p (P,), as far as it is compared, and show the motion to the observers.

        With a `plan` the motion can be swept back. Raises Diverged.
        """
        return self._recent.simulate(run, p, observers, plan)


def keep(x: Array, chunk: Rollout) -> None:
    """Copy the states after the steps of a chunk into those of the whole motion (T + 1, n, 3)."""
    x[chunk.first + 1 : chunk.first + 1 + chunk.steps] = chunk.x[1:]


def cost_and_gradient(
    scene: Scene, motion: Targets, tolerance: float | None = None, **options: Any
) -> tuple[float, Array]:
    """The cost G of a scene against `motion`, m², and its exact gradient (P,) by the scene's flagged values.

    `motion`, `tolerance` and the options objective, loss, loss_scale and memory are those of `Objective`; the entries
    of the gradient are in the order of `parameters`. Raises InvalidMotion when the motion does not fit the scene,
    InvalidInput for other arguments, Diverged when the simulation does not stay finite.
    """
    return Objective(scene, motion, tolerance, **options).cost_and_gradient(parameters(scene))
