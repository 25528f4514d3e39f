"""Where the energy of a motion is, frame by frame, and where it went.

Stored, J: kinetic ½ Σ m |v|²; elastic ½ Σ k (L − L₀)² in the springs; gravity −Σ m g·(x − x₀), 0 at the start; contact
½ Σ κ (depth)² in the push of spheres, of other colliders and of the cloth on itself. A spring between fixed vertices
counts too, with a constant.

Given and taken over a step of displacement h w, each force f at the state where the step takes it: the wind gives h f·w
with the push on a cloth that holds still, and counted with it what applied forces give; damping (of vertices and
springs), friction, which counts as damping, and drag (what the cloth's own velocity changes in the push of the air)
take −h f·w. What moves, pins and colliders and a weight that changes, does the work `moved` (`work`). What is still
missing,

    numerical = start + wind + moved − damping − drag − what is stored,

is the integrator's. Implicit steps lose energy, the more the longer they are; explicit ones gain it; symplectic ones
do neither for long.

The velocities are those of the steps: (x − x before)/h after an implicit or symplectic step, (x after − x)/h before
an explicit one, (3 x − 4 x before + x before that)/2h after a BDF2 step but the first. Implicit steps take their forces
at the new velocity, and at the old positions; with several Newton iterations at the new ones. Over BDF2 steps the work
is h times the mean of the powers f·v at both ends, of second order as they are. The lumping of the drag in the matrix
of an implicit step counts as the integrator's, and so does a step of a BDF2 motion that is an implicit step
(`step.guard`), as positions do not show it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.engine.forces import contact, spheres, springs, vertex, wind
from clothfit.engine.forces.selfcontact import pairs
from clothfit.engine.inputs.tables import set_frame, set_inputs
from clothfit.engine.starts import let_go
from clothfit.engine.step import explicit, guard
from clothfit.engine.system import BDF2, EXPLICIT, IMPLICIT, SYMPLECTIC, System, build, meets_itself
from clothfit.kernels.kernel import kernel
from clothfit.motion.motion import Motion, Steps, check_counts, check_loaded, in_groups, in_world
from clothfit.motion.simulate import answered
from clothfit.scene.scene import Scene, check_is_scene

KINETIC, ELASTIC, GRAVITY, CONTACT, WIND, DAMPING, DRAG, WEIGHT = ENERGY_COLUMNS = range(8)
"""Columns of the balances of one cloth: four of states, four of the steps that end there."""

AT_ONCE = 20_000
"""Vertices × frames that are computed together, so that copies stay small."""


MOST_GAIN, MOST_EXCESS = 0.25, 0.01
"""Energy that contacts with spheres, and steps of cloths that touch anything else, may add without a warning, relative
to the largest that is kinetic, elastic or of the weight, and to the largest in one place.
"""


@dataclass(frozen=True, eq=False)
class Energy:
    """The energy of all cloths of a scene together, (frames,), J. Work and losses are sums from the start on."""

    times: Array  # (frames,), s
    kinetic: Array  # ½ m v²
    elastic: Array  # ½ k (L − L₀)², in the springs
    gravity: Array  # −m g·x, 0 at the start
    contact: Array  # in the push of colliders, and of a cloth on itself
    wind: Array  # work of the wind, and of forces that are applied, until then
    damping: Array  # lost to the damping of vertices and springs, and to friction, until then
    drag: Array  # lost to the air that the cloths move through until then
    moved: Array  # work of pins, colliders and a weight that move or change, until then

    @property
    def total(self) -> Array:
        """The stored energy (frames,), J: kinetic, elastic, gravity and contact."""
        return self.kinetic + self.elastic + self.gravity + self.contact

    @property
    def dissipated(self) -> Array:
        """Energy at the start plus the work of the wind and of what moves minus the stored energy (frames,), J."""
        return np.asarray(self.total[0] + self.wind + self.moved - self.total)

    @property
    def numerical(self) -> Array:
        """Energy that no force took (frames,), J: the integrator's loss, negative where it adds energy."""
        return np.asarray(self.dissipated - self.damping - self.drag)

    @property
    def largest_rise(self) -> tuple[float, int]:
        """The largest rise of the stored energy over one step beyond the work of the wind and of what moves, J, and the
        frame after that step. The rise is 0 or less where the energy never rises.
        """
        rises = self.rises[1:]
        if not len(rises):
            return 0.0, 0
        frame = int(np.argmax(rises))
        return float(rises[frame]), frame + 1

    @property
    def rises(self) -> Array:
        """How much the stored energy rises beyond that work in the step that ends at each frame (frames,), J."""
        with np.errstate(invalid="ignore"):
            rises = -np.diff(self.dissipated, prepend=self.dissipated[:1])
        rises[np.isnan(rises)] = np.inf  # between two energies that are infinite
        rises[np.abs(rises) <= guard.LEAST_RISE] = 0.0
        return np.asarray(rises)

    @property
    def excess(self) -> float:
        """What the cloths have beyond that work, J: the sum of all rises."""
        return float(self.rises.clip(0.0).sum())

    @property
    def own(self) -> tuple[Array, Array, Array]:
        """What the cloths have without contacts, (frames,) J each: kinetic, elastic and gravity."""
        return self.kinetic, self.elastic, self.gravity

    @property
    def gain(self) -> tuple[float, int]:
        """The largest energy that the cloths have at a frame beyond the stored energy at the start and the work of the
        wind and of what moves, J, and that frame. What is in contacts counts only at the start: steps press vertices
        deep into spheres, and the next ones take most of that away again.
        """
        with np.errstate(invalid="ignore"):
            gains = sum(self.own) - self.wind - self.moved - self.total[0]
        gains[np.isnan(gains)] = np.inf
        frame = int(np.argmax(gains))
        return float(gains[frame]), frame

    @property
    def scale(self) -> float:
        """The largest of the stored energies at any time that is finite, J: a rise is judged against it."""
        stored = np.abs([self.kinetic, self.elastic, self.gravity, self.contact])
        return float(stored.max(where=np.isfinite(stored), initial=0.0))


