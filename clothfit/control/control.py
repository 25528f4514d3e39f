"""The gentlest controls that take the cloths of a scene through keys, and the course of the motion that they lead to.

F frames, n vertices of all objects, K keys, G times of keys.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.checkpoint import Checkpoint, digest
from clothfit.base.errors import InvalidInput
from clothfit.control.closed_loop import Costs
from clothfit.control.controls import Controls, immovable
from clothfit.control.feedback import with_gains
from clothfit.control.following import Report, follow
from clothfit.control.keyframes import Key, last_step, left_of
from clothfit.control.steering import steer
from clothfit.engine.inputs.sampling import arrays_from_files
from clothfit.kernels.clock import computing
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.optimise.status import Status
from clothfit.scene.forces import Forces
from clothfit.scene.scene import Scene, dumps

NEAR = 1e-3
"""m: a key that the cloth passes no farther than this is reached; a hard one within a thousandth of it."""


@dataclass(frozen=True, eq=False)
class Reached:
    """How near a key the cloth came."""

    time: float  # s
    cloth: int  # of the scene, counted from 0
    rmse: float  # m, over its vertices
    hard: bool  # whether it was to be met to 1 µm
    speed: float | None  # m/s, root mean square miss of the velocities; None where none are asked for
    immovable: int  # vertices that are not there and that no control can move

    @property
    def near(self) -> bool:
        """Whether it is reached."""
        return self.rmse <= (NEAR * 1e-3 if self.hard else NEAR)


@dataclass(frozen=True, eq=False)
class Control:
    """Controls that take a scene through keys, and what they lead to."""

    status: Status  # how the search ended
    scene: Scene  # with the paths of handles, the wind and the velocities that were found; the given one without these
    forces: Forces | None  # with a feedback where one was found; None: none were asked for
    motion: Motion  # what `simulate` makes of them
    keys: tuple[Reached, ...]  # how near each of them the motion comes
    free: tuple[float, ...]  # m, how far the cloth is from each key without control
    effort: float  # Σ |u|² h, N² s
    optimality: float  # gradient of the effort, relative to that at the start
    evaluations: int  # of effort and gradient
    seconds: float  # of computing
    at_bound: int  # forces of a vertex in a step that are within a thousandth of their bound


def find_controls(
    scene: Scene,
    keys: Sequence[Key],
    controls: Controls = Controls(),  # noqa: B008  it cannot be changed
    *,
    budget: float | None = None,
    costs: Costs = Costs(),  # noqa: B008
    report: Report | None = None,
    checkpoint: Checkpoint | None = None,
) -> Control:
    """Find the gentlest controls under which the cloths go through keys: by default the forces of least effort
    Σ |u|² h on all vertices that are not fixed.

    `budget` in s. `report` gets the effort, what is missed of keys, m, and the evaluations so far; a `checkpoint`
    keeps what a killed search needs to go on. Raises InvalidInput
    where a control cannot be one, or a hard key asks for a fixed vertex to be elsewhere; Diverged where no motion stays
    finite.
    """
    scene.check_apart("a control")
    check_keys(scene, keys, controls)
    state = checkpoint.begin(identity(scene, keys, controls, costs)) if checkpoint else {}
    began, steps, said = computing(), last_step(keys), report or (lambda *_: None)
    alone = moved(scene, steps)
    search = follow if controls.follows else steer
    found = search(scene, keys, controls, alone, budget, costs, said, checkpoint, state)
    given, forces, status, frames = found.scene, found.forces, found.status, max(steps + 1, scene.frames)
    with interrupts.grace(np.inf):
        if forces is not None and status is not Status.INTERRUPTED and controls.follows:
            forces = with_gains(scene, forces, keys, costs.most)
        motion = simulate(given.with_forces(forces), frames)
        if misses(keys, motion.positions, scene) > misses(keys, alone, scene):
            none = None if forces is None else Forces(forces.times, np.zeros_like(forces.values))
            with suppress(Diverged):
                motion = simulate(scene.with_forces(none), frames)
                given, forces, status = scene, none, max(status, Status.STALLED, key=list(Status).index)
    u = np.zeros((0, 0, 3)) if forces is None else forces.values
    stuck = immovable(scene, keys, controls)
    return Control(
        status, given, forces, motion,
        tuple(reached(key, motion, scene, own) for key, own in zip(keys, stuck, strict=True)),
        tuple(miss(key, alone, scene) for key in keys),
        scene.delta * float((u * u).sum()), found.optimality, found.evaluations, computing() - began,
        int((np.sqrt((u * u).sum(axis=2)) >= costs.most * (1.0 - 1e-3)).sum()),
    )  # fmt: skip


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

    `pushed` are, of each object, the vertices (n,) that they may act on (default: all that are not fixed). The others
    are those of `find_controls`. Raises InvalidInput where a hard key asks for a fixed vertex to be elsewhere, Diverged
    where no motion stays finite.
    """
    return find_controls(scene, keys, Controls(forces=pushed), budget=budget, costs=costs, report=report)


def misses(keys: Sequence[Key], x: Array, scene: Scene) -> float:
    """The sum of squared misses by the weights of the keys, m², at positions x (T + 1, n, 3): what a search lowers."""
    return sum(key.weight * miss(key, x, scene) ** 2 for key in keys)


