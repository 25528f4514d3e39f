"""Is the gradient right on a user's own scene? The tests of `verify`, aware of what no gradient can describe.

`ladder` compares directional derivative and cost along a random direction. The tangent is compared with its transpose
by the

    dot product   w·(J d) must be (Jᵀ w)·d.

To estimate the rounding in the directional derivative and in the products, they are computed once more with linear
systems solved ten times less accurately, at values that differ in their last digits. Where masses and stiffnesses
differ by more than numbers resolve, that is not all: the condition of the systems bounds what can be known. So does the
rounding of positions, where they are many times what the motions differ by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.derivative.verify import PRODUCT, direction_of
from clothfit.engine.forces.spheres import STIFFNESS
from clothfit.engine.rollout import Rollout
from clothfit.engine.stability import drags
from clothfit.evaluation.ladder import (
    FAILED,
    PASSED,
    RELATIVE_STEPS,
    SMALLEST_FLOAT,
    UNCLEAR,
    Finding,
    Known,
    calm,
    difference,
    judged,
    ladder,
    taylor,
)
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate_cloths
from clothfit.objective.objective import Objective
from clothfit.scene.block import Block
from clothfit.scene.fit_vector import fitted_cloths, parameters, with_parameters
from clothfit.scene.scene import Scene

TRUTH_SPREAD = 0.1
"""Without a target, values that differ by up to this share move as the target, so that the cost is not flat."""

CHECKED_VERTEX_STEPS = 30_000
"""Vertices × steps of a check by default: forty simulations of that size take seconds."""

LOOSER_TOLERANCE = 10.0  # times the tolerance of the linear systems, to estimate rounding

NUDGES = (2.0, -2.0, 5.0)  # last digits by which values are changed to see what rounding does

HALF_OF_THE_DIGITS = float(np.finfo(float).eps ** 0.5)
"""Relative error of a linear system's solution from which on what follows from it, step by step, is not judged."""

LEAST_SQUARED = SMALLEST_FLOAT**0.5
"""Length, m, of which the square is the smallest that doubles hold in full."""


@dataclass(frozen=True)
class SceneCheck:
    """Whether the gradient of a scene's cost is right."""

    scene: str  # its name
    frames: int  # that were compared
    blocks: tuple[Block, ...]  # the values by which the gradient is taken
    flagged: bool  # whether the scene flags them; else all masses and stiffnesses were taken
    tests: tuple[Finding, ...]  # Taylor, difference, dot product
    reach: float  # the longest step, relative to the values, that was short enough; 0: none
    switch: str  # which contact longer steps switch; empty: none is known
    unseen: tuple[str, ...] = ()  # of what the tests show nothing, in words

    @property
    def verdict(self) -> str:
        """Failed if a test failed, passed if Taylor or difference did, which see the cost itself, else unclear."""
        verdicts = [test.verdict for test in self.tests]
        if FAILED in verdicts:
            return FAILED
        return PASSED if PASSED in verdicts[:2] else UNCLEAR

    @property
    def left_out(self) -> str:
        """Which steps were too long, and why; empty where all were short enough."""
        if self.reach == RELATIVE_STEPS[-1]:
            return ""
        why = self.switch or "the cost curves too strongly there"
        if not self.reach:
            return f"the cost has a kink here, within {RELATIVE_STEPS[0]:.1g} of the values: {why}"
        return f"steps above {self.reach:.1g} of the values are left out: {why}"

    @property
    def why(self) -> str:
        """Why the verdict is "unclear"."""
        return self.left_out if not self.reach else next(test.why for test in self.tests if test.verdict == UNCLEAR)


def check_scene(
    scene: Scene,
    target: Motion | None = None,
    frames: int | None = None,
    *,
    seed: int = 0,
    memory: int | str | None = None,
) -> SceneCheck:
    """Check the gradient of a scene's cost at its own values, by what it flags; by all masses and stiffnesses where it
    flags nothing.

    `target` is the motion to compare with (default: that of values up to 10 % off, drawn with `seed`). `frames` is how
    many of the scene's frames to use (default: all, fewer for large cloths). `memory` is that of `Objective`. Raises
    InvalidInput when the target does not fit or shows nothing, Diverged when the scene's own motion diverges.
    """
    flagged, rng = bool(scene.blocks), np.random.default_rng(seed)
    if not flagged:
        scene = replace(scene, cloths=tuple(replace(cloth, settings="LL") for cloth in scene.cloths))
    count = default_frames(scene) if frames is None else frames
    p = parameters(scene)
    if target is None:
        truth = with_parameters(scene, changed(scene, p, rng))
        target = simulate_cloths(truth, fitted_cloths(scene), count)
    objective = Objective(scene, target, frames=count, memory=memory)
    if not objective.shows_motion:
        raise InvalidInput(
            f"{target.name}: shows nothing after the start that can move, within {count} frames, so there is nothing "
            "to check the gradient with; ask for more --steps"
        )
    cost, gradient = objective.cost_and_gradient(p)
    d = direction_of(p, gradient, rng)
    other = objective.until(count, LOOSER_TOLERANCE * objective.tolerance)
    rounding = solved_to(objective)
    derivative = directional_derivative(other, p, d, gradient, rounding + placed_to(objective, cost))
    rungs, noise = ladder(objective, p, d, rounded_to(objective, other, p, cost))
    short = calm(rungs, noise)
    beyond = next((rung.switch for rung in rungs[len(short) :]), "")
    tests = (
        taylor(short, derivative, noise),
        difference(short, derivative, noise),
        product(objective, other, p, d, rng, rounding),
    )
    reach = short[-1].t if short else 0.0
    unseen = () if scene.self_contact is None or touches_itself(objective, p) else ("self-contact",)
    return SceneCheck(scene.name, count, tuple(scene.blocks), flagged, tests, reach, beyond, unseen)