def energies(scene: Scene, motion: Motion) -> Energy:
    """The energy of a simulated motion, frame by frame.

    The motion must be one that `simulate` gives: all vertices, a frame after every step. Where the scene's axes move,
    the energy is that in the world. Raises InvalidInput when it is not.
    """
    check_is_scene(scene)
    check_loaded(motion)
    check_counts(motion, scene)
    steps = scene.delta * np.arange(len(motion.times))
    if not motion.seen().all() or not np.allclose(motion.times, steps, rtol=1e-6, atol=1e-6 * scene.delta):
        raise InvalidInput(
            f"{motion.name}: energies need every vertex, and a frame after every step of {scene.delta:.4g} s; give a "
            "motion as `simulate` makes it"
        )
    taken = motion.steps if motion.steps and motion.steps.of is motion.positions else unknown(scene, motion)
    motion, last = in_groups(in_world(motion, scene), scene), len(steps) - 1
    scene = answered(scene, last, scene.tolerance)
    systems = [build(scene, group[0], steps=last) for group in scene.groups]
    if taken.rubbed is not None:
        systems = [without_friction(system) for system in systems]
    parts = [
        balances(system, motion.of(group[0]), euler)
        for system, group, euler in zip(systems, scene.groups, taken.euler, strict=True)
    ]
    kinetic, elastic, gravity, contact, *given = np.sum(parts, axis=0).T
    blown, damped, dragged, changed = np.cumsum(given, axis=1)
    moved = np.cumsum(taken.work) + changed
    damped -= 0.0 if taken.rubbed is None else np.cumsum(taken.rubbed)
    return Energy(motion.times, kinetic, elastic, gravity - gravity[0], contact, blown, -damped, -dragged, moved)