def check_keys(scene: Scene, keys: Sequence[Key], controls: Controls) -> None:
    """Raise InvalidInput where keys cannot be reached by any control."""
    if scene.frame:
        raise InvalidInput(f"{scene.name}: frame: controls need axes that do not move")
    for key in keys:
        cloth = scene.cloths[key.cloth]
        held = (cloth.fixed & ~controls.led(scene, key.cloth))[key.vertices]
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


def miss(key: Key, x: Array, scene: Scene) -> float:
    """Root mean square distance, m, of the vertices of a key from it, at positions x (T + 1, n, 3) of all objects."""
    away = left_of(key, x[:, scene.vertices(key.cloth)])
    return float(np.sqrt(np.mean((away**2).sum(axis=1))))


def reached(key: Key, motion: Motion, scene: Scene, stuck: Flags | None = None) -> Reached:
    """How near a key a motion comes; `stuck` (m,): which of its vertices no control can move, None: none."""
    x, speed = motion.positions[:, scene.vertices(key.cloth)], None
    if key.velocities is not None:
        v = (x[key.step, key.vertices] - x[key.step - 1, key.vertices]) / scene.delta
        speed = float(np.sqrt(np.mean(((v - key.velocities) ** 2).sum(axis=1))))
    away = np.linalg.norm(left_of(key, x), axis=1) > NEAR
    stuck = np.zeros(len(key.vertices), bool) if stuck is None else stuck
    count = int((away & stuck).sum()) if key.share is None else len(stuck) * bool(away.any() and stuck.all())
    return Reached(key.step * scene.delta, key.cloth, miss(key, motion.positions, scene), key.hard, speed, count)


def identity(scene: Scene, keys: Sequence[Key], controls: Controls, costs: Costs) -> dict[str, str]:
    """What must be the same for a search to go on."""
    parts: list[bytes | Array] = [dumps(scene), *arrays_from_files(scene)]
    for key in keys:
        given = key.velocities, key.share
        parts += [np.array([key.step, key.cloth, key.weight, key.hard], float), key.vertices.astype(float)]
        parts += [key.positions, *(np.zeros(0) if each is None else each for each in given)]
    for flags in controls.forces or ():
        parts.append(np.asarray(flags, float))
    for handle in controls.handles:
        parts.append(np.concatenate([[handle.cloth], handle.vertices]).astype(float))
    said = controls.wind, controls.velocity, controls.every, controls.modes, controls.pushes, costs
    return {"scene, keys or options": digest(*parts, repr(said).encode())}


@dataclass(frozen=True, eq=False)
class ControlledMotion:
    """A controlled motion beside its keys and beside the motion without controls."""

    scene: Scene  # with the controls
    times: Array  # (F,), s
    own: Array  # (F, n, 3), m
    free: Array  # (F, n, 3), m, without the controls; where that diverges it stays
    keys: Sequence[Key]
    poses: Array  # (G, n, 3), m, what keys of one time ask for; NaN for vertices that none asks for
    means: tuple[Array, ...]  # of each time the places (M, 3), m, that means of vertices are to be at
    due: Indices  # (G,), the frames of these times
    distance: Array  # (K, F), m, root mean square distance from each key
    forces: Array  # (F, n, 3), N, in the step that begins at each frame; 0 at the last
    effort: Array  # (F,), N² s, of that step

    def next(self, frame: int) -> int:
        """Which time of keys, 0 … G − 1, comes at a frame or after it; the last one after all."""
        return min(int(np.searchsorted(self.due, frame)), len(self.due) - 1)


def controlled_motion(scene: Scene, controlled: Scene, keys: Sequence[Key], motion: Motion) -> ControlledMotion:
    """The course of the motion of a scene with controls; `scene` has none."""
    x, times = motion.positions, motion.times
    due = np.unique([key.step for key in keys]).astype(np.int32)
    poses = np.full((len(due), x.shape[1], 3), np.nan)
    means: list[list[Array]] = [[] for _ in due]
    for key in keys:
        place = int(np.searchsorted(due, key.step))
        if key.share is None:
            poses[place, scene.vertices(key.cloth)][key.vertices] = key.positions
        else:
            means[place].append(key.positions[0])
    forces = np.zeros_like(x)
    if controlled.forces is not None:
        forces[:-1] = controlled.forces.at(times[:-1])[0]
    return ControlledMotion(
        controlled, times, x, moved(scene, len(x) - 1), keys, poses,
        tuple(np.array(each, float).reshape(-1, 3) for each in means), due,
        np.array([away(key, x[:, scene.vertices(key.cloth)]) for key in keys]),
        forces, scene.delta * (forces**2).sum(axis=(1, 2)),
    )  # fmt: skip


def away(key: Key, x: Array) -> Array:
    """Root mean square distance (F,), m, of the positions x (F, n, 3) of a key's object from the key."""
    own = x[:, key.vertices]
    if key.share is not None:
        own = np.einsum("v,fvc->fc", key.share, own)[:, None]
    return np.asarray(np.sqrt(((own - key.positions) ** 2).sum(axis=2).mean(axis=1)))