def touches_itself(objective: Objective, p: Array) -> bool:
    """Whether any cloth touches itself in a step of its motion at p (P,)."""
    found: list[bool] = []

    def look(chunk: Rollout) -> None:
        if chunk.touches is not None:
            found.extend(len(touch.numbers) > 0 or touch.zones is not None for touch in chunk.touches)

    for run in objective.runs:
        objective.simulate(run, p, look)
    return any(found)


def default_frames(scene: Scene) -> int:
    """The scene's number of frames, or fewer for large cloths, but at least 6."""
    count = sum(len(scene.cloths[i].mass) for i in fitted_cloths(scene)) or 1
    return min(scene.frames, max(6, CHECKED_VERTEX_STEPS // count + 1))


def changed(scene: Scene, p: Array, rng: np.random.Generator) -> Array:
    """Values (P,) that differ from p by up to a share `TRUTH_SPREAD`; zeros become that share of their typical size."""
    other = p * rng.uniform(1 - TRUTH_SPREAD, 1 + TRUTH_SPREAD, p.shape)
    for block in scene.blocks:
        nothing = (p[block.part] == 0.0) & (not block.kind.log)
        other[block.part][nothing] = TRUTH_SPREAD * block.kind.scale
    return np.asarray(other)


def solved_to(objective: Objective) -> float:
    """Relative error that rounding can make in solutions of the linear systems: ε times a bound of their condition, the
    largest of (1 + h α) m, (h² + h β) k, h κ |n|² of the air's drag and h² κ of contacts (`forces`) over the smallest
    mass above 0.
    """
    worst = 1.0
    for run in objective.runs:
        system, h = run.system, run.system.h
        mass = system.vertex.mass[system.vertex.free]
        inert = (1.0 + h * system.vertex.damping) * mass.max(initial=0.0)
        stiff = (h + system.springs.damping) * h * system.springs.stiffness.max(initial=0.0)
        air = h * drags(system).max(initial=0.0)
        touching = h * h * STIFFNESS if len(system.spheres.radius) else 0.0
        worst = max(worst, max(inert, stiff, air, touching) / mass.min(where=mass > 0, initial=np.inf))
    return float(np.finfo(float).eps * worst)


def placed_to(objective: Objective, cost: float) -> float:
    """Relative error that the rounding of positions can make in a derivative of that cost: ε times the largest
    coordinate over the root mean square of the distances; 0 where there are none.
    """
    error = objective.rmse(cost)
    largest = max((float(np.abs(run.system.x0).max(initial=0.0)) for run in objective.runs), default=0.0)
    return float(np.finfo(float).eps * largest / error) if error > 0 else 0.0


def rounded_to(objective: Objective, other: Objective, p: Array, cost: float) -> float:
    """Error, m², that a cost has at least: by the rounding of positions, by the tolerance of the linear systems, which
    is larger in `other`, and where squares are too small for numbers.
    """
    solved = abs(other.cost(p) - cost) / LOOSER_TOLERANCE
    return float(max(LEAST_SQUARED, 2.0 * placed_to(objective, cost) * cost, solved))


def directional_derivative(other: Objective, p: Array, d: Array, gradient: Array, rounding: float) -> Known:
    """g·d, m², with its rounding."""
    value = float(gradient @ d)
    return Known(value, abs(float(other.cost_and_gradient(nudged(p))[1] @ d) - value) + rounding * abs(value))


def product(
    objective: Objective, other: Objective, p: Array, d: Array, rng: np.random.Generator, rounding: float
) -> Finding:
    """Compare w·(J d) with (Jᵀ w)·d; w has the signs of J d, so that nothing cancels."""
    changes = objective.tangent(p, d)
    weights = [np.copysign(np.abs(rng.normal(size=change.shape)), change) for change in changes]

    def both(objective: Objective, p: Array, changes: list[Array]) -> Array:
        forward = sum(float(np.vdot(w, change)) for w, change in zip(weights, changes, strict=True))
        return np.array([forward, objective.pullback(p, weights) @ d])

    found = both(objective, p, changes)
    varied = [both(other, near, other.tangent(near, d)) for near in (nudged(p, by) for by in NUDGES)]
    size = max(float(np.abs(found).max()), SMALLEST_FLOAT)
    farthest = max((float(np.abs(change).max(initial=0.0)) for change in changes), default=0.0)
    lost = LEAST_SQUARED / max(farthest, SMALLEST_FLOAT)  # solvers sum squares
    spread = max(float(np.abs(each - found).sum()) for each in varied)  # a single one may be small by chance
    blur = spread / size + rounding + lost if rounding < HALF_OF_THE_DIGITS else np.inf
    return judged("dot product", blur, float(abs(found[1] - found[0])) / size, PRODUCT)


def nudged(p: Array, by: float = 2.0) -> Array:
    """p, changed in its last digits, `by` so many."""
    return np.asarray(p * (1.0 + by * np.finfo(float).eps))