def faults(scene: Scene, motion: Motion, found: Energy | None = None) -> list[str]:
    """What a user should know of the energy that steps of a simulated motion have added where cloths touch something:
    in wind, in explicit steps, or where they are too long; `found` is the motion's energy, if it is known. What is in
    the editor's spheres does not count, see `Energy.gain`.
    """
    if not (scene.obstacles or scene.self_contact) or len(motion.times) < 2 or let_go(scene):
        return []  # what is let go gives energy as well
    found = energies(scene, motion) if found is None else found
    if not scene.spheres:
        if not found.excess > MOST_EXCESS * found.scale:
            return []
        share, frame = 100 * found.excess / found.scale, found.largest_rise[1]
        return [
            f"{scene.name}: the steps have added {found.excess:.3g} J, {share:.2g} % of the largest energy in one "
            f"place, most in the step before frame {frame}; try a smaller delta"
        ]
    gain, frame = found.gain
    largest = max(np.abs(part).max(where=np.isfinite(part), initial=0.0) for part in found.own)
    if gain <= MOST_GAIN * largest or not found.contact[: frame + 1].any():
        return []
    return [
        f"{scene.name}: contacts have added energy: at frame {frame} the cloths have {gain:.3g} J more than at the "
        f"start, and never more than {largest:.3g} J in one place; a cloth meets a sphere too fast for the time "
        "step, so try a smaller delta"
    ]


def unknown(scene: Scene, motion: Motion) -> Steps:
    """What is taken for the steps of a motion that was not simulated here: nothing does work, and of BDF2 only the
    first step is an implicit one.
    """
    euler = np.tile(np.arange(len(motion.times)) < 2, (len(scene.groups), 1))
    return Steps(motion.positions, np.zeros(len(motion.times)), None, euler)


def without_friction(system: System) -> System:
    """The same system but for friction, of which its steps know better than positions do what it takes."""
    if system.colliders is not None:
        system.colliders.friction[:] = 0.0
    return system._replace(surface=system.surface and system.surface._replace(friction=0.0))


