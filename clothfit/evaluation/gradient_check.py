"""Is the gradient right on a user's own scene? The tests of `verify`, aware of what no gradient can describe.

The cost G(p ± t d) along a random direction d, for t from 1e-7 up to 1e-1, has an even and an odd part,

    S(t) = G(p + t d) + G(p − t d) − 2 G(p),      D(t) = [G(p + t d) − G(p − t d)] / 2t.

S does not depend on the gradient g: it falls as t² where the cost is smooth on that scale, as t across a kink, and not
at all across a jump. A contact that switches makes both (below); over long steps of a chaotic motion S follows no
power. So g is judged only by steps that are short enough: those with the contacts of p on both sides wherever forces
are evaluated, which lie on one smooth piece of the cost, and over which S falls as t². There

    Taylor        S/2 + t |D − g·d| must fall as t² as well,
    difference    D must be g·d.

The tangent is compared with its transpose by the

    dot product   w·(J d) must be (Jᵀ w)·d.

To estimate the rounding in the directional derivative and in the products, they are computed once more with linear
systems solved ten times less accurately, at values that differ in their last digits. Where masses and stiffnesses
differ by more than numbers resolve, that is not all: the condition of the systems bounds what can be known. So does the
rounding of positions, where they are many times what the motions differ by. A test is unclear, neither passed nor
failed, where rounding leaves too little.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput
from clothfit.derivative.verify import ABOVE_NOISE, DIFFERENCE, FEWEST_STEPS, NOISE_STEPS, ORDER, PRODUCT, direction_of
from clothfit.engine.forces import collider_rows
from clothfit.engine.forces.collider_rows import MANY, SPREAD
from clothfit.engine.forces.selfcontact import pairs, rows
from clothfit.engine.forces.spheres import STIFFNESS
from clothfit.engine.inputs.tables import set_inputs
from clothfit.engine.rollout import Rollout
from clothfit.engine.stability import drags
from clothfit.engine.system import BDF2, System, meets_itself
from clothfit.engine.tape import Tape
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate_cloths
from clothfit.objective.objective import Objective
from clothfit.objective.run import Run, check_complete
from clothfit.objective.running_cost import running_cost
from clothfit.scene.block import Block
from clothfit.scene.fit_vector import fitted_cloths, parameters, with_parameters
from clothfit.scene.scene import Scene

Parts = NDArray[np.int32]

RELATIVE_STEPS = tuple(10.0 ** (-k / 2) for k in range(14, 1, -1))
"""Steps, relative to p, from short to long; half as far apart as in `verify`, as kinks may leave few usable ones."""

ORDER_SLACK = 0.1
"""The order at which S falls may differ from 2 by this much, due to rounding at `ABOVE_NOISE`."""

BEYOND_ROUNDING = 10.0
"""A difference this many times larger than the rounding is not due to rounding."""

SMALLEST_FLOAT = float(np.finfo(float).tiny)

PASSED, FAILED, UNCLEAR = "passed", "failed", "unclear"


class Finding(NamedTuple):
    """The outcome of one test."""

    name: str  # "Taylor", "difference" or "dot product"
    measured: float | None  # the order, or a relative error; None where rounding left nothing to measure
    bar: float  # that it must be above (Taylor) or below
    verdict: str  # "passed", "failed" or "unclear"
    why: str = ""  # it is unclear


class Known(NamedTuple):
    """A number and its uncertainty by rounding."""

    value: float
    blur: float


class TaylorStep(NamedTuple):
    """The cost on both sides of p, at a distance t."""

    t: float
    even: float  # S
    odd: float  # t D
    switch: str  # the first contact that differs from p, as text; empty: none


def cost_and_contacts(objective: Objective, p: Array) -> tuple[float, list[Parts]]:
    """G(p), m², and the contacts of each run. Raises Diverged."""
    total, switches = 0.0, []
    for run in objective.runs:
        system, cost, seen = run.changed(p), running_cost(run.comparison), []
        tape = Tape(system, run.steps, objective.tolerance)
        for part in tape.forward():
            cost.update(part)
            seen.append(contacts(system, part))
        check_complete(run, tape.good)
        total += cost.value
        switches.append(np.concatenate(seen))
    return total, switches


def taylor_steps(
    objective: Objective, p: Array, d: Array, least: float, start: float, own: list[Parts]
) -> tuple[list[TaylorStep], float]:
    """All steps, from short to long, and the rounding error of the cost, m², at the `least` so much; `start` and `own`
    are `cost_and_contacts` at p.
    """

    def step(t: float) -> TaylorStep:
        costs, switch = [], ""
        for sign in (1.0, -1.0):
            try:
                cost, switches = cost_and_contacts(objective, p + sign * t * d)
            except Diverged as error:
                return TaylorStep(t, np.inf, np.inf, str(error))
            costs.append(cost)
            switch = switch or difference_of(objective.runs, own, switches)
        return TaylorStep(t, costs[0] + costs[1] - 2.0 * start, 0.5 * (costs[0] - costs[1]), switch)

    noise = max(least, np.finfo(float).eps * abs(start), *(abs(step(t).even) for t in NOISE_STEPS))
    return [step(t) for t in RELATIVE_STEPS], float(noise)


def difference_of(runs: tuple[Run, ...], a: list[Parts], b: list[Parts]) -> str:
    """Where the contacts of the runs first differ, as text; empty where they do not."""
    for run, one, other in zip(runs, a, b, strict=True):
        found = first_switch(one, other)
        if found is not None:
            cloth, vertex = run.scene.place_of(run.cloth, found.vertex)
            where = found._replace(vertex=vertex).at(name_of(run.scene, found.obstacle))
            return f"contacts switch (objects[{cloth}] {where})"
    return ""


def calm(steps: list[TaylorStep], noise: float) -> list[TaylorStep]:
    """The steps, from the shortest, before a contact switches or S, above rounding, does not fall as t²."""
    floor = max(ABOVE_NOISE * noise, SMALLEST_FLOAT)
    found: list[TaylorStep] = []
    for step in steps:
        if step.switch or not np.isfinite(step.even):
            break
        if found and abs(step.even) > floor:
            before = abs(found[-1].even)
            order = np.log(abs(step.even) / max(before, floor)) / np.log(step.t / found[-1].t)
            if order > 2.0 + ORDER_SLACK or (before > floor and order < 2.0 - ORDER_SLACK):
                break
        found.append(step)
    return found


def taylor(steps: list[TaylorStep], derivative: Known, noise: float) -> Finding:
    """Measure the lowest order at which the remainder of the first-order expansion falls."""
    known = []
    for step in steps:
        remainder = 0.5 * abs(step.even) + abs(step.odd - step.t * derivative.value)
        if remainder > ABOVE_NOISE * (noise + step.t * derivative.blur):
            known.append((step.t, remainder))
    if len(known) < FEWEST_STEPS:
        usable = f"{len(known)} of {len(RELATIVE_STEPS)} steps"
        why = f"{usable} are short enough and above rounding, {FEWEST_STEPS} are needed"
        return Finding("Taylor", None, ORDER, UNCLEAR, why)
    order = min(float(np.log(s / r) / np.log(u / t)) for (t, r), (u, s) in pairwise(known))
    return Finding("Taylor", order, ORDER, PASSED if order > ORDER else FAILED)


def difference(steps: list[TaylorStep], derivative: Known, noise: float) -> Finding:
    """Measure the relative difference between the derivative and D, at the step where D is most accurate."""
    known = []
    for shorter, longer in pairwise(steps):
        D = longer.odd / longer.t
        size = max(abs(D), abs(derivative.value), SMALLEST_FLOAT)
        blur = noise / longer.t + abs(D - shorter.odd / shorter.t) + derivative.blur
        known.append((blur / size, abs(D - derivative.value) / size))
    if not known:
        return Finding("difference", None, DIFFERENCE, UNCLEAR, "no two steps are short enough")
    if derivative.value == 0.0 and not any(step.odd for step in steps):
        return Finding("difference", None, DIFFERENCE, UNCLEAR, "nothing that is checked changes the cost")
    return judged("difference", *min(known), DIFFERENCE)


def judged(name: str, blur: float, measured: float, bar: float) -> Finding:
    """Judge a relative difference with uncertainty `blur`; NaN where that overflows."""
    blur = np.inf if np.isnan(blur) else blur
    if measured < bar and blur < BEYOND_ROUNDING * DIFFERENCE:
        return Finding(name, measured, bar, PASSED)
    if measured > max(bar, BEYOND_ROUNDING * blur):
        return Finding(name, measured, bar, FAILED)
    return Finding(name, measured, bar, UNCLEAR, f"known to {blur:.1g} only")


TRUTH_SPREAD = 0.1
"""Without a target, values that differ by up to this share move as the target, so that the cost is not flat."""

CHECKED_VERTEX_STEPS = 30_000
"""Vertices × steps of a check by default: forty simulations of that size take seconds."""

LOOSE_TOLERANCE = 10.0  # times the tolerance of the linear systems, to estimate rounding

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
    other = objective.until(count, LOOSE_TOLERANCE * objective.tolerance)
    rounding, placed, value = solved_to(objective), placed_to(objective, cost), float(gradient @ d)
    apart = abs(float(other.cost_and_gradient(shifted(p))[1] @ d) - value)
    derivative = Known(value, apart + (rounding + placed) * abs(value))
    # what a cost is not known to: positions are rounded, systems solved to a tolerance, squares too small for numbers
    solved = abs(other.cost(p) - cost) / LOOSE_TOLERANCE
    start, own = cost_and_contacts(objective, p)
    steps, noise = taylor_steps(objective, p, d, float(max(LEAST_SQUARED, 2.0 * placed * cost, solved)), start, own)
    short = calm(steps, noise)
    beyond = next((step.switch for step in steps[len(short) :]), "")
    tests = (
        taylor(short, derivative, noise),
        difference(short, derivative, noise),
        product(objective, other, p, d, rng, rounding),
    )
    reach = short[-1].t if short else 0.0
    acts = any(each[:, :, scene.obstacles :].any() for each in own)
    unseen = () if scene.self_contact is None or acts else ("self-contact",)
    return SceneCheck(scene.name, count, tuple(scene.blocks), flagged, tests, reach, beyond, unseen)


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
        inert = (1.0 + h * system.vertex.damping.max()) * mass.max(initial=0.0)
        stiff = (h + system.springs.damping.max()) * h * system.springs.stiffness.max(initial=0.0)
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
    varied = [both(other, near, other.tangent(near, d)) for near in (shifted(p, by) for by in NUDGES)]
    size = max(float(np.abs(found).max()), SMALLEST_FLOAT)
    farthest = max((float(np.abs(change).max(initial=0.0)) for change in changes), default=0.0)
    lost = LEAST_SQUARED / max(farthest, SMALLEST_FLOAT)  # solvers sum squares
    spread = max(float(np.abs(each - found).sum()) for each in varied)  # a single one may be small by chance
    blur = spread / size + rounding + lost if rounding < HALF_OF_THE_DIGITS else np.inf
    return judged("dot product", blur, float(abs(found[1] - found[0])) / size, PRODUCT)


def shifted(p: Array, by: float = 2.0) -> Array:
    """p, changed in its last digits, `by` so many."""
    return np.asarray(p * (1.0 + by * np.finfo(float).eps))


# ---- Contacts that switch: which vertex is at which part of which obstacle, at the forces of each step.
#
# Where a vertex enters or leaves an obstacle, the matrix of the step jumps. Where it passes from one part of a
# surface to another, from a face of a box or a mesh over its edge, from the mantle of a capsule to its end, the
# normal goes on and its derivative jumps. At both the cost has derivatives from two sides. So a part is a number, 0
# outside, and two motions with the same numbers lie on one smooth piece of the cost. A cloth that touches itself is
# one more obstacle; its numbers stand for the pairs that a vertex is in, and the parts of triangles and edges that
# are nearest there.

class Switch(NamedTuple):
    """The first difference between two motions of a cloth."""

    step: int  # counted from 1
    vertex: int
    obstacle: int  # counted from 0: the spheres, then the colliders
    within: bool = False  # whether both motions touch it, at different parts

    def at(self, obstacle: str) -> str:
        """The sentence, with a name for the obstacle."""
        where = f"two parts of {obstacle}" if self.within else obstacle
        return f"vertex {self.vertex} at {where}, step {self.step}"


def name_of(scene: Scene, obstacle: int) -> str:
    """What a switch calls an obstacle of a scene."""
    if obstacle < len(scene.spheres):
        return f"sphere {obstacle}"
    if obstacle == scene.obstacles:
        return "the cloth itself"
    each = scene.colliders[obstacle - len(scene.spheres)]
    return f"the {each.name} colliders[{each.place}]"


def contacts(system: System, part: Rollout) -> Parts:
    """At which parts of C obstacles n vertices are (T, N, C, n), at the forces of T steps of N iterations."""
    steps, iterations, n = part.w.shape[:3]
    count = len(system.spheres.radius) + (0 if system.colliders is None else len(system.colliders.rows))
    count += meets_itself(system)
    found = np.zeros((steps, iterations, count, n), np.int32)
    if not found.size:
        return found
    for t in range(steps):
        set_inputs(system.inputs, system, part.first + t)
        for k in range(int(part.used[t])):
            y = linearised_at(system, part, t, k)
            others = touched(system, y, None if part.active is None else part.active[t, k])
            found[t, k, : len(others)] = others
            if system.surface and meets_itself(system):
                own = part.active_pairs[t]
                numbers = own.numbers if own.on is None else own.numbers[own.on[k]]
                found[t, k, -1] = touched_by_itself(system.surface, part.x[t], numbers, y)
                if own.zones is not None:
                    found[t, k, -1, own.zones.member] += 1
    return found


def linearised_at(system: System, part: Rollout, t: int, k: int) -> Array:
    """The positions (n, 3), m, that iteration k of step t takes its forces at, but for those of moving colliders."""
    x, h = part.x[t], system.h
    if system.method == BDF2 and not part.euler[t]:
        v, (x_before, v_before) = part.velocity(t), (part.x_before, part.v_before)
        if t:
            x_before, v_before = part.x[t - 1], part.velocity(t - 1)
        x, h = x + (x - x_before) / 3.0, 2.0 / 3.0 * h
        return np.asarray(x + h * (2.0 * v - v_before if k == 0 else part.w[t, k - 1]))
    return np.asarray(x if k == 0 else x + h * part.w[t, k - 1])


def touched(system: System, y: Array, active: Flags | None) -> Parts:
    """At which parts of C obstacles points y (n, 3) are, (C, n), where the obstacles are now, those that are `active`
    outside of them included.
    """
    gaps = np.linalg.norm(y - system.spheres.centre[:, None], axis=2) - system.spheres.radius[:, None]
    plain: Parts = (gaps < 0).astype(np.int32)
    if system.colliders is None or active is None:
        return plain
    deep = collider_rows.depths(system.colliders, y)[0]
    inside = active.reshape(deep.shape) | (deep > 0)
    places = np.empty(deep.shape, np.int32)
    collider_rows.fill_parts(system.colliders, y, places)
    return np.concatenate([plain, np.where(inside, 1 + places, 0)], dtype=np.int32)


def touched_by_itself(surface: pairs.Surface, x: Array, numbers: Indices, y: Array) -> Parts:
    """A number (n,) for what each vertex of a cloth touches of it at y, in a step from x, (n, 3) each."""
    contact = pairs.of_numbers(surface, x, numbers)
    place = np.zeros(len(numbers), np.int32)
    rows.find_parts(contact, y, place)
    total = np.zeros(len(x), np.int64)
    np.add.at(total, contact.vertices.ravel(), np.repeat(1 + (SPREAD * numbers + place) % MANY, 4))
    return np.asarray(np.where(total > 0, 1 + total % MANY, 0), np.int32)


def first_switch(a: Parts, b: Parts) -> Switch | None:
    """The first difference between the contacts of two motions; None where there is none."""
    if np.array_equal(a, b):
        return None
    place = tuple(int(i) for i in np.argwhere(a != b)[0])
    step, _, obstacle, vertex = place
    return Switch(step + 1, vertex, obstacle, bool(a[place] and b[place]))