def balances(system: System, x: Array, euler: Flags | None = None) -> Array:
    """What is stored at each frame and given over the step before it, (F, 8) J, of one cloth's positions (F, n, 3);
    `euler` (F,): whether that step of a BDF2 motion is an implicit Euler step (default: the first).
    """
    euler = np.arange(len(x)) < 2 if euler is None else euler
    out = np.zeros((len(x), len(ENERGY_COLUMNS)))
    length = max(1, AT_ONCE // len(system.x0))
    for begin in range(0, len(x), length):
        end = min(begin + length, len(x))
        v = velocities(system, x, begin, end, euler)
        states(system, np.ascontiguousarray(x[begin:end]), v, begin, out[begin:end])
        add_self_contact(system, x[begin:end], out[begin:end])
        first = max(begin, 1)
        if system.method == BDF2:
            add_mean_works(system, x, first, end, euler, out)
            continue
        w = means(system, x, first, end)
        u = velocities(system, x, first - 1, end - 1, euler) if system.method == SYMPLECTIC else w
        late = system.method == IMPLICIT and system.newton_iterations > 1
        y = np.ascontiguousarray(x[first:end] if late else x[first - 1 : end - 1])
        works(system, y, u, w, first if system.inputs is None else first - 1 + system.inputs.lead, out[first:end])
        add_self_friction(system, y, u, w, out[first:end])
    out[:, WIND] += pushed(system, x)
    if system.inputs is not None and len(system.inputs.gravity):
        g, moments = system.inputs.gravity[: len(x)], np.einsum("i,tij->tj", system.vertex.mass, x - x[0])
        out[:, GRAVITY] += g @ (system.vertex.mass @ x[0])
        out[1:, WEIGHT] = -np.einsum("tj,tj->t", np.diff(g, axis=0), moments[:-1])
    return out


def pushed(system: System, x: Array) -> Array:
    """The work of applied forces, and of springs that pull to given places, (F,) J, in the steps that end at each frame
    of positions x (F, n, 3).
    """
    own, out = system.inputs, np.zeros(len(x))
    if own is None or not len(own.force):
        return out
    steps = len(x) - 1
    force = own.force[:steps].copy()
    if len(own.gain):
        force += own.gain[:steps, :, None] * (own.target[:steps] - x[1:])
    out[1:] = np.einsum("tij,tij->t", force, np.diff(x, axis=0))
    return out


def velocities(system: System, x: Array, begin: int, end: int, euler: Flags) -> Array:
    """Velocities (end − begin, n, 3) at some frames of positions x (F, n, 3), m/s."""
    if system.method == EXPLICIT:
        v = means(system, x, begin + 1, end + 1)
        return v if end < len(x) else np.concatenate([v, last_velocity(system, x)[None]])
    v = means(system, x, max(begin, 1), end)
    if system.method == BDF2 and end > 2:
        late = max(begin, 2)
        more = 0.5 * (v[late - end :] - means(system, x, late - 1, end - 1))
        v[late - end :] += np.where(euler[late:end, None, None], 0.0, more)
    return v if begin else np.concatenate([system.v0[None], v])[:end]


def add_mean_works(system: System, x: Array, first: int, end: int, euler: Flags, out: Array) -> None:
    """Write the work of the BDF2 steps that end at some frames to the columns of out (F, 8)."""
    v, ends = velocities(system, x, first - 1, end, euler), np.zeros((end - first + 1, len(ENERGY_COLUMNS)))
    works(system, np.ascontiguousarray(x[first - 1 : end]), v, v, first - 1, ends)
    add_self_friction(system, x[first - 1 : end], v, v, ends)
    given = [WIND, DAMPING, DRAG]
    out[first:end, given] = 0.5 * (ends[1:] + ends[:-1])[:, given]


def means(system: System, x: Array, begin: int, end: int) -> Array:
    """Mean velocities (≤ end − begin, n, 3) over the steps that end at some frames, the first of them not 0, m/s."""
    return np.asarray(np.diff(x[begin - 1 : max(end, begin)], axis=0) / system.h)


def last_velocity(system: System, x: Array) -> Array:
    """Velocity (n, 3) at the last frame of explicit steps: no later position shows it, so the step is taken again."""
    if len(x) == 1:
        return system.v0
    v, before = np.empty_like(system.v0), (x[-1] - x[-2]) / system.h
    set_inputs(system.inputs, system, len(x) - 2)
    explicit.step(system, np.ascontiguousarray(x[-2]), before, v, np.empty_like(v))
    return v


def add_self_contact(system: System, x: Array, out: Array) -> None:
    """Add what is stored in self-contact at positions x (F, n, 3) to the columns of out (F, 8)."""
    if system.surface and meets_itself(system):
        for k, y in enumerate(np.ascontiguousarray(x)):
            out[k, CONTACT] += contact.energy(pairs.contact_at(system.surface, y), y)


def add_self_friction(system: System, x: Array, u: Array, w: Array, out: Array) -> None:
    """Add the work of self-contact's friction over steps that begin at x (F, n, 3), as `works` has it."""
    if system.surface and system.surface.friction > 0.0:
        for k, y in enumerate(np.ascontiguousarray(x)):
            touched = pairs.contact_at(system.surface, y)
            out[k, DAMPING] += system.h * contact.damping_power(touched, y, u[k], w[k])


@kernel
def states(system, x, v, first, out):
    """Write what is stored at positions x and velocities v (F, n, 3), from the frame `first` on, to the columns of
    out (F, 8).
    """
    for k in range(len(x)):
        set_frame(system.inputs, system, first + k)
        out[k, KINETIC] = guard.moving(system.vertex, v[k])[0]
        out[k, ELASTIC] = springs.energy(system.springs, x[k])
        out[k, GRAVITY] = vertex.energy(system.vertex, x[k])
        out[k, CONTACT] = spheres.energy(system.spheres, x[k]) + contact.energy(system.colliders, x[k])


@kernel
def works(system, y, u, w, first, out):
    """Write the work of steps that move by h w, with forces at (y, u), (F, n, 3) each, and inputs from the frame
    `first` on, to the columns of out (F, 8).
    """
    h = system.h
    for k in range(len(y)):
        set_frame(system.inputs, system, first + k)
        damped = vertex.damping_power(system.vertex, y[k], u[k], w[k])
        damped += springs.damping_power(system.springs, y[k], u[k], w[k])
        damped += contact.damping_power(system.colliders, y[k], u[k], w[k])
        blown, dragged = wind.powers(system.faces, y[k], u[k], w[k])
        out[k, WIND], out[k, DAMPING], out[k, DRAG] = h * blown, h * damped, h * dragged
